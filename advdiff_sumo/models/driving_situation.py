"""Features of the driving situation: signal ahead, lead vehicle, speed limit.

The context embedding hardly distinguishes a red light from a green one: in recordings a vehicle that has stood for two
seconds mostly stays standing, so the embedding did not need to. These features state it explicitly.
"""

from __future__ import annotations

import torch
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.geometry import into_frame
from advdiff_sumo.models.model_options import PIECE_FEATURES

SITUATION_FEATURES = 11
_SPEED, _IS_LANE = 1, 2  # columns of ``maps.vector_map.Feature``
_LIGHTS = slice(PIECE_FEATURES - 3, PIECE_FEATURES)  # red, yellow, green
_BEHIND_LINE_M, _ASIDE_M, _ALIGNED_RAD = 3.0, 1.75, 0.5
_NEAR_M, _FAR_M = 3.0, 15.0
_OFF_LANE_M, _CORRIDOR_M = 6.0, 0.2
_STANDS_MPS, _SPEED_MPS = 0.3, 10.0


def situation_features(batch: SceneBatch) -> Tensor:
    """Return 11 columns (B, A, F) for every agent; speeds in 10 m/s.

    Signals (3): exp(−distance / 15 m) to the nearest stop line straight ahead with a red, yellow, green light, else 0.
    Lead vehicle (5): exp(−gap / 3 m) to the nearest box straight ahead, f = exp(−gap / 15 m), f × its speed along
    the agent's heading, f if it stands (else 0), f × closing speed; all 0 without one. Speed (3): limit of the agent's
    lane (off the lanes its speed), that limit minus its speed, its speed.
    """
    return torch.cat((_lights(batch), _leader(batch), _limit(batch)), dim=-1)


def _aligned_lanes(batch: SceneBatch) -> Tensor:
    """Return (B, A, K) which map pieces are lanes whose first segment has the agent's direction."""
    way = batch.map_xy[..., 1, :] - batch.map_xy[..., 0, :]
    turned = torch.atan2(way[..., 1], way[..., 0]).abs()
    return batch.map_valid & (batch.map_features[..., _IS_LANE] > 0.5) & (turned < _ALIGNED_RAD)


def _lights(batch: SceneBatch) -> Tensor:
    line = batch.map_xy[..., 0, :]
    way_m = line[..., 0] - 0.5 * batch.size[..., None, 0]
    ahead = _aligned_lanes(batch) & (way_m > -_BEHIND_LINE_M) & (line[..., 1].abs() < _ASIDE_M)
    near = torch.exp(-way_m.clamp(min=0.0) / _FAR_M) * ahead
    return (near[..., None] * batch.map_features[..., _LIGHTS]).amax(dim=-2)


def _leader(batch: SceneBatch) -> Tensor:
    pose, size = batch.pose, batch.size
    position, yaw = pose[:, :, None, :2], pose[:, :, None, 2]
    at = into_frame(pose[:, None, :, :2], position, yaw.expand(-1, -1, pose.shape[1]))
    gap_m = at[..., 0] - 0.5 * (size[:, :, None, 0] + size[:, None, :, 0])
    aside_m = at[..., 1].abs() - 0.5 * (size[:, :, None, 1] + size[:, None, :, 1])
    others = batch.present[:, None] & ~torch.eye(pose.shape[1], dtype=torch.bool, device=pose.device)
    ahead = others & (at[..., 0] > 0.0) & (aside_m < _CORRIDOR_M)
    gap_m, which = torch.where(ahead, gap_m, torch.inf).min(dim=-1)
    along = pose[:, None, :, 3] * torch.cos(pose[:, None, :, 2] - yaw)
    speed = along.gather(-1, which[..., None])[..., 0]
    near, far = (torch.exp(-gap_m.clamp(min=0.0) / scale) for scale in (_NEAR_M, _FAR_M))
    closing = (pose[..., 3] - speed) / _SPEED_MPS
    return torch.stack(
        (near, far, far * speed / _SPEED_MPS, far * (speed.abs() < _STANDS_MPS), far * closing), dim=-1
    )


def _limit(batch: SceneBatch) -> Tensor:
    x, y = batch.map_xy[..., 0], batch.map_xy[..., 1]
    away = (y.abs() + 0.1 * x.abs()).amin(dim=-1)
    away, which = torch.where(_aligned_lanes(batch), away, torch.inf).min(dim=-1)
    limit = batch.map_features[..., _SPEED].gather(-1, which[..., None])[..., 0]
    speed = batch.pose[..., 3]
    limit = torch.where(away < _OFF_LANE_M, limit, speed)
    return torch.stack((limit, limit - speed, speed), dim=-1) / _SPEED_MPS
