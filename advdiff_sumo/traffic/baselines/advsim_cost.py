"""The cost that AdvSim's search minimises, for many candidates at once.

After the adversarial objective of Wang et al. 2021 (Sec. 3.2, doi:10.1109/CVPR46437.2021.00978): to collide with
the target, and to make its drive uncomfortable. The constraints are theirs: attackers touch no other vehicle and do
not leave the road.
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

_SOFT_M = 0.5
"""Softness of the smooth minimum over distances."""
_DEEPEST_M = -0.5
"""Overlaps deeper than this count no more in the attack."""
_NEAREST_OTHERS = 12
_VIOLATION_WEIGHT = 20.0
_TOLERANCE_M = 0.02


@dataclass(frozen=True)
class Ground:
    """The scene in which candidates are judged, cut to the search's horizon.

    Attributes:
        pose: (1, R, 4) x, y, yaw and speed of the attackers now.
        size: (R, 2) length and width of the attackers.
        edges: edges of the road in the attackers' frames.
        target: (2 H,) bodies of the target at half steps.
        others: (O, 2 H) bodies of the nearest other road users.
        allowed: violation of the constraints by the initial sequence, which a candidate may have too.
    """

    pose: Tensor
    size: Tensor
    edges: RoadEdges
    target: Bodies
    others: Bodies
    allowed: float = 0.0


def ground_of(rollout: Rollout, batch: SceneBatch, rows: Tensor, steps: int) -> Ground:
    """Return the scene for attackers *rows* (R,) in which the others drive *rollout* (1, A, T), the target in row 0."""
    dense = halves(cut(rollout, steps), batch.pose)
    xy, yaw, size = dense.xy[0], dense.yaw[0], batch.size[0]
    agents = torch.arange(batch.agents, device=rows.device)
    others = agents[(agents != 0) & ~torch.isin(agents, rows) & batch.present[0]]
    distance = (xy[others, None] - xy[rows][None]).norm(dim=-1).flatten(1).amin(1)
    others = others[torch.argsort(distance, stable=True)[:_NEAREST_OTHERS]]
    attackers = batch.rows_of(rows)
    target_bodies = Bodies.of(xy[0], yaw[0], size[:1])
    other_bodies = Bodies.of(xy[others], yaw[others], size[others, None])
    return Ground(attackers.pose, size[rows], RoadEdges.of(attackers), target_bodies, other_bodies)


def attack_cost(rollout: Rollout, ground: Ground) -> Tensor:
    """Return (P,) the smooth minimum distance in metres from candidates (P, R, H) to the target."""
    return _attack(_bodies(rollout, ground), ground)


def violation(rollout: Rollout, ground: Ground) -> Tensor:
    """Return (P,) metres by which attackers overlap others and cross the road's edge, their worst instants summed."""
    return _violation(_bodies(rollout, ground), ground)


def search_cost(rollout: Rollout, ground: Ground, changes: Tensor, effort: float) -> Tensor:
    """Return (P,) the cost that the search minimises."""
    bodies = _bodies(rollout, ground)
    excess = (_violation(bodies, ground) - ground.allowed).clamp(min=0.0)
    return (
        _attack(bodies, ground) + _VIOLATION_WEIGHT * excess + effort * changes.square().mean(dim=(1, 2, 3))
    )


def keeps_constraints(violated: float, ground: Ground) -> bool:
    """Return whether a violation of *violated* metres is no worse than that of the initial sequence."""
    return violated <= ground.allowed + _TOLERANCE_M


def discomfort(states: Tensor) -> float:
    """Return mean |acceleration| + mean |jerk| of the target's *states* (H + 1, 4) at model steps."""
    accel = torch.diff(states[:, 3]) / MODEL_STEP_S
    jerk = torch.diff(accel) / MODEL_STEP_S
    return float(accel.abs().mean() + jerk.abs().mean())


def _bodies(rollout: Rollout, ground: Ground) -> Bodies:
    """Return the bodies (P, R, 2 H) of the attackers at half steps."""
    dense = halves(rollout, ground.pose.expand(len(rollout.yaw), -1, -1))
    return Bodies.of(dense.xy, dense.yaw, ground.size[:, None])


def _attack(bodies: Bodies, ground: Ground) -> Tensor:
    gap = gaps(bodies, ground.target)
    return -_SOFT_M * torch.logsumexp(-gap.clamp(min=_DEEPEST_M).flatten(1) / _SOFT_M, dim=1)


def _violation(bodies: Bodies, ground: Ground) -> Tensor:
    overlap = torch.zeros(len(bodies.radius), device=bodies.radius.device)
    if len(ground.others.radius):
        overlap = depths(bodies.at(slice(None), slice(None), None), ground.others).amax(dim=(2, 3)).sum(1)
    if len(ground.size) > 1:
        overlap = overlap + _mutual_overlap(bodies)
    return overlap + _off_road(bodies, ground).amax(-1).sum(1)


def _mutual_overlap(bodies: Bodies) -> Tensor:
    """Return (P,) metres by which attackers overlap each other."""
    count = bodies.radius.shape[1]
    first, second = torch.triu_indices(count, count, 1, device=bodies.radius.device)
    return depths(bodies.at(slice(None), first), bodies.at(slice(None), second)).amax(-1).sum(1)


def _off_road(bodies: Bodies, ground: Ground) -> Tensor:
    """Return (P, R, 2 H) metres by which attackers are over the road's edge."""
    points = bodies.centres[..., ::2, :].permute(1, 0, 2, 3, 4)  # (R, P, 2 H, 3, 2)
    flat = points.flatten(1, 3)[None]
    pose = ground.pose[:, :, None]
    local = into_frame(flat, pose[..., :2], pose[..., 2].expand(flat.shape[:-1]))
    clearance = ground.edges.clearance(local).reshape(points.shape[:-1]).permute(1, 0, 2, 3)
    return (bodies.radius[..., None] - clearance).clamp(min=0.0, max=4.0).amax(-1)
