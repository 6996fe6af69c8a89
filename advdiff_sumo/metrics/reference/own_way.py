"""The way that a reference driver follows: from the target's pose back into its lane and along its route."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import shapely

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.polylines import Polyline, without_repeats
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.paths import LanePath, PathLink

#: The way extends straight behind its first point and beyond its last one.
BEHIND_M = 20.0
_BEYOND_M = 60.0
#: Time and least distance in which the driver returns to the middle of its lane, and points of that curve.
_BLEND_S, _LEAST_BLEND_M, _BLEND_POINTS = 2.5, 10.0, 8
#: A lateral offset up to this needs no such curve.
_CENTRED_M = 0.02
#: Points that change the line by less than this are dropped.
_SIMPLIFY_M = 0.03
#: Greatest lateral acceleration in bends, and the braking before them.
_LATERAL_MPS2, _COMFORT_MPS2 = 3.0, 2.5
_PACE_SPACING_M = 2.0
#: Distance from the box's centre to each of its axles.
_AXLE_M = 1.3


@dataclass(frozen=True, eq=False)
class OwnWay:
    """The centre line of a corridor.

    Attributes:
        line: the line; its first ``BEHIND_M`` lie behind the start.
        links: connections over junctions ahead, with the positions of their stop lines along the line.
        pace_mps: (P,) greatest speed every ``_PACE_SPACING_M`` from the line's start on that suits the bends ahead.
    """

    line: Polyline
    links: tuple[PathLink, ...]
    pace_mps: FloatArray

    def poses(self, s_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return centres (…, 2) and headings (…,) of a box at *s_m*, with its axles on the line."""
        xy, _ = self.line.at(s_m, extrapolate=True)
        front, _ = self.line.at(s_m + _AXLE_M, extrapolate=True)
        rear, _ = self.line.at(s_m - _AXLE_M, extrapolate=True)
        delta = front - rear
        return xy, np.arctan2(delta[..., 1], delta[..., 0])

    def limit_mps(self, s_m: float) -> float:
        """Return the greatest speed at *s_m* from which the vehicle can slow down for every bend ahead."""
        index = min(max(int(s_m / _PACE_SPACING_M), 0), len(self.pace_mps) - 1)
        return float(self.pace_mps[index])


def way_from(record: EpisodeRecord, road: RoadMap, step: int, reach_m: float) -> OwnWay:
    """Return the way from the target's pose at *step*: back into its lane, and along its route.

    Without a route, or if the target's lane does not lead along it, the way follows where the target drove and then the
    straightest connections. If the target is on no lane, the way is the driven path.

    Args:
        record: the episode.
        road: its map.
        step: instant of the record at which the target is present.
        reach_m: required length of the way.
    """
    path = lane_path_at(record, road, step, reach_m)
    if path is None:
        return driven_way(record, step, record.tracks.steps - 1)
    row, tracks = record.target, record.tracks
    xy, yaw = tracks.xy_m[row, step], float(tracks.yaw_rad[row, step])
    blend_m = max(_LEAST_BLEND_M, _BLEND_S * abs(float(tracks.speed_mps[row, step])))
    line = _with_ends(np.vstack((xy, _blended(path.line, xy, blend_m))), yaw)
    shift = float(line.project(xy)[0])
    links = tuple(PathLink(x.s_m + shift, x.end_s_m + shift, x.link) for x in path.links)
    return OwnWay(line, links, _pace(line))


def driven_way(record: EpisodeRecord, start: int, stop: int) -> OwnWay:
    """Return the target's driven path from instant *start* to *stop*, extended straight at both ends."""
    tracks, row = record.tracks, record.target
    present = start + np.flatnonzero(tracks.valid[row, start : stop + 1])
    points = tracks.xy_m[row, present]
    spaced = [points[0]]
    for point in points[1:]:
        if np.hypot(*(point - spaced[-1])) > 0.5:
            spaced.append(point)
    return way_through(np.array(spaced), float(tracks.yaw_rad[row, present[0]]))


def way_through(xy_m: FloatArray, yaw_rad: float) -> OwnWay:
    """Return the way through points (N, 2), extended straight behind them (along *yaw_rad*) and beyond them."""
    line = _with_ends(xy_m, yaw_rad)
    return OwnWay(line, (), _pace(line))


def joined_way(record: EpisodeRecord, road: RoadMap, start: int, stop: int, reach_m: float) -> OwnWay:
    """Return the target's driven path from instant *start* to *stop* and :func:`way_from` beyond it."""
    driven, onward = driven_way(record, start, stop), way_from(record, road, stop, reach_m)
    joint = record.tracks.xy_m[record.target, stop]
    onward_s_m = float(onward.line.project(joint)[0])
    driven_s_m = float(driven.line.project(joint)[0])
    before = driven.line.xy_m[driven.line.s_m < driven_s_m - 0.1]
    after = onward.line.xy_m[onward.line.s_m > onward_s_m + 0.1]
    line = _simplified(np.vstack((before, joint, after)))
    shift = driven_s_m - onward_s_m
    links = tuple(PathLink(x.s_m + shift, x.end_s_m + shift, x.link) for x in onward.links)
    return OwnWay(line, links, _pace(line))


def lane_path_at(record: EpisodeRecord, road: RoadMap, step: int, reach_m: float) -> LanePath | None:
    """Return the lanes from the target's position: along its route, else as it drove, else straight on."""
    route = _remaining_route(record, road, step)
    row, tracks = record.target, record.tracks
    xy, yaw = tracks.xy_m[row, step], float(tracks.yaw_rad[row, step])
    pose = road.locate(xy, yaw, route=route or None)
    if pose is None or abs(pose.yaw_error_rad) > 1.0:
        return None
    paths_along = partial(
        road.lane_path, start_lane=pose.lane_id, horizon_m=reach_m, start_s_m=pose.s_m, vclass=None
    )
    planned = paths_along(route) if route else []
    if planned and _long_enough(planned[0], reach_m):
        return planned[0]
    driven = road.match_route(tracks.xy_m[row, step:], tracks.yaw_rad[row, step:]) or ()
    for edges in (driven, ()):
        paths = paths_along(_extended_route(road, pose.lane_id, edges, paths_along, reach_m))
        if paths and _long_enough(paths[0], reach_m):
            return paths[0]
    return paths[0] if paths else None


def _remaining_route(record: EpisodeRecord, road: RoadMap, step: int) -> tuple[str, ...]:
    """Return the part of the target's route from the edge reached at *step* on; () if an edge is not in the net.

    If the route passes an edge twice, the second passage is reached once the edges between have been driven.
    """
    route = record.route
    if not all(edge in road.edges for edge in route):
        return ()
    if len(set(route)) == len(route):
        return route
    tracks, past = record.tracks, slice(0, step + 1)
    reached = 0
    for edge in road.match_route(tracks.xy_m[record.target, past], tracks.yaw_rad[record.target, past]) or ():
        if edge in route[reached:]:
            reached = route.index(edge, reached)
    return route[reached:]


def _long_enough(path: LanePath, reach_m: float) -> bool:
    return path.complete or path.lane_change_after_m >= reach_m


def _extended_route(
    road: RoadMap,
    lane_id: str,
    edges: Sequence[str],
    paths_along: Callable[[Sequence[str]], Sequence[LanePath]],
    reach_m: float,
) -> list[str]:
    """Return a route of *reach_m* from *lane_id*: along *edges* if they continue from it, then the straightest links.

    *paths_along* returns the lane paths from the target's position along a route.
    """
    link = road.link_of_internal_lane.get(lane_id)
    route = [road.lanes[x].edge_id for x in ((lane_id,) if link is None else (link.from_lane, link.to_lane))]
    if route[-1] in edges:
        route += edges[edges.index(route[-1]) + 1 :]
    paths = paths_along(route)
    if not (paths and paths[0].complete):
        return route
    name, length = paths[0].lane_ids[-1], paths[0].line.length_m
    while length < reach_m:
        links = [x for x in road.lanes[name].successors if not x.turns_round]
        if not links:
            break
        straightest = min(links, key=lambda x: (x.direction != "s", x.to_lane))
        name = straightest.to_lane
        if road.lanes[name].edge_id in route:
            break
        route.append(road.lanes[name].edge_id)
        length += sum(road.lanes[x].length_m for x in (*straightest.via, name))
    return route


def _blended(line: Polyline, xy_m: FloatArray, blend_m: float) -> FloatArray:
    """Return points of *line* from beside *xy_m* (2,) on; their lateral offset decreases to 0 within *blend_m*."""
    along, offset = (float(x) for x in line.project(xy_m, extrapolate=True))
    s = np.linspace(0.0, min(blend_m, line.length_m), _BLEND_POINTS)[1:]
    if abs(offset) > _CENTRED_M:
        share = s / blend_m
        lateral = offset * (1.0 - share**3 * (10.0 - 15.0 * share + 6.0 * share**2))
        shifted, _ = line.at(s, lateral)
    else:
        shifted = np.empty((0, 2))
        s = np.array([max(along, 0.0)])
    beyond = line.xy_m[line.s_m > s[-1] + 0.05]
    return np.vstack((shifted, beyond)) if len(beyond) or len(shifted) else line.xy_m[-1:]


def _with_ends(xy_m: FloatArray, yaw_rad: float) -> Polyline:
    """Return the line through *xy_m* (N, 2), extended straight behind it (along *yaw_rad*) and beyond it."""
    points = without_repeats(xy_m)
    behind = points[0] - BEHIND_M * unit(np.asarray(yaw_rad))
    direction = points[-1] - points[-2] if len(points) > 1 else unit(np.asarray(yaw_rad))
    beyond = points[-1] + _BEYOND_M * direction / max(float(np.hypot(*direction)), 1e-9)
    return _simplified(np.vstack((behind, points, beyond)))


def _simplified(xy_m: FloatArray) -> Polyline:
    """Return the line through *xy_m* (N, 2) without points that change it by less than ``_SIMPLIFY_M``."""
    return Polyline.of(shapely.get_coordinates(shapely.LineString(xy_m).simplify(_SIMPLIFY_M)))


def _pace(line: Polyline) -> FloatArray:
    """Return (P,) the greatest speeds with which comfortable braking keeps the lateral acceleration in bends low."""
    s = np.arange(0.0, line.length_m + _PACE_SPACING_M, _PACE_SPACING_M)
    around = np.append(s - _PACE_SPACING_M, s[-1] + _PACE_SPACING_M)
    yaw = np.unwrap(np.arctan2(*np.diff(line.at(around)[0], axis=0).T[::-1]))
    curvature = np.abs(np.gradient(yaw, _PACE_SPACING_M))
    bend_mps = np.sqrt(_LATERAL_MPS2 / np.maximum(curvature, 1e-4))
    # Along a distance s, comfortable braking changes the squared speed by 2 · b · s.
    braked = 2.0 * _COMFORT_MPS2 * s
    squared = np.minimum.accumulate((bend_mps**2 + braked)[::-1])[::-1] - braked
    return np.asarray(np.sqrt(np.maximum(squared, 1.0)))
