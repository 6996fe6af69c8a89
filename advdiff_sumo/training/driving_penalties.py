"""Differentiable penalties of joint futures: leaving the lane, following too close."""

from __future__ import annotations

import torch
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.geometry import from_segments, into_frame
from advdiff_sumo.models.lane_attention import LanePieces
from advdiff_sumo.models.neighbours import Neighbours
from advdiff_sumo.models.proximity import lead_gaps

_ALIGNED_COS = 0.5
_BESIDE_M, _ASTRAY_M = 1.2, 3.0
_STANDSTILL_M, _HEADWAY_S = 0.5, 0.6
_BRAKE_MPS2, _MOST = 4.0, 2.0
_LEAST_M = 0.3
_INSIDE = 0.5
_FAR_M = 1e4


def lane_distance(rollout: Rollout, batch: SceneBatch) -> Tensor:
    """Return (B, A) distances beyond 1.2 m from the nearest lane in the vehicle's direction, mean over time.

    At most 3 m at each instant: beyond that, as behind the last known lane piece, it has no gradient.
    """
    pose = batch.pose[:, :, None]
    yaw = pose[..., 2].expand(rollout.yaw.shape)
    place, turn = into_frame(rollout.xy, pose[..., :2], yaw), rollout.yaw - yaw
    lanes = LanePieces.of(batch)
    xy = lanes.xy
    first, along = xy[..., :-1, :].flatten(2, 3), (xy[..., 1:, :] - xy[..., :-1, :]).flatten(2, 3)
    real = lanes.valid[..., None].expand(*xy.shape[:3], xy.shape[3] - 1).flatten(2)
    ahead = torch.stack((torch.cos(turn), torch.sin(turn)), dim=-1).detach()
    length = along.norm(dim=-1).clamp(min=1e-3)
    with torch.no_grad():
        aligned = torch.einsum("batc,basc->bats", ahead, along / length[..., None]) > _ALIGNED_COS
        usable = aligned & real[:, :, None]
        apart, *_ = from_segments(place[:, :, :, None], first[:, :, None], along[:, :, None])
        which = apart.square().sum(-1).masked_fill(~usable, _FAR_M**2).argmin(-1)
        is_near_lane = usable.gather(-1, which[..., None]).squeeze(-1)
    index = which[..., None].expand(*which.shape, 2)
    away, *_ = from_segments(place, first.gather(2, index), along.gather(2, index))
    distance = torch.sqrt(away.square().sum(-1) + 1e-6)
    beyond = torch.where(is_near_lane, (distance - _BESIDE_M).clamp(0.0, _ASTRAY_M - _BESIDE_M), 0.0)
    return beyond.mean(-1)


def following_penalty(rollout: Rollout, batch: SceneBatch) -> Tensor:
    """Return (B, A) penalties of following too close, mean over time and summed over the vehicles ahead.

    The sum of the relative lack of a gap of 0.5 m plus 0.6 s, and the relative excess over 4 m/s² of the deceleration
    required to avoid contact, at most 2.
    """
    scenes, agents, steps = rollout.yaw.shape
    xy, yaw, speed = (
        value.transpose(1, 2).flatten(0, 1) for value in (rollout.xy, rollout.yaw, rollout.speed)
    )
    size = batch.size[:, None].expand(-1, steps, -1, -1).flatten(0, 1)
    lead = lead_gaps(Neighbours.of(xy, yaw, speed, size, torch.arange(agents, device=xy.device)))
    gap, own = lead.gap_m.clamp(min=0.0), speed[:, :, None]
    short = (1.0 - gap / (_STANDSTILL_M + _HEADWAY_S * own)).clamp(min=0.0)
    brake = lead.closing_mps.clamp(min=0.0).square() / (2.0 * gap.clamp(min=_LEAST_M))
    hard = (brake / _BRAKE_MPS2 - 1.0).clamp(0.0, _MOST)
    behind = (lead.inside > _INSIDE) & (lead.gap_m > 0.0)
    each = torch.where(behind, short + hard, 0.0).reshape(scenes, steps, agents, agents)  # (B, T, A, A)
    is_present = batch.present[:, None, :, None] & batch.present[:, None, None]
    return torch.where(is_present, each, 0.0).sum(-1).mean(1)


def travelled_m(rollout: Rollout, batch: SceneBatch) -> Tensor:
    """Return the distances (B, A) in metres that vehicles drive before the first instant that the log lacks."""
    before = torch.cat((batch.pose[:, :, None, :2], rollout.xy[:, :, :-1]), dim=2)
    known = batch.future_valid.cumprod(-1).bool()
    stride = torch.sqrt((rollout.xy - before).square().sum(-1) + 1e-9)
    return torch.where(known, stride, 0.0).sum(-1)
