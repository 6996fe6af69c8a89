"""The centre line that a vehicle follows along its route, from the map that the planner kit gives."""

from __future__ import annotations

import numpy as np
from advdiff_sumo.planner_kit import KitRoad, Scene

_FAR_M, _TURN_M_PER_RAD = 6.0, 3.0


def route_line(road: KitRoad, scene: Scene, ahead_m: float, behind_m: float = 20.0):
    """Return points (P, 2) a metre apart, from *behind_m* before the vehicle's lane on, and the speed limit there.

    None where no lane of the route is near. The vehicle stays in its lane as far as the route's links allow.
    """
    now, me = scene.history, scene.target
    xy, yaw = now.xy_m[me, -1], float(now.yaw_rad[me, -1])
    route = set(scene.routes[me])
    best, least = None, _FAR_M
    for lane in road.lanes.values():
        if lane.is_internal or lane.edge_id in route:
            away = _distance(lane.centre_xy_m, xy, yaw)
            if away < least:
                best, least = lane, away
    if best is None:
        return None
    parts, lane, length = [], best, 0.0
    while lane is not None and length < ahead_m + best.length_m:
        parts.append(lane.centre_xy_m)
        length += lane.length_m
        lane = _following(road, lane, route)
    return _resampled(np.concatenate(parts), behind_m), best.speed_mps


def _distance(line: np.ndarray, xy: np.ndarray, yaw: float) -> float:
    """Return the least distance of *xy* to a centre line, more where it leads elsewhere."""
    a, step = line[:-1], np.diff(line, axis=0)
    share = np.clip(((xy - a) * step).sum(1) / np.maximum((step**2).sum(1), 1e-9), 0.0, 1.0)
    away = np.linalg.norm(a + share[:, None] * step - xy, axis=1)
    turn = np.abs(np.angle(np.exp(1j * (np.arctan2(step[:, 1], step[:, 0]) - yaw))))
    return float((away + _TURN_M_PER_RAD * turn).min())


def _following(road: KitRoad, lane, route: set[str]):
    for link in lane.successors:
        to = road.lanes[link.to_lane]
        if to.edge_id in route:
            return road.lanes[link.via[0]] if link.via else to
    return None


def _resampled(points: np.ndarray, behind_m: float) -> np.ndarray:
    """Return *points* a metre apart, led on straight at both ends."""
    points = points[np.r_[True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 0.05]]
    first, last = points[0] - points[1], points[-1] - points[-2]
    head = points[0] + behind_m * first / np.linalg.norm(first)
    tail = points[-1] + 40.0 * last / np.linalg.norm(last)
    points = np.vstack((head, points, tail))
    s = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    at = np.arange(0.0, s[-1], 1.0)
    line = np.stack((np.interp(at, s, points[:, 0]), np.interp(at, s, points[:, 1])), axis=-1)
    kernel = np.ones(7) / 7.0  # corners of polylines are no curves that its Frenet frame could follow
    inner = np.stack([np.convolve(line[:, k], kernel, "valid") for k in (0, 1)], axis=-1)
    return np.vstack((line[:3], inner, line[-3:]))
