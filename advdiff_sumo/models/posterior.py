"""Posterior q(z | τ, h): what latent leads to the future that happened (Sec. III-B, Training)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.context import gaussian_head
from advdiff_sumo.models.gaussian import Gaussian
from advdiff_sumo.models.geometry import into_frame, relative_features
from advdiff_sumo.models.interaction import InteractionNet
from advdiff_sumo.models.model_options import FUTURE_STEPS, ModelOptions

_STATE = 6


class Posterior(nn.Module):
    """The context encoder's structure over past context and future."""

    def __init__(self, options: ModelOptions) -> None:
        super().__init__()
        width = options.hidden
        self.future = nn.Sequential(
            nn.Linear(width + FUTURE_STEPS * _STATE, width), nn.ReLU(), nn.Linear(width, width)
        )
        self.norm = nn.LayerNorm(width)
        self.interaction = InteractionNet(width, options)
        self.head = nn.Linear(width, 2 * options.latent)

    def forward(self, batch: SceneBatch, h: Tensor) -> Gaussian:
        """Return q(z | τ, h), (B, A, Z)."""
        features = self.future(torch.cat((h, future_features(batch)), dim=-1))
        pose = batch.pose
        relative = relative_features(pose[..., :2], pose[..., 2], pose[..., 3])
        mixed = self.interaction(self.norm(h + features), relative, batch.present)
        return gaussian_head(self.head(mixed))


def future_features(batch: SceneBatch) -> Tensor:
    """Return (B, A, T·6): the future in the agent's own frame now."""
    now = batch.pose[:, :, None]
    xy = 0.05 * into_frame(batch.future[..., :2], now[..., :2], now[..., 2].expand(batch.future.shape[:-1]))
    turn = batch.future[..., 2] - now[..., 2]
    columns = (xy[..., 0], xy[..., 1], torch.cos(turn), torch.sin(turn), 0.1 * batch.future[..., 3])
    valid = batch.future_valid[..., None]
    states = torch.where(valid, torch.stack(columns, dim=-1), 0.0)
    return torch.cat((states, valid.to(states.dtype)), dim=-1).flatten(-2)
