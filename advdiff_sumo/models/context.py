"""Context encoder E(m, past) → (h, prior of z), Sec. III-B."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torch.nn.functional import one_hot

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.driving_situation import situation_features
from advdiff_sumo.models.gaussian import Gaussian
from advdiff_sumo.models.geometry import into_frame, relative_features
from advdiff_sumo.models.interaction import InteractionNet
from advdiff_sumo.models.model_options import (
    CLASSES,
    HISTORY_STEPS,
    PIECE_FEATURES,
    PIECE_POINTS,
    ModelOptions,
)
from advdiff_sumo.models.perceptron import perceptron

STATE = 6
"""Features of one instant in :func:`seen_states`."""
_SCALE = (0.25, 0.1, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Context:
    """Condition for the futures of all agents.

    Attributes:
        h: (B, A, D) state embeddings, which include the map and the other agents.
        prior: p(z | h), (B, A, Z).
        relative: (B, A, A, 9) present ``relative_features`` of all pairs.
        drawn: (B, A) whether the agent has a latent: vehicles.
        situation: (B, A, 11) signals, lead vehicles and speed limits, of ``situation_features``; (B, A, 0) if no
            network uses them.
    """

    h: Tensor
    prior: Gaussian
    relative: Tensor
    drawn: Tensor
    situation: Tensor

    def mapped(self, change: Callable[[Tensor], Tensor]) -> Context:
        """Return the context with *change* applied to each of its tensors."""
        prior = Gaussian(change(self.prior.mean), change(self.prior.logvar))
        return Context(
            change(self.h), prior, change(self.relative), change(self.drawn), change(self.situation)
        )

    def repeat(self, times: int) -> Context:
        """Return the context with each scene repeated *times* times, as in ``SceneBatch.repeat``."""
        return self.mapped(lambda part: part.repeat_interleave(times, dim=0))

    def rows(self, rows: Tensor | slice) -> Context:
        """Return the context of the scenes at *rows*, as in ``SceneBatch.rows``."""
        return self.mapped(lambda part: part[rows])

    def first(self, agents: int) -> Context:
        """Return the context of only the first *agents* of each scene; their embeddings still include the others."""
        few = self.mapped(lambda part: part[:, :agents])
        return replace(few, relative=few.relative[:, :, :agents])


class MapEncoder(nn.Module):
    """Embeds map pieces and pools them by attention, with the agent's state as query."""

    feature_scale: Tensor

    def __init__(self, options: ModelOptions) -> None:
        super().__init__()
        width = options.hidden
        self.heads = options.heads
        self.register_buffer("feature_scale", torch.tensor(_SCALE), persistent=False)
        self.piece = perceptron(2 * PIECE_POINTS + PIECE_FEATURES, width, width, ends_in_relu=True)
        self.query = nn.Linear(width, width)
        self.key = nn.Linear(width, width, bias=False)
        self.value = nn.Linear(width, width, bias=False)
        self.out = nn.Linear(width, width)

    def forward(self, h: Tensor, batch: SceneBatch) -> Tensor:
        """Return (B, A, D) the map around each agent, attended to from its state *h*."""
        columns = batch.map_features * self.feature_scale
        pieces = self.piece(torch.cat((0.05 * batch.map_xy.flatten(-2), columns), dim=-1))
        query = self.query(h)
        query = query.reshape(*query.shape[:-1], self.heads, -1) * (query.shape[-1] // self.heads) ** -0.5
        # keys and values are linear in the pieces, so that they are applied to query and pooled pieces instead
        key, value = (self._by_head(layer) for layer in (self.key, self.value))
        score = torch.einsum("bahd,hdw->bahw", query, key) @ pieces.transpose(-1, -2)
        mask = batch.map_valid[:, :, None]
        weight = torch.softmax(score.masked_fill(~mask, -1e9), dim=-1) * mask
        pooled = torch.einsum("bahw,hdw->bahd", weight @ pieces, value).flatten(-2)
        out: Tensor = self.out(pooled)
        return out

    def _by_head(self, layer: nn.Linear) -> Tensor:
        return layer.weight.reshape(self.heads, -1, layer.in_features)


class ContextEncoder(nn.Module):
    """MLP over the past, map pooling, interaction net, and prior of z."""

    def __init__(self, options: ModelOptions) -> None:
        super().__init__()
        width = options.hidden
        self.state = perceptron(HISTORY_STEPS * STATE + 2 + CLASSES, width, width)
        self.map = MapEncoder(options)
        self.norm = nn.LayerNorm(width)
        self.mix = perceptron(width, width, width)
        self.interaction = InteractionNet(width, options)
        self.prior = nn.Linear(width, 2 * options.latent)
        self._tells_situation = options.denoiser_situation

    def forward(self, batch: SceneBatch) -> Context:
        """Return embeddings and prior of every agent; they do not depend on the world's frame."""
        state = self.state(past_features(batch))
        h = self.norm(state + self.map(state, batch))
        h = (h + self.mix(h)) * batch.present[..., None]
        pose = batch.pose
        relative = relative_features(pose[..., :2], pose[..., 2], pose[..., 3])
        h = self.interaction(h, relative, batch.present)
        situation = situation_features(batch) if self._tells_situation else h[..., :0]
        return Context(h, gaussian_head(self.prior(h)), relative, batch.moved, situation)


def gaussian_head(raw: Tensor) -> Gaussian:
    """Return the Gaussian parametrised by *raw* (…, 2 Z), with variances between e⁻⁸ and e⁴."""
    mean, logvar = raw.chunk(2, dim=-1)
    return Gaussian(mean, 6.0 * torch.tanh(logvar / 6.0) - 2.0)


def past_features(batch: SceneBatch) -> Tensor:
    """Return (B, A, H·6 + 8) the past in the agent's own frame, its size and class."""
    history = seen_states(batch.past, batch.past_valid, batch.pose, 0.1)
    kind = one_hot(batch.classes, CLASSES).to(history.dtype)
    return torch.cat((history, 0.2 * batch.size, kind), dim=-1)


def seen_states(states: Tensor, valid: Tensor, pose: Tensor, per_m: float) -> Tensor:
    """Return (B, A, T·6) *states* (B, A, T, 4) in frames *pose* (B, A, 4), metres × *per_m*; 0 where not *valid*."""
    now = pose[:, :, None]
    xy = per_m * into_frame(states[..., :2], now[..., :2], now[..., 2].expand(states.shape[:-1]))
    turn = states[..., 2] - now[..., 2]
    columns = (xy[..., 0], xy[..., 1], torch.cos(turn), torch.sin(turn), 0.1 * states[..., 3])
    known = torch.where(valid[..., None], torch.stack(columns, dim=-1), 0.0)
    return torch.cat((known, valid[..., None].to(known.dtype)), dim=-1).flatten(-2)
