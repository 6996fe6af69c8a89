"""Baseline predictions without learning: constant velocity, and lane following."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.geometry import rotate
from advdiff_sumo.models.model_options import MODEL_STEP_S

Floats = NDArray[np.float64]
_IS_LANE, _FOR_CARS = 2, 8
_REACH_M, _JOIN_M = 3.0, 1.0
_ALIGNED_COS = 0.5


def constant_velocity(batch: SceneBatch) -> Rollout:
    """Return futures in which every agent goes straight ahead at its present speed."""
    way = _way(batch)
    local = torch.stack((way, torch.zeros_like(way)), dim=-1)
    return _in_scene(local, torch.zeros_like(way), batch)


def lane_following(batch: SceneBatch) -> Rollout:
    """Return futures in which every vehicle follows its lane at its present speed and lateral offset.

    Its lane is the nearest lane piece within 3 m in its direction. The lane continues with the piece that begins where
    it ends, at a fork with the one that turns least, and straight beyond the last known piece. A vehicle without a
    lane keeps its velocity.
    """
    way = _way(batch)
    out_xy = torch.stack((way, torch.zeros_like(way)), dim=-1)
    out_yaw = torch.zeros_like(way)
    usable = (
        batch.map_valid
        & (batch.map_features[..., _IS_LANE] > 0.5)
        & (batch.map_features[..., _FOR_CARS] > 0.5)
    )
    for b, a in torch.nonzero(batch.moved).tolist():
        pieces = batch.map_xy[b, a, usable[b, a]].double().cpu().numpy()
        path = lane_ahead(pieces, float(way[b, a, -1]))
        if path is not None:
            xy, yaw = _along(path, way[b, a].double().cpu().numpy())
            out_xy[b, a], out_yaw[b, a] = torch.from_numpy(xy).to(out_xy), torch.from_numpy(yaw).to(out_yaw)
    return _in_scene(out_xy, out_yaw, batch)


def lane_ahead(pieces: Floats, length_m: float) -> Floats | None:
    """Return the centre line (P, 2) of the lane of a vehicle at the origin with heading x.

    Args:
        pieces: (K, N, 2) lane pieces in the vehicle's frame.
        length_m: length ahead of the vehicle to cover, if there are enough pieces.

    Returns:
        Points from the beginning of the vehicle's piece on; None if it is on no lane.
    """
    if not len(pieces):
        return None
    distance = np.array([_project(piece)[0] for piece in pieces])
    heading = pieces[:, -1] - pieces[:, 0]
    aligned = heading[:, 0] > _ALIGNED_COS * np.linalg.norm(heading, axis=1)
    distance = np.where(aligned, distance, np.inf)
    current = int(distance.argmin())
    if distance[current] > _REACH_M:
        return None
    path, visited = [pieces[current]], {current}
    left = length_m - (_length(pieces[current]) - _project(pieces[current])[1])
    while left > 0.0:
        following = _next(pieces, current, visited)
        if following is None:
            break
        current = following
        visited.add(current)
        path.append(pieces[current][1:])
        left -= _length(pieces[current])
    return np.concatenate(path)


def _next(pieces: Floats, current: int, visited: set[int]) -> int | None:
    """Return the piece that begins where *current* ends and turns least; None if there is none."""
    end = pieces[current][-1]
    near = np.linalg.norm(pieces[:, 0] - end, axis=1) < _JOIN_M
    near[list(visited)] = False
    options = np.flatnonzero(near)
    if not len(options):
        return None
    direction = _unit(end - pieces[current][-2])
    whole = np.array([_unit(pieces[i][-1] - pieces[i][0]) for i in options])
    return int(options[(whole @ direction).argmax()])


def _along(path: Floats, way: Floats) -> tuple[Floats, Floats]:
    """Return positions (T, 2) and headings (T,) after *way* metres along *path*, at the origin's lateral offset."""
    steps = np.diff(path, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    keep = lengths > 1e-6
    start, unit, lengths = path[:-1][keep], steps[keep] / lengths[keep, None], lengths[keep]
    begin = np.concatenate(([0.0], np.cumsum(lengths)[:-1]))
    _, along_m, beside = _project(path)
    at = along_m + way
    index = np.clip(np.searchsorted(begin, at, side="right") - 1, 0, len(begin) - 1)
    direction = unit[index]
    left = np.stack((-direction[:, 1], direction[:, 0]), axis=-1)
    xy = start[index] + (at - begin[index])[:, None] * direction + beside * left
    return xy, np.arctan2(direction[:, 1], direction[:, 0])


def _project(line: Floats) -> tuple[float, float, float]:
    """Return distance, arc length and lateral offset (left positive) of the origin relative to *line* (P, 2)."""
    start, step = line[:-1], np.diff(line, axis=0)
    length = np.linalg.norm(step, axis=1)
    unit = step / np.maximum(length, 1e-9)[:, None]
    along = np.clip(-(start * unit).sum(1), 0.0, length)
    away = -(start + along[:, None] * unit)
    distance = np.linalg.norm(away, axis=1)
    i = int(distance.argmin())
    side = float(unit[i, 0] * away[i, 1] - unit[i, 1] * away[i, 0])
    return float(distance[i]), float(length[:i].sum() + along[i]), side


def _length(line: Floats) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _unit(vector: Floats) -> Floats:
    return vector / max(float(np.linalg.norm(vector)), 1e-9)


def _way(batch: SceneBatch) -> Tensor:
    """Return the distances (B, A, T) that agents drive at their present speeds."""
    steps = torch.arange(1, batch.future.shape[2] + 1, device=batch.past.device, dtype=batch.past.dtype)
    return batch.pose[..., 3, None].clamp(min=0.0) * steps * MODEL_STEP_S


def _in_scene(local: Tensor, turn: Tensor, batch: SceneBatch) -> Rollout:
    now = batch.pose[:, :, None]
    xy = now[..., :2] + rotate(local, now[..., 2].expand(turn.shape))
    speed = now[..., 3].clamp(min=0.0).expand(turn.shape)
    nothing = torch.zeros_like(turn)
    return Rollout(xy, now[..., 2] + turn, speed, nothing, nothing)
