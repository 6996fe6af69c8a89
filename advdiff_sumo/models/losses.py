"""Reconstruction loss and differentiable penalties of collisions and of leaving the road.

A vehicle is represented by five discs along its length, as in TrafficSim (Suo et al. 2021,
doi:10.1109/CVPR46437.2021.01026). The penalty decreases linearly with the distance of two discs, to 0 at contact.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import smooth_l1_loss

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.geometry import into_frame, wrap_angle
from advdiff_sumo.models.road_edges import RoadEdges

DISCS = 5
_LEAST_REACH_M = 0.1


def reconstruction(rollout: Rollout, batch: SceneBatch) -> Tensor:
    """Return (B, A, T) errors of a rollout from the recorded future: Huber loss of position, heading and speed.

    Position errors are along and across the true heading; errors across have five times the weight, as half a metre
    beside the lane is worse than half a metre along it.
    """
    future = batch.future
    error = into_frame(rollout.xy, future[..., :2], future[..., 2]) * rollout.xy.new_tensor((1.0, 5.0))
    place = smooth_l1_loss(error, torch.zeros_like(error), reduction="none", beta=1.0).sum(-1)
    turn = wrap_angle(rollout.yaw - future[..., 2])
    heading = smooth_l1_loss(5.0 * turn, torch.zeros_like(turn), reduction="none")
    speed = smooth_l1_loss(rollout.speed, future[..., 3], reduction="none")
    known = batch.future_valid & batch.moved[..., None]
    return torch.where(known, place + heading + 0.5 * speed, 0.0)


def masked_mean(value: Tensor, mask: Tensor) -> Tensor:
    """Return the mean of *value* over *mask*; 0 if the mask is empty."""
    return torch.where(mask, value, 0.0).sum() / mask.sum().clamp(min=1)


def discs(xy: Tensor, yaw: Tensor, size: Tensor) -> tuple[Tensor, Tensor]:
    """Return centres (…, 5, 2) and radius (…,) of the discs that represent boxes at *xy* (…, 2) of *size* (…, 2)."""
    length, radius = size[..., 0], 0.5 * size[..., 1]
    offsets = torch.linspace(-1.0, 1.0, DISCS, device=xy.device, dtype=xy.dtype)
    along = (0.5 * length - radius).clamp(min=0.0)[..., None] * offsets
    ahead = torch.stack((torch.cos(yaw), torch.sin(yaw)), dim=-1)
    return xy[..., None, :] + along[..., None] * ahead[..., None, :], radius


def pair_overlap(rollout: Rollout, size: Tensor, present: Tensor) -> Tensor:
    """Return (B, A, A, T) overlap of every two agents in [0, 1]: 1 − d / (r_i + r_j), zero where discs are apart.

    Boxes have *size* (B, A, 2); agents that are not *present* (B, A) overlap no others.
    """
    squared, reach = disc_pairs(rollout, size)
    gap = torch.sqrt(squared.amin(-1) + 1e-9)
    return between_two((1.0 - gap / reach).clamp(min=0.0), present)


def between_two(value: Tensor, present: Tensor) -> Tensor:
    """Return *value* (B, A, A, T) for pairs of different agents that are *present* (B, A), 0 for all others."""
    others = present[:, :, None] & present[:, None]
    others = others & ~torch.eye(present.shape[1], dtype=torch.bool, device=present.device)
    return torch.where(others[..., None], value, 0.0)


def disc_pairs(rollout: Rollout, size: Tensor) -> tuple[Tensor, Tensor]:
    """Return the squared distances of all pairs of disc centres (B, A, A, T, 25) and the sums of radii (B, A, A, 1)."""
    steps = rollout.xy.shape[2]
    centres, radius = discs(rollout.xy, rollout.yaw, size[:, :, None].expand(-1, -1, steps, -1))
    own_centres, other_centres = centres[:, :, None, :, :, None], centres[:, None, :, :, None]
    squared = (own_centres - other_centres).square().sum(-1).flatten(-2)
    wide = radius[:, :, 0]
    # padding has no width: dividing by 0 would make all gradients NaN
    reach = (wide[:, :, None] + wide[:, None]).clamp(min=_LEAST_REACH_M)
    return squared, reach[..., None]


def edge_clearance(xy: Tensor, batch: SceneBatch) -> Tensor:
    """Return signed distances (B, A, M) of points *xy* (B, A, M, 2) in the scene's frame to the nearest road edge.

    Positive on the road, large without an edge. Only each agent's own map pieces are searched.
    """
    pose = batch.pose[:, :, None]
    local = into_frame(xy, pose[..., :2], pose[..., 2].expand(xy.shape[:-1]))
    return RoadEdges.of(batch).clearance(local)


def off_road(rollout: Rollout, batch: SceneBatch, edges: RoadEdges | None = None) -> Tensor:
    """Return (B, A, T) how far a vehicle's discs are beyond the road edge, as a share of its width, at most 2.

    *edges* are those of *batch*; None: computed anew.
    """
    edges = RoadEdges.of(batch) if edges is None else edges
    over = beyond_edge(rollout, batch.size, batch.pose, edges)
    return torch.where(batch.moved[..., None], over, 0.0)


def beyond_edge(rollout: Rollout, size: Tensor, pose: Tensor, edges: RoadEdges) -> Tensor:
    """Return :func:`off_road` for vehicles of *size* (B, A, 2), with *edges* in the frames of *pose* (B, A, 4)."""
    steps = rollout.xy.shape[2]
    centres, radius = discs(rollout.xy, rollout.yaw, size[:, :, None].expand(-1, -1, steps, -1))
    points, origin = centres[..., ::2, :].flatten(2, 3), pose[:, :, None]
    local = into_frame(points, origin[..., :2], origin[..., 2].expand(points.shape[:-1]))
    clear = edges.clearance(local).reshape(*radius.shape, -1)
    over = ((radius[..., None] - clear) / (2.0 * radius[..., None].clamp(min=0.1))).clamp(0.0, 2.0)
    return over.amax(-1)
