"""Distances and overlaps of attackers with other vehicles and with the road edge.

Each vehicle is represented by five discs (``models.losses``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.losses import beyond_edge, discs
from advdiff_sumo.models.road_edges import RoadEdges


@dataclass(frozen=True)
class AttackStates:
    """Natural futures of all agents and present states of R attackers, in one scene; target in row 0.

    Attributes:
        size: (A, 2) lengths and widths.
        others: (A,) which agents are neither target nor attackers.
        xy: (A, T, 2) natural positions.
        yaw: (A, T) natural headings.
        speed: (A, T) natural speeds.
        own_size: (R, 2) sizes of the attackers.
        own_pose: (R, 4) present poses of the attackers.
        moved: (R,) which attackers are vehicles.
        edges: segments of the road edge around each attacker.
    """

    size: Tensor
    others: Tensor
    xy: Tensor
    yaw: Tensor
    speed: Tensor
    own_size: Tensor
    own_pose: Tensor
    moved: Tensor
    edges: RoadEdges

    @staticmethod
    def of(batch: SceneBatch, rows: Tensor, natural: Rollout) -> AttackStates:
        """Return the states in the only scene of *batch*, with attackers *rows* (R,) and *natural* futures."""
        agents, own = torch.arange(batch.agents, device=rows.device), batch.rows_of(rows)
        others = (agents != 0) & ~torch.isin(agents, rows)
        states = natural.xy[0], natural.yaw[0], natural.speed[0]
        return AttackStates(
            batch.size[0], others, *states, own.size[0], own.pose[0], own.moved[0], RoadEdges.of(own)
        )

    @staticmethod
    def from_tensors(parts: Sequence[Tensor]) -> AttackStates:
        """Return the object with these :meth:`tensors`."""
        size, others, xy, yaw, speed, own_size, own_pose, moved, *edges = parts
        return AttackStates(size, others, xy, yaw, speed, own_size, own_pose, moved, RoadEdges(*edges))

    def tensors(self) -> tuple[Tensor, ...]:
        """Return all parts, those of the road edges last."""
        *parts, edges = vars(self).values()
        return (*parts, *vars(edges).values())


@dataclass(frozen=True)
class AttackDistances:
    """Distances and overlaps of attackers.

    Attributes:
        gap: (B, R, T) gap to the target.
        overlap: (B, R) overlap with agents other than the target, summed over time.
        off: (B, R) distance beyond the road edge, as a share of the width, summed over time.
    """

    gap: Tensor
    overlap: Tensor
    off: Tensor


def attack_distances(rollout: Rollout, placed: AttackStates) -> AttackDistances:
    """Return distances and overlaps of the attackers of *rollout* (B, R, T), differentiable in it."""
    own_xy, radius = discs(rollout.xy, rollout.yaw, placed.own_size[:, None].expand(*rollout.yaw.shape, 2))
    other_xy, reach = discs(placed.xy, placed.yaw, placed.size[:, None].expand(*placed.yaw.shape, 2))
    delta = own_xy[:, :, None, :, :, None] - other_xy[None, None, :, :, None, :]
    distance = torch.sqrt(delta.square().sum(-1).flatten(-2).amin(-1) + 1e-9)  # (B, R, A, T)
    wide = radius[:, :, None] + reach
    inside = (1.0 - distance / wide).clamp(min=0.0).sum(-1)
    gap, overlap = distance[:, :, 0] - wide[:, :, 0], (inside * placed.others).sum(-1)
    scenes = rollout.yaw.shape[0]  # not len(), which compilation would turn into a constant
    size, pose = (part.expand(scenes, -1, -1) for part in (placed.own_size, placed.own_pose))
    off = beyond_edge(rollout, size, pose, placed.edges.expand(scenes)).sum(-1) * placed.moved
    return AttackDistances(gap, overlap, off)
