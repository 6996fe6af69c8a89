"""What AdvSim's search makes small, for many candidates at once.

After the adversarial objective of Wang et al. 2021 (Sec. 3.2, doi:10.1109/CVPR46437.2021.00978): to collide with
the target, and to make its drive uncomfortable. Their constraints are ours too: no contact with other vehicles,
and nobody leaves the road.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.geometry import into_frame
from advdiff_sumo.models.losses import clearance_in_frame, discs
from advdiff_sumo.models.model_options import MODEL_STEP_S
from advdiff_sumo.traffic.baselines.baseline_policy import cut, halves

_SOFT_M, _TOUCHES_M = 0.5, -0.5
_OTHERS = 12
_VIOLATION = 20.0
_TOLERANCE = 0.02


@dataclass(frozen=True)
class Ground:
    """The scene that candidates are judged in, cut to the search's horizon.

    Attributes:
        batch: the attackers alone, (1, R).
        size: (R, 2) of the attackers.
        target: (2 H, 3) x, y, yaw of the target at half steps.
        target_size: (2,).
        others: (O, 2 H, 3) the nearest other road users.
        other_size: (O, 2).
        allowed: violation of the initial sequence, which need not get better.
    """

    batch: SceneBatch
    size: Tensor
    target: Tensor
    target_size: Tensor
    others: Tensor
    other_size: Tensor
    allowed: float = 0.0


def ground_of(rollout: Rollout, batch: SceneBatch, rows: Tensor, steps: int) -> Ground:
    """Return what attackers *rows* (R,) meet when everybody else drives *rollout* (1, A, T), target in row 0."""
    dense = halves(cut(rollout, steps), batch.pose)
    states = torch.cat((dense.xy, dense.yaw[..., None]), dim=-1)[0]
    agents = torch.arange(batch.agents, device=rows.device)
    rest = agents[(agents != 0) & ~torch.isin(agents, rows) & batch.present[0]]
    gap = (states[rest, None, :, :2] - states[rows][None, :, :, :2]).norm(dim=-1).flatten(1).amin(1)
    rest = rest[torch.argsort(gap, stable=True)[:_OTHERS]]
    size = batch.size[0]
    return Ground(batch.rows_of(rows), size[rows], states[0], size[0], states[rest], size[rest])


def attack_cost(rollout: Rollout, ground: Ground) -> Tensor:
    """Return (P,) the smooth least distance in metres of candidates (P, R, H) to the target."""
    return _attack(_bodies(rollout, ground), ground)


def violation(rollout: Rollout, ground: Ground) -> Tensor:
    """Return (P,) metres by which candidates are inside others, or over the road's edge, worst instants added."""
    return _violation(_bodies(rollout, ground), ground)


def search_cost(rollout: Rollout, ground: Ground, changes: Tensor, effort: float) -> Tensor:
    """Return (P,) what the search makes small."""
    bodies = _bodies(rollout, ground)
    excess = (_violation(bodies, ground) - ground.allowed).clamp(min=0.0)
    return _attack(bodies, ground) + _VIOLATION * excess + effort * changes.square().mean(dim=(1, 2, 3))


def keeps(over: float, ground: Ground) -> bool:
    """Return whether a candidate of violation *over* keeps the constraints as well as the initial sequence does."""
    return over <= ground.allowed + _TOLERANCE


def discomfort(states: Tensor) -> float:
    """Return mean |acceleration| + mean |jerk| of the target's *states* (H + 1, 4) at model steps."""
    accel = torch.diff(states[:, 3]) / MODEL_STEP_S
    jerk = torch.diff(accel) / MODEL_STEP_S
    return float(accel.abs().mean() + jerk.abs().mean())


_Bodies: TypeAlias = tuple[Tensor, Tensor]
"""Discs of attackers: centres (P, R, 2 H, 5, 2) at half steps, and radii (P, R, 2 H)."""


def _bodies(rollout: Rollout, ground: Ground) -> _Bodies:
    dense = halves(rollout, ground.batch.pose.expand(len(rollout.yaw), -1, -1))
    return discs(dense.xy, dense.yaw, ground.size[:, None].expand(*dense.yaw.shape, 2))


def _attack(bodies: _Bodies, ground: Ground) -> Tensor:
    gap = _gaps(bodies, ground.target[None], ground.target_size[None])[:, :, 0]
    return -_SOFT_M * torch.logsumexp(-gap.clamp(min=_TOUCHES_M).flatten(1) / _SOFT_M, dim=1)


def _violation(bodies: _Bodies, ground: Ground) -> Tensor:
    inside = torch.zeros(len(bodies[0]), device=bodies[0].device)
    if len(ground.others):
        gaps = _gaps(bodies, ground.others, ground.other_size)
        inside = (-gaps).clamp(min=0.0).amax(dim=(2, 3)).sum(1)
    if len(ground.size) > 1:
        inside = inside + _among(bodies)
    return inside + _over(bodies, ground).amax(-1).sum(1)


def _gaps(bodies: _Bodies, states: Tensor, other: Tensor) -> Tensor:
    """Return the distances (P, R, O, 2 H) of bodies to others at *states* (O, 2 H, 3)."""
    mine, radius = bodies
    yours, reach = discs(states[..., :2], states[..., 2], other[:, None].expand(*states.shape[:2], 2))
    delta = mine[:, :, None, :, :, None] - yours[:, :, None]
    near = delta.square().sum(-1).flatten(-2).amin(-1)
    return torch.sqrt(near + 1e-9) - radius[:, :, None] - reach


def _among(bodies: _Bodies) -> Tensor:
    """Return (P,) how far attackers are inside each other."""
    mine, radius = bodies
    delta = mine[:, :, None, :, :, None] - mine[:, None, :, :, None, :]
    near = delta.square().sum(-1).flatten(-2).amin(-1)
    gap = torch.sqrt(near + 1e-9) - radius[:, :, None] - radius[:, None]
    count = mine.shape[1]
    pairs = torch.ones(count, count, dtype=torch.bool, device=gap.device).triu(1)
    return (-gap).clamp(min=0.0).amax(-1)[:, pairs].sum(1)


def _over(bodies: _Bodies, ground: Ground) -> Tensor:
    """Return (P, R, 2 H) metres over the road's edge."""
    centres, radius = bodies
    points = centres[..., ::2, :].permute(1, 0, 2, 3, 4)  # (R, P, 2 H, 3, 2)
    flat = points.flatten(1, 3)[None]
    pose = ground.batch.pose[:, :, None]
    local = into_frame(flat, pose[..., :2], pose[..., 2].expand(flat.shape[:-1]))
    clear = clearance_in_frame(local, ground.batch).reshape(points.shape[:-1]).permute(1, 0, 2, 3)
    return (radius[..., None] - clear).clamp(min=0.0, max=4.0).amax(-1)
