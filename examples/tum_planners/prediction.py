"""Where the others will be: along their lane at their speed, straight on where they are in none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from advdiff_sumo.planner_kit import KitRoad, Scene

NEAR_M, ALIGNED_RAD, RANGE_M = 2.0, 0.5, 100.0


@dataclass(frozen=True)
class LaneSegments:
    """Every piece of every lane's centre line.

    Attributes:
        start_m, step_m: (M, 2).
        lane_ids: of the M pieces.
        numbers: (M,) which piece of its lane.
    """

    start_m: np.ndarray
    step_m: np.ndarray
    lane_ids: tuple[str, ...]
    numbers: np.ndarray


def lane_segments(road: KitRoad) -> LaneSegments:
    """Return the pieces of all lanes that vehicles use."""
    lanes = [lane for lane in road.lanes.values() if "passenger" in lane.allows or lane.is_internal]
    start = np.concatenate([lane.centre_xy_m[:-1] for lane in lanes])
    step = np.concatenate([np.diff(lane.centre_xy_m, axis=0) for lane in lanes])
    ids = tuple(lane.id for lane in lanes for _ in range(len(lane.centre_xy_m) - 1))
    numbers = np.concatenate([np.arange(len(lane.centre_xy_m) - 1) for lane in lanes])
    return LaneSegments(start, step, ids, numbers)


def predicted_poses(
    road: KitRoad, segments: LaneSegments, scene: Scene, steps: int, step_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return poses (A, steps + 1, 3) of the others within reach from now on (x, y, yaw), and their boxes (A, 2)."""
    now, me = scene.history, scene.target
    away = np.linalg.norm(now.xy_m[:, -1] - now.xy_m[me, -1], axis=-1)
    rows = [row for row in np.flatnonzero(now.valid[:, -1]) if row != me and away[row] < RANGE_M]
    times = step_s * np.arange(steps + 1)
    poses = [
        _poses(road, segments, now.xy_m[r, -1], now.yaw_rad[r, -1], now.speed_mps[r, -1] * times)
        for r in rows
    ]
    return np.array(poses).reshape(len(rows), steps + 1, 3), now.size_m[rows]


def _poses(
    road: KitRoad, segments: LaneSegments, xy: np.ndarray, yaw: float, way_m: np.ndarray
) -> np.ndarray:
    heading = np.array([np.cos(yaw), np.sin(yaw)])
    piece = _nearest_piece(segments, xy, heading) if way_m[-1] > 0.0 else None
    if piece is None:
        return np.column_stack((xy + way_m[:, None] * heading, np.full(len(way_m), yaw)))
    line = _lane_ahead(road, segments.lane_ids[piece], int(segments.numbers[piece]), way_m[-1] + 1.0)
    length = np.linalg.norm(np.diff(line, axis=0), axis=1)
    s = np.r_[0.0, np.cumsum(length)]
    tangent = np.diff(line, axis=0) / length[:, None]
    s0 = float((xy - line[0]) @ tangent[0])
    side = float(tangent[0, 0] * (xy - line[0])[1] - tangent[0, 1] * (xy - line[0])[0])
    number = np.clip(np.searchsorted(s, s0 + way_m, "right") - 1, 0, len(tangent) - 1)
    along = tangent[number]
    centre = line[number] + (s0 + way_m - s[number])[:, None] * along
    turned = np.unwrap(np.arctan2(along[:, 1], along[:, 0]))
    return np.column_stack((centre + side * along[:, ::-1] * [-1.0, 1.0], yaw + turned - turned[0]))


def _nearest_piece(segments: LaneSegments, xy: np.ndarray, heading: np.ndarray) -> int | None:
    square = np.maximum((segments.step_m**2).sum(1), 1e-9)
    share = np.clip(((xy - segments.start_m) * segments.step_m).sum(1) / square, 0.0, 1.0)
    away = np.linalg.norm(segments.start_m + share[:, None] * segments.step_m - xy, axis=1)
    away[segments.step_m @ heading < np.cos(ALIGNED_RAD) * np.sqrt(square)] = np.inf
    nearest = int(away.argmin())
    return nearest if away[nearest] < NEAR_M else None


def _lane_ahead(road: KitRoad, lane_id: str, number: int, length_m: float) -> np.ndarray:
    """Return the centre line from piece *number* on, and what follows straight on, at least *length_m*."""
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
