"""Predict the others at constant speed: along their lane, or straight on if they are on none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from advdiff_sumo.planner_kit import KitRoad, Scene

NEAR_M, ALIGNED_RAD = 2.0, 0.5  # largest distance and heading error to a vehicle's lane
RANGE_M = 100.0  # others farther away are left out


@dataclass(frozen=True)
class LaneSegments:
    """The M straight pieces of the centre lines of all lanes.

    Attributes:
        start_m, step_m: (M, 2) start, and vector from start to end.
        lane_ids: lanes of the pieces.
        numbers: (M,) index of the piece in its lane.
    """

    start_m: np.ndarray
    step_m: np.ndarray
    lane_ids: tuple[str, ...]
    numbers: np.ndarray


def lane_segments(road: KitRoad) -> LaneSegments:
    """Return the pieces of all lanes for vehicles."""
    lanes = [lane for lane in road.lanes.values() if "passenger" in lane.allows or lane.is_internal]
    start = np.concatenate([lane.centre_xy_m[:-1] for lane in lanes])
    step = np.concatenate([np.diff(lane.centre_xy_m, axis=0) for lane in lanes])
    ids = tuple(lane.id for lane in lanes for _ in range(len(lane.centre_xy_m) - 1))
    numbers = np.concatenate([np.arange(len(lane.centre_xy_m) - 1) for lane in lanes])
    return LaneSegments(start, step, ids, numbers)


def predicted_poses(
    road: KitRoad, segments: LaneSegments, scene: Scene, steps: int, step_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return future poses (A, steps + 1, 3: x, y, yaw) of the others within ``RANGE_M``, and their boxes (A, 2)."""
    now, me = scene.history, scene.target
    distance = np.linalg.norm(now.xy_m[:, -1] - now.xy_m[me, -1], axis=-1)
    rows = [row for row in np.flatnonzero(now.valid[:, -1]) if row != me and distance[row] < RANGE_M]
    times = step_s * np.arange(steps + 1)
    poses = [
        _poses(road, segments, now.xy_m[r, -1], now.yaw_rad[r, -1], now.speed_mps[r, -1] * times)
        for r in rows
    ]
    return np.array(poses).reshape(len(rows), steps + 1, 3), now.size_m[rows]


def _poses(
    road: KitRoad, segments: LaneSegments, xy: np.ndarray, yaw: float, way_m: np.ndarray
) -> np.ndarray:
    """Return poses (T, 3) of a vehicle that drives the distances *way_m* (T,) with its present lateral offset."""
    heading = np.array([np.cos(yaw), np.sin(yaw)])
    piece = _nearest_piece(segments, xy, heading) if way_m[-1] > 0.0 else None
    if piece is None:
        return np.column_stack((xy + way_m[:, None] * heading, np.full(len(way_m), yaw)))
    line = _lane_ahead(road, segments.lane_ids[piece], int(segments.numbers[piece]), way_m[-1] + 1.0)
    length = np.linalg.norm(np.diff(line, axis=0), axis=1)
    s = np.r_[0.0, np.cumsum(length)]
    tangent = np.diff(line, axis=0) / length[:, None]
    s0 = float((xy - line[0]) @ tangent[0])
    offset = float(tangent[0, 0] * (xy - line[0])[1] - tangent[0, 1] * (xy - line[0])[0])
    number = np.clip(np.searchsorted(s, s0 + way_m, "right") - 1, 0, len(tangent) - 1)
    direction = tangent[number]
    centre = line[number] + (s0 + way_m - s[number])[:, None] * direction
    line_yaw = np.unwrap(np.arctan2(direction[:, 1], direction[:, 0]))
    return np.column_stack((centre + offset * direction[:, ::-1] * [-1.0, 1.0], yaw + line_yaw - line_yaw[0]))


def _nearest_piece(segments: LaneSegments, xy: np.ndarray, heading: np.ndarray) -> int | None:
    """Return the index of the nearest piece that is aligned with *heading*; None if none is near."""
    square = np.maximum((segments.step_m**2).sum(1), 1e-9)
    share = np.clip(((xy - segments.start_m) * segments.step_m).sum(1) / square, 0.0, 1.0)
    distance = np.linalg.norm(segments.start_m + share[:, None] * segments.step_m - xy, axis=1)
    distance[segments.step_m @ heading < np.cos(ALIGNED_RAD) * np.sqrt(square)] = np.inf
    nearest = int(distance.argmin())
    return nearest if distance[nearest] < NEAR_M else None


def _lane_ahead(road: KitRoad, lane_id: str, number: int, length_m: float) -> np.ndarray:
    """Return the centre line from piece *number* of a lane on, continued over the next lanes, preferably straight.

    It is at least *length_m* long, unless the lanes end before.
    """
    lane, lines, length = road.lanes[lane_id], [], 0.0
    points = lane.centre_xy_m[number:]
    while True:
        lines.append(points)
        length += float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        links = sorted(lane.successors, key=lambda link: link.direction != "s")
        if length > length_m + lane.length_m or not links:
            break
        lane = road.lanes[links[0].via[0] if links[0].via else links[0].to_lane]
        points = lane.centre_xy_m
    line = np.concatenate(lines)
    return line[np.r_[True, np.linalg.norm(np.diff(line, axis=0), axis=1) > 0.05]]
