"""Make the reference line of a vehicle along its route, with permitted speeds, from the planner kit's map."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from advdiff_sumo.planner_kit import KitRoad, Scene

NEAR_M = 6.0  # largest distance from the vehicle to its own lane
M_PER_RAD = 3.0  # weight of the heading error in that distance
SPACING_M, SMOOTHED = 1.0, 7  # spacing of the line; number of points of its moving mean
LATERAL_MPS2 = 2.0  # comfortable lateral acceleration in bends
BRAKE_MPS2 = 2.0  # comfortable deceleration
HARD_MPS2 = 3.5  # largest deceleration for a yellow light
STOP_GAP_M = 1.0


@dataclass(frozen=True)
class ReferenceLine:
    """A line of points that are a metre apart.

    Attributes:
        xy_m: (P, 2) the points, from behind the vehicle on.
        limit_mps: (P,) speed limit, reduced in bends.
        s_m: arc length of the vehicle's centre.
        stop_s_m: arc length at which the vehicle's front must stop; infinity: no stop.
    """

    xy_m: np.ndarray
    limit_mps: np.ndarray
    s_m: float
    stop_s_m: float

    def desired_mps(self, length_m: float) -> float:
        """Return the largest speed from which comfortable braking respects every limit ahead and the stop."""
        ahead = SPACING_M * np.arange(len(self.xy_m)) - self.s_m
        limits = np.sqrt(self.limit_mps**2 + 2.0 * BRAKE_MPS2 * np.maximum(ahead, 0.0))
        gap = self.stop_s_m - STOP_GAP_M - self.s_m - 0.5 * length_m
        to_stop = np.sqrt(2.0 * BRAKE_MPS2 * max(gap, 0.0))
        return float(min(limits[ahead > -SPACING_M].min(), to_stop))


def reference_line(
    road: KitRoad, scene: Scene, ahead_m: float, behind_m: float = 30.0
) -> ReferenceLine | None:
    """Return the joined and smoothed centre lines along the route; None if no lane of the route is near.

    If the vehicle's lane does not continue along the route, the line follows a neighbouring lane that does, so that the
    planner changes lanes.
    """
    now, me = scene.history, scene.target
    xy, yaw = now.xy_m[me, -1], float(now.yaw_rad[me, -1])
    lanes = lanes_along(road, scene.routes[me], xy, yaw, ahead_m)
    if not lanes:
        return None
    points, limits = _joined(lanes)
    line, speeds = _resampled(points, limits, behind_m)
    s = SPACING_M * float(np.linalg.norm(line - xy, axis=1).argmin())
    first = max(0, int((s - behind_m) / SPACING_M))
    last = int((s + ahead_m) / SPACING_M)
    line, speeds = line[first:last], speeds[first:last]
    s -= first * SPACING_M
    front = s + 0.5 * float(now.size_m[me, 0])
    stop = _stop_point(lanes, scene, float(now.speed_mps[me, -1]))
    stop_s = float("inf") if stop is None else SPACING_M * float(np.linalg.norm(line - stop, axis=1).argmin())
    if stop_s < front - 2.0:  # the vehicle has already passed the stop
        stop_s = float("inf")
    return ReferenceLine(line, np.minimum(speeds, bend_limit_mps(line)), s, stop_s)


def lanes_along(
    road: KitRoad, route: tuple[str, ...], xy_m: np.ndarray, yaw_rad: float, ahead_m: float
) -> list:
    """Return the lanes to follow, including those on junctions, starting at the vehicle's lane or a neighbour."""
    lane, place = _own_lane(road, route, xy_m, yaw_rad)
    if lane is None:
        return []
    if not lane.is_internal:
        lanes_of_edge = [other for other in road.lanes.values() if other.edge_id == lane.edge_id]
        lane = max(
            lanes_of_edge,
            key=lambda other: (_reach_m(road, other, route, place, ahead_m), -abs(other.index - lane.index)),
        )
    lanes, length = [lane], 0.0
    while lane is not None and length < ahead_m + lanes[0].length_m:
        following = _following(road, lane, route, place, ahead_m)
        if following is None:
            break
        via, lane = following
        place += 1
        lanes += [*via, lane]
        length += lane.length_m + sum(part.length_m for part in via)
    return lanes


def _own_lane(road: KitRoad, route: tuple[str, ...], xy_m: np.ndarray, yaw_rad: float):
    """Return the nearest lane of the route's next edges or of a junction between them, and its edge's index in *route*.

    Return (None, 0) if no such lane is near.
    """
    places = {edge: number for number, edge in reversed(list(enumerate(route[:4])))}
    candidates = {}
    for lane in road.lanes.values():
        place = places.get(lane.edge_id)
        if place is None:
            continue
        candidates[lane.id] = (lane, place)
        for link in lane.successors:
            if places.get(road.lanes[link.to_lane].edge_id) == place + 1:
                candidates.update({via: (road.lanes[via], place) for via in link.via})
    distance = {name: offset_m(lane.centre_xy_m, xy_m, yaw_rad) for name, (lane, _) in candidates.items()}
    nearest = min(distance, key=distance.__getitem__, default=None)
    return candidates[nearest] if nearest is not None and distance[nearest] < NEAR_M else (None, 0)


def _reach_m(road: KitRoad, lane, route: tuple[str, ...], place: int, most_m: float) -> float:
    """Return how far the route can be followed from *lane* without a lane change, up to *most_m* plus one lane."""
    if most_m <= 0.0 or place + 1 >= len(route):
        return max(most_m, 0.0)
    onward = [road.lanes[link.to_lane] for link in lane.successors]
    reaches = [
        lane.length_m + _reach_m(road, to, route, place + 1, most_m - lane.length_m)
        for to in onward
        if to.edge_id == route[place + 1]
    ]
    return max(reaches, default=0.0)


def _following(road: KitRoad, lane, route: tuple[str, ...], place: int, ahead_m: float):
    """Return the junction's lanes after *lane*, and the next lane of the route; None if there is none."""
    if place + 1 >= len(route):
        return None
    if lane.is_internal:
        links = lane.successors
        onward = [((), road.lanes[link.to_lane]) for link in links]
        onward = [(via, to) for via, to in onward if to.is_internal or to.edge_id == route[place + 1]]
        if onward and onward[0][1].is_internal:
            later = _following(road, onward[0][1], route, place, ahead_m)
            return None if later is None else ((onward[0][1], *later[0]), later[1])
    else:
        onward = [
            (tuple(road.lanes[via] for via in link.via), road.lanes[link.to_lane])
            for link in lane.successors
            if road.lanes[link.to_lane].edge_id == route[place + 1]
        ]
    return max(onward, key=lambda pair: _reach_m(road, pair[1], route, place + 1, ahead_m), default=None)


def offset_m(line: np.ndarray, xy_m: np.ndarray, yaw_rad: float) -> float:
    """Return the least distance of a point to *line*, increased by the heading error to *yaw_rad*."""
    start, step = line[:-1], np.diff(line, axis=0)
    share = np.clip(((xy_m - start) * step).sum(1) / np.maximum((step**2).sum(1), 1e-9), 0.0, 1.0)
    distance = np.linalg.norm(start + share[:, None] * step - xy_m, axis=1)
    turn = np.abs(np.angle(np.exp(1j * (np.arctan2(step[:, 1], step[:, 0]) - yaw_rad))))
    return float((distance + M_PER_RAD * turn).min())


def bend_limit_mps(line: np.ndarray) -> np.ndarray:
    """Return (P,) comfortable speeds in the bends of a line whose points are a metre apart."""
    step = np.diff(line, axis=0)
    turn = np.abs(np.diff(np.unwrap(np.arctan2(step[:, 1], step[:, 0])))) / SPACING_M
    curvature = np.convolve(np.r_[0.0, turn, 0.0], np.ones(3) / 3.0, "same")
    return np.sqrt(LATERAL_MPS2 / np.maximum(curvature, 1e-3))


def _stop_point(lanes: list, scene: Scene, speed_mps: float):
    """Return the end of the first lane at which the vehicle must stop for a signal; None if there is none."""
    now, me = scene.history, scene.target
    for lane, after in pairwise(lanes):
        for link in lane.successors:
            if lane.is_internal or link.tls_id is None or (link.via[:1] or (link.to_lane,))[0] != after.id:
                continue
            letter = scene.signals[link.tls_id][link.tls_index]
            end = lane.centre_xy_m[-1]
            gap = float(np.linalg.norm(end - now.xy_m[me, -1])) - 0.5 * float(now.size_m[me, 0])
            stops_at_yellow = letter in "yY" and speed_mps**2 < 2.0 * HARD_MPS2 * max(gap, 0.1)
            if letter in "rRu" or stops_at_yellow:
                return end
    return None


def _joined(lanes: list) -> tuple[np.ndarray, np.ndarray]:
    points = np.concatenate([lane.centre_xy_m for lane in lanes])
    limits = np.concatenate([np.full(len(lane.centre_xy_m), lane.speed_mps) for lane in lanes])
    is_distinct = np.r_[True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 0.05]
    return points[is_distinct], limits[is_distinct]


def _resampled(points: np.ndarray, limits: np.ndarray, beyond_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return *points* a metre apart, extended straight at both ends, with rounded corners."""
    first, last = points[0] - points[1], points[-1] - points[-2]
    head = points[0] + (beyond_m + SMOOTHED) * first / np.linalg.norm(first)
    tail = points[-1] + (beyond_m + SMOOTHED) * last / np.linalg.norm(last)
    points, limits = np.vstack((head, points, tail)), np.r_[limits[0], limits, limits[-1]]
    s = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    stations = np.arange(0.0, s[-1], SPACING_M)
    line = np.stack((np.interp(stations, s, points[:, 0]), np.interp(stations, s, points[:, 1])), axis=-1)
    kernel = np.ones(SMOOTHED) / SMOOTHED
    smooth = np.stack([np.convolve(line[:, k], kernel, "valid") for k in (0, 1)], axis=-1)
    cut = SMOOTHED // 2
    piece = np.clip(np.searchsorted(s, stations, "right") - 1, 0, None)
    return smooth, limits[piece][cut : cut + len(smooth)]
