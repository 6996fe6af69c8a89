"""The line that a vehicle follows along its route, and how fast it may go on it, from the planner kit's map."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from advdiff_sumo.planner_kit import KitRoad, Scene

NEAR_M, M_PER_RAD = (
    6.0,
    3.0,
)  # a lane is the vehicle's own within so much; a radian of heading counts as so many metres
SPACING_M, SMOOTHED = 1.0, 7  # of the line; points of its moving mean
LATERAL_MPS2, BRAKE_MPS2, HARD_MPS2 = (
    2.0,
    2.0,
    3.5,
)  # in bends; for what is ahead; the most that a yellow light asks for
STOP_GAP_M = 1.0


@dataclass(frozen=True)
class ReferenceLine:
    """Points a metre apart.

    Attributes:
        xy_m: (P, 2), from behind the vehicle on.
        limit_mps: (P,) speed limit, less in bends.
        s_m: where on it the vehicle's centre is.
        stop_s_m: where the vehicle's front has to stop, or infinity.
    """

    xy_m: np.ndarray
    limit_mps: np.ndarray
    s_m: float
    stop_s_m: float

    def desired_mps(self, length_m: float) -> float:
        """Return the speed from which every limit ahead, and the stop, is reached by gentle braking."""
        ahead = SPACING_M * np.arange(len(self.xy_m)) - self.s_m
        limits = np.sqrt(self.limit_mps**2 + 2.0 * BRAKE_MPS2 * np.maximum(ahead, 0.0))
        gap = self.stop_s_m - STOP_GAP_M - self.s_m - 0.5 * length_m
        to_stop = np.sqrt(2.0 * BRAKE_MPS2 * max(gap, 0.0))
        return float(min(limits[ahead > -SPACING_M].min(), to_stop))


def reference_line(
    road: KitRoad, scene: Scene, ahead_m: float, behind_m: float = 30.0
) -> ReferenceLine | None:
    """Return the centre lines along the route, joined and smoothed; None where no lane of the route is near.

    Where the vehicle's lane does not lead on, the line is that of the neighbour which does: the planner changes over.
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
    if stop_s < front - 2.0:  # over the line already
        stop_s = float("inf")
    return ReferenceLine(line, np.minimum(speeds, bend_limit_mps(line)), s, stop_s)


def lanes_along(
    road: KitRoad, route: tuple[str, ...], xy_m: np.ndarray, yaw_rad: float, ahead_m: float
) -> list:
    """Return the lanes to follow, the ones on junctions among them, from the vehicle's own on."""
    lane, place = _own_lane(road, route, xy_m, yaw_rad)
    if lane is None:
        return []
    if not lane.is_internal:
        beside = [other for other in road.lanes.values() if other.edge_id == lane.edge_id]
        lane = max(
            beside,
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
    """Return the nearest lane of the route's next edges or of a junction between two, and its edge's place in it."""
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
    away = {name: offset_m(lane.centre_xy_m, xy_m, yaw_rad) for name, (lane, _) in candidates.items()}
    nearest = min(away, key=away.__getitem__, default=None)
    return candidates[nearest] if nearest is not None and away[nearest] < NEAR_M else (None, 0)


def _reach_m(road: KitRoad, lane, route: tuple[str, ...], place: int, most_m: float) -> float:
    """Return how far the route can be followed from *lane* without changing lanes, at most *most_m* and a lane."""
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
    """Return the junction's lanes after *lane* and the route's next one, or None at the route's end."""
    if place + 1 >= len(route):
        return None
    if lane.is_internal:
        links = lane.successors
        onward = [((), road.lanes[link.to_lane]) for link in links]
        onward = [(via, to) for via, to in onward if to.is_internal or to.edge_id == route[place + 1]]
        if onward and onward[0][1].is_internal:
            rest = _following(road, onward[0][1], route, place, ahead_m)
            return None if rest is None else ((onward[0][1], *rest[0]), rest[1])
    else:
        onward = [
            (tuple(road.lanes[via] for via in link.via), road.lanes[link.to_lane])
            for link in lane.successors
            if road.lanes[link.to_lane].edge_id == route[place + 1]
        ]
    return max(onward, key=lambda pair: _reach_m(road, pair[1], route, place + 1, ahead_m), default=None)


def offset_m(line: np.ndarray, xy_m: np.ndarray, yaw_rad: float) -> float:
    """Return the least distance of a point to *line*, more where the line leads elsewhere than *yaw_rad*."""
    start, step = line[:-1], np.diff(line, axis=0)
    share = np.clip(((xy_m - start) * step).sum(1) / np.maximum((step**2).sum(1), 1e-9), 0.0, 1.0)
    away = np.linalg.norm(start + share[:, None] * step - xy_m, axis=1)
    turn = np.abs(np.angle(np.exp(1j * (np.arctan2(step[:, 1], step[:, 0]) - yaw_rad))))
    return float((away + M_PER_RAD * turn).min())


def bend_limit_mps(line: np.ndarray) -> np.ndarray:
    """Return (P,) speeds at which the bends of a line of points a metre apart are comfortable."""
    step = np.diff(line, axis=0)
    turn = np.abs(np.diff(np.unwrap(np.arctan2(step[:, 1], step[:, 0])))) / SPACING_M
    curvature = np.convolve(np.r_[0.0, turn, 0.0], np.ones(3) / 3.0, "same")
    return np.sqrt(LATERAL_MPS2 / np.maximum(curvature, 1e-3))


def _stop_point(lanes: list, scene: Scene, speed_mps: float):
    """Return the end of the first lane at which a signal holds the vehicle, or None."""
    now, me = scene.history, scene.target
    for lane, after in pairwise(lanes):
        for link in lane.successors:
            if lane.is_internal or link.tls_id is None or (link.via[:1] or (link.to_lane,))[0] != after.id:
                continue
            letter = scene.signals[link.tls_id][link.tls_index]
            end = lane.centre_xy_m[-1]
            gap = float(np.linalg.norm(end - now.xy_m[me, -1])) - 0.5 * float(now.size_m[me, 0])
            yields = letter in "yY" and speed_mps**2 < 2.0 * HARD_MPS2 * max(gap, 0.1)
            if letter in "rRu" or yields:
                return end
    return None


def _joined(lanes: list) -> tuple[np.ndarray, np.ndarray]:
    points = np.concatenate([lane.centre_xy_m for lane in lanes])
    limits = np.concatenate([np.full(len(lane.centre_xy_m), lane.speed_mps) for lane in lanes])
    apart = np.r_[True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 0.05]
    return points[apart], limits[apart]


def _resampled(points: np.ndarray, limits: np.ndarray, beyond_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return *points* a metre apart, led on straight at both ends, their corners rounded."""
    first, last = points[0] - points[1], points[-1] - points[-2]
    head = points[0] + (beyond_m + SMOOTHED) * first / np.linalg.norm(first)
    tail = points[-1] + (beyond_m + SMOOTHED) * last / np.linalg.norm(last)
    points, limits = np.vstack((head, points, tail)), np.r_[limits[0], limits, limits[-1]]
    s = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    at = np.arange(0.0, s[-1], SPACING_M)
    line = np.stack((np.interp(at, s, points[:, 0]), np.interp(at, s, points[:, 1])), axis=-1)
    kernel = np.ones(SMOOTHED) / SMOOTHED
    smooth = np.stack([np.convolve(line[:, k], kernel, "valid") for k in (0, 1)], axis=-1)
    cut = SMOOTHED // 2
    return smooth, limits[np.clip(np.searchsorted(s, at, "right") - 1, 0, None)][cut : cut + len(smooth)]
