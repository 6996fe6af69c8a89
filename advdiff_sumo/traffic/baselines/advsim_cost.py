"""What AdvSim's search makes small, for many candidates at once.

After the adversarial objective of Wang et al. 2021 (Sec. 3.2, doi:10.1109/CVPR46437.2021.00978): to collide with
the target, and to make its drive uncomfortable. Their constraints are ours too: no contact with other vehicles,
and nobody leaves the road.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.geometry import into_frame
from advdiff_sumo.models.model_options import MODEL_STEP_S
from advdiff_sumo.models.road_edges import RoadEdges
from advdiff_sumo.traffic.baselines.baseline_policy import cut, halves
from advdiff_sumo.traffic.baselines.disc_gaps import Bodies, depths, gaps

_SOFT_M, _TOUCHES_M = 0.5, -0.5
_OTHERS = 12
_VIOLATION = 20.0
_TOLERANCE = 0.02


@dataclass(frozen=True)
class Ground:
    """The scene that candidates are judged in, cut to the search's horizon.

    Attributes:
        pose: (1, R, 4) x, y, yaw and speed of the attackers now.
        size: (R, 2) of the attackers.
        edges: of the road, in the attackers' frames.
        target: (2 H,) the target at half steps.
        others: (O, 2 H) the nearest other road users.
        allowed: violation of the initial sequence, which need not get better.
    """

    pose: Tensor
    size: Tensor
    edges: RoadEdges
    target: Bodies
    others: Bodies
    allowed: float = 0.0


def ground_of(rollout: Rollout, batch: SceneBatch, rows: Tensor, steps: int) -> Ground:
    """Return what attackers *rows* (R,) meet when everybody else drives *rollout* (1, A, T), target in row 0."""
    dense = halves(cut(rollout, steps), batch.pose)
    xy, yaw, size = dense.xy[0], dense.yaw[0], batch.size[0]
    agents = torch.arange(batch.agents, device=rows.device)
    rest = agents[(agents != 0) & ~torch.isin(agents, rows) & batch.present[0]]
    gap = (xy[rest, None] - xy[rows][None]).norm(dim=-1).flatten(1).amin(1)
    rest = rest[torch.argsort(gap, stable=True)[:_OTHERS]]
    own = batch.rows_of(rows)
    target, others = Bodies.of(xy[0], yaw[0], size[:1]), Bodies.of(xy[rest], yaw[rest], size[rest, None])
    return Ground(own.pose, size[rows], RoadEdges.of(own), target, others)


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


def _bodies(rollout: Rollout, ground: Ground) -> Bodies:
    """Return the attackers (P, R, 2 H) at half steps."""
    dense = halves(rollout, ground.pose.expand(len(rollout.yaw), -1, -1))
    return Bodies.of(dense.xy, dense.yaw, ground.size[:, None])


def _attack(bodies: Bodies, ground: Ground) -> Tensor:
    gap = gaps(bodies, ground.target)
    return -_SOFT_M * torch.logsumexp(-gap.clamp(min=_TOUCHES_M).flatten(1) / _SOFT_M, dim=1)


def _violation(bodies: Bodies, ground: Ground) -> Tensor:
    inside = torch.zeros(len(bodies.radius), device=bodies.radius.device)
    if len(ground.others.radius):
        inside = depths(bodies.at(slice(None), slice(None), None), ground.others).amax(dim=(2, 3)).sum(1)
    if len(ground.size) > 1:
        inside = inside + _among(bodies)
    return inside + _over(bodies, ground).amax(-1).sum(1)


def _among(bodies: Bodies) -> Tensor:
    """Return (P,) how far attackers are inside each other."""
    count = bodies.radius.shape[1]
    first, second = torch.triu_indices(count, count, 1, device=bodies.radius.device)
    return depths(bodies.at(slice(None), first), bodies.at(slice(None), second)).amax(-1).sum(1)


def _over(bodies: Bodies, ground: Ground) -> Tensor:
    """Return (P, R, 2 H) metres over the road's edge."""
    points = bodies.centres[..., ::2, :].permute(1, 0, 2, 3, 4)  # (R, P, 2 H, 3, 2)
    flat = points.flatten(1, 3)[None]
    pose = ground.pose[:, :, None]
    local = into_frame(flat, pose[..., :2], pose[..., 2].expand(flat.shape[:-1]))
    clear = ground.edges.clearance(local).reshape(points.shape[:-1]).permute(1, 0, 2, 3)
    return (bodies.radius[..., None] - clear).clamp(min=0.0, max=4.0).amax(-1)
