"""Reward model Q(s, a) with s = (h, z) and a = μ; target and background have different labels (Sec. III-C)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import one_hot

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.geometry import relative_features
from advdiff_sumo.models.interaction import InteractionNet
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.perceptron import perceptron
from advdiff_sumo.models.stored import fill, read_stored, write_stored

FORMAT = "advdiff-reward-1"
_LABELS = 3  # target, background vehicle, other


@dataclass(frozen=True)
class RewardState:
    """The part of Q that does not depend on the action; computed once a plan.

    Attributes:
        node: (B, A, R) embedded (h, z) and label.
        edges: for each layer, contributions of relative poses to its messages.
        present: (B, A) which agents are present.
        target: (B,) row of the target.
    """

    node: Tensor
    edges: list[Tensor]
    present: Tensor
    target: Tensor


class RewardModel(nn.Module):
    """Deep Q-network over the agents of a scene; the action is the vehicles' latents.

    The latents are scaled, as in the denoiser. The value is computed from the target's node and the mean of all nodes.
    """

    def __init__(self, options: ModelOptions) -> None:
        super().__init__()
        self.options = options
        width = options.reward_hidden
        self.state = nn.Linear(options.hidden + options.latent + _LABELS, width)
        self.action = nn.Linear(options.latent, width, bias=False)
        self.mix = nn.Sequential(nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.interaction = InteractionNet(width, options)
        self.value = perceptron(2 * width, width, 1)

    def prepare(self, h: Tensor, z: Tensor, batch: SceneBatch, target: Tensor) -> RewardState:
        """Return the part of Q of *h* (B, A, D) and condition *z* (B, A, Z); *target* (B,) are the targets' rows."""
        agents = torch.arange(batch.agents, device=h.device)
        label = torch.where(batch.moved, 1, 2)
        label = torch.where(agents == target[:, None], 0, label)
        kind = one_hot(label, _LABELS).to(h.dtype)
        pose = batch.pose
        relative = relative_features(pose[..., :2], pose[..., 2], pose[..., 3])
        node = self.state(torch.cat((h, z, kind), dim=-1))
        return RewardState(node, self.interaction.prepare(relative), batch.present, target)

    def value_of(self, state: RewardState, mu: Tensor) -> Tensor:
        """Return Q (B,) of actions *mu* (B, A, Z); the target's row of *mu* is ignored."""
        rows = torch.arange(mu.shape[1], device=mu.device)
        free = (rows != state.target[:, None]) & state.present
        node = self.mix(state.node + self.action(mu) * free[..., None])
        node = self.interaction.mix(node * state.present[..., None], state.edges, state.present)
        own = node[torch.arange(node.shape[0], device=node.device), state.target]
        count = state.present.sum(1, keepdim=True).clamp(min=1)
        pooled = (node * state.present[..., None]).sum(1) / count
        out: Tensor = self.value(torch.cat((own, pooled), dim=-1)).squeeze(-1)
        return out

    def forward(self, h: Tensor, z: Tensor, mu: Tensor, batch: SceneBatch, target: Tensor) -> Tensor:
        """Return Q (B,) of states (h, z) and actions *mu* (B, A, Z)."""
        return self.value_of(self.prepare(h, z, batch, target), mu)


def save_reward(reward: RewardModel, path: Path, extra: Mapping[str, Any] | None = None) -> None:
    """Write Q's tensors to *path*, a ".safetensors" file; *extra* is added to its header as JSON."""
    write_stored(path, reward.state_dict(), {"format": FORMAT, "extra": dict(extra or {})})


def load_reward(path: Path, options: ModelOptions) -> RewardModel:
    """Read what :func:`save_reward` wrote, for networks of *options*.

    Raises:
        WeightsError: no such file, another format, or a reward model of other sizes.
    """
    remedy = "give a file that advdiff-sumo warmup made"
    _, tensors = read_stored(path, FORMAT, "make it with advdiff-sumo warmup", remedy)
    with torch.random.fork_rng(devices=[]):
        reward = RewardModel(options)
    fill(reward, tensors, path, "the networks", "warm up with the weights that the run uses")
    return reward
