"""How attackers' bodies lie among others and on the road: distances, overlap, and what is over the road's edge.

Distances are between five discs a vehicle (``models.losses``).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.losses import discs, off_road


@dataclass(frozen=True)
class Met:
    """What attackers meet.

    Attributes:
        gap: (B, R, T) distance of the bodies from the target's.
        overlap: (B, R) how far their discs are inside those of others than the target, summed over time.
        off: (B, R) how far they are over the road's edge, as a share of their width, summed over time.
    """

    gap: Tensor
    overlap: Tensor
    off: Tensor


@dataclass(frozen=True)
class Placed:
    """Who is where, one scene.

    Attributes:
        batch: the scene; target in row 0.
        rows: (R,) attackers, the target not among them.
        natural: futures (1, A, T) of everybody.
    """

    batch: SceneBatch
    rows: Tensor
    natural: Rollout

    def others(self) -> Tensor:
        """Return who is neither target nor attacker."""
        agents = torch.arange(self.batch.agents, device=self.rows.device)
        return agents[(agents != 0) & ~torch.isin(agents, self.rows)]


class TensorBodies:
    """What attackers meet, on tensors of any device.

    Args:
        placed: who is where.
    """

    def __init__(self, placed: Placed) -> None:
        self._placed = placed
        self._own = placed.batch.rows_of(placed.rows)

    def __call__(self, rollout: Rollout) -> Met:
        """Return what the attackers of *rollout* (B, R, T) meet, with gradients to it."""
        natural, size = self._placed.natural, self._placed.batch.size[0]
        steps = rollout.yaw.shape[2]
        target = natural.xy[0, 0, :steps], natural.yaw[0, 0, :steps]
        gap = distance(rollout, size[self._placed.rows], *target, size[0])
        off = off_road(rollout, self._own.repeat(len(rollout.yaw))).sum(-1)
        return Met(gap, self._overlap(rollout), off)

    def _overlap(self, rollout: Rollout) -> Tensor:
        others, natural = self._placed.others(), self._placed.natural
        if not len(others):
            return torch.zeros_like(rollout.yaw[..., 0])
        size, rows = self._placed.batch.size[0], self._placed.rows
        mine, radius = discs(rollout.xy, rollout.yaw, size[rows, None].expand(*rollout.yaw.shape, 2))
        steps = natural.yaw.shape[2]
        yours, reach = discs(
            natural.xy[0, others], natural.yaw[0, others], size[others, None].expand(-1, steps, 2)
        )
        delta = mine[:, :, None, :, :, None] - yours[None, None, :, :, None, :]
        squared = delta.square().sum(-1).flatten(-2).amin(-1)  # (B, R, O, T)
        wide = radius[:, :, None] + reach
        return (1.0 - torch.sqrt(squared + 1e-9) / wide).clamp(min=0.0).sum(dim=(2, 3))


def distance(rollout: Rollout, size: Tensor, xy: Tensor, yaw: Tensor, other: Tensor) -> Tensor:
    """Return the distance (B, R, T) of bodies made of discs; *xy* (…, T, 2) and *yaw* (…, T) are the other's."""
    mine, radius = discs(rollout.xy, rollout.yaw, size[:, None].expand(*rollout.yaw.shape, 2))
    yours, reach = discs(xy, yaw, other.expand(*yaw.shape, 2))
    squared = (mine[..., :, None, :] - yours[..., None, :, :]).square().sum(-1).flatten(-2).amin(-1)
    return torch.sqrt(squared + 1e-9) - radius - reach
