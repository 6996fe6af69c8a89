"""The way that a reference driver follows from an instant on: out of the target's pose onto its route's lanes."""

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

#: The way goes on straight behind and beyond what is known.
BEHIND_M = 20.0
_BEYOND_M = 60.0
_BLEND_S, _LEAST_BLEND_M, _BLEND_POINTS = 2.5, 10.0, 8
_FLAT_M = 0.02
_THIN_M = 0.03
_LATERAL_MPS2, _COMFORT_MPS2 = 3.0, 2.5
_PACE_SPACING_M = 2.0
_HEADING_REACH_M = 1.3


@dataclass(frozen=True, eq=False)
class OwnWay:
    """The centre line of a corridor.

    Attributes:
        line: the line; its first ``BEHIND_M`` lie behind the start.
        links: connections over junctions ahead, with the places of their stop lines along the line.
        pace_mps: (P,) greatest speed every ``_PACE_SPACING_M`` from the line's start on, slow enough for its
            bends.
    """

    line: Polyline
    links: tuple[PathLink, ...]
    pace_mps: FloatArray

    def poses(self, s_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return centres (…, 2) and headings (…,) of a box at *s_m*, its axles on the line."""
        xy, _ = self.line.at(s_m, extrapolate=True)
        ahead, _ = self.line.at(s_m + _HEADING_REACH_M, extrapolate=True)
        behind, _ = self.line.at(s_m - _HEADING_REACH_M, extrapolate=True)
        delta = ahead - behind
        return xy, np.arctan2(delta[..., 1], delta[..., 0])

    def limit_mps(self, s_m: float) -> float:
        """Return the greatest speed at *s_m* from which every bend ahead can be driven."""
        cell = min(max(int(s_m / _PACE_SPACING_M), 0), len(self.pace_mps) - 1)
        return float(self.pace_mps[cell])


def way_from(record: EpisodeRecord, road: RoadMap, step: int, reach_m: float) -> OwnWay:
    """Return the way from the target's pose at *step*: back into its lane, and along its route.

    Where there is no route, or its lane does not lead along it, the way goes where the target drove, and then over the
    straightest connections. Without a lane there, it is the driven path.

    Args:
        record: the episode.
        road: its map.
        step: instant of the record at which the target is there.
        reach_m: how far the way is to be known.
    """
    path = _lane_path(record, road, step, reach_m)
    if path is None:
        return driven_way(record, step, record.tracks.steps - 1)
    row, tracks = record.target, record.tracks
    xy, yaw = tracks.xy_m[row, step], float(tracks.yaw_rad[row, step])
    blend = max(_LEAST_BLEND_M, _BLEND_S * abs(float(tracks.speed_mps[row, step])))
    ahead = _blended(path.line, xy, blend)
    line = _with_ends(np.vstack((xy, ahead)), yaw)
    shift = float(line.project(xy)[0])
    links = tuple(PathLink(x.s_m + shift, x.end_s_m + shift, x.link) for x in path.links)
    return OwnWay(line, links, _pace(line))


def driven_way(record: EpisodeRecord, start: int, stop: int) -> OwnWay:
    """Return the target's own path from instant *start* to *stop*, straight on beyond both."""
    tracks, row = record.tracks, record.target
    there = start + np.flatnonzero(tracks.valid[row, start : stop + 1])
    points = tracks.xy_m[row, there]
    spread = [points[0]]
    for point in points[1:]:
        if np.hypot(*(point - spread[-1])) > 0.5:
            spread.append(point)
    return way_through(np.array(spread), float(tracks.yaw_rad[row, there[0]]))


def way_through(xy_m: FloatArray, yaw_rad: float) -> OwnWay:
    """Return the way through points (N, 2), straight on behind (by *yaw_rad*) and beyond them."""
    line = _with_ends(xy_m, yaw_rad)
    return OwnWay(line, (), _pace(line))


def joined_way(record: EpisodeRecord, road: RoadMap, start: int, stop: int, reach_m: float) -> OwnWay:
    """Return the target's driven path from instant *start* to *stop* and :func:`way_from` beyond it."""
    driven, onward = driven_way(record, start, stop), way_from(record, road, stop, reach_m)
    begin = float(onward.line.project(record.tracks.xy_m[record.target, stop])[0])
    end = float(driven.line.project(record.tracks.xy_m[record.target, stop])[0])
    first = driven.line.xy_m[driven.line.s_m < end - 0.1]
    last = onward.line.xy_m[onward.line.s_m > begin + 0.1]
    line = _thinned(np.vstack((first, record.tracks.xy_m[record.target, stop], last)))
    shift = end - begin
    links = tuple(PathLink(x.s_m + shift, x.end_s_m + shift, x.link) for x in onward.links)
    return OwnWay(line, links, _pace(line))


def _lane_path(record: EpisodeRecord, road: RoadMap, step: int, reach_m: float) -> LanePath | None:
    """Return the lanes from where the target is: along its route, else as it drove, else straight on."""
    route = _route_left(record, road, step)
    row, tracks = record.target, record.tracks
    xy, yaw = tracks.xy_m[row, step], float(tracks.yaw_rad[row, step])
    pose = road.locate(xy, yaw, route=route or None)
    if pose is None or abs(pose.yaw_error_rad) > 1.0:
        return None
    along = partial(
        road.lane_path, start_lane=pose.lane_id, horizon_m=reach_m, start_s_m=pose.s_m, vclass=None
    )
    planned = along(route) if route else []
    if planned and _far_enough(planned[0], reach_m):
        return planned[0]
    driven = road.match_route(tracks.xy_m[row, step:], tracks.yaw_rad[row, step:]) or ()
    for edges in (driven, ()):
        paths = along(_onward(road, pose.lane_id, edges, along, reach_m))
        if paths and _far_enough(paths[0], reach_m):
            return paths[0]
    return paths[0] if paths else None


def _route_left(record: EpisodeRecord, road: RoadMap, step: int) -> tuple[str, ...]:
    """Return the target's route from the edge on that it has reached at *step*; () for edges not in the net.

    On a route that passes an edge twice, the second passage is reached once the edges between were driven.
    """
    route = record.route
    if not all(edge in road.edges for edge in route):
        return ()
    if len(set(route)) == len(route):
        return route
    states, past = record.tracks, slice(0, step + 1)
    passed = 0
    for edge in road.match_route(states.xy_m[record.target, past], states.yaw_rad[record.target, past]) or ():
        if edge in route[passed:]:
            passed = route.index(edge, passed)
    return route[passed:]


def _far_enough(path: LanePath, reach_m: float) -> bool:
    return path.complete or path.reaches_m >= reach_m


def _onward(
    road: RoadMap,
    lane_id: str,
    edges: Sequence[str],
    along: Callable[[Sequence[str]], Sequence[LanePath]],
    reach_m: float,
) -> list[str]:
    """Return a route from *lane_id* over *edges*, as far as they lead on from it, and over the straightest links."""
    link = road.link_over.get(lane_id)
    route = [road.lanes[x].edge_id for x in ((lane_id,) if link is None else (link.from_lane, link.to_lane))]
    if route[-1] in edges:
        route += edges[edges.index(route[-1]) + 1 :]
    paths = along(route)
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
    """Return points of *line*, shifted at first so that they begin beside *xy_m* (2,) and end on it."""
    along, offset = (float(x) for x in line.project(xy_m, extrapolate=True))
    near = np.linspace(0.0, min(blend_m, line.length_m), _BLEND_POINTS)[1:]
    if abs(offset) > _FLAT_M:
        share = near / blend_m
        lateral = offset * (1.0 - share**3 * (10.0 - 15.0 * share + 6.0 * share**2))
        shifted, _ = line.at(near, lateral)
    else:
        shifted = np.empty((0, 2))
        near = np.array([max(along, 0.0)])
    beyond = line.xy_m[line.s_m > near[-1] + 0.05]
    return np.vstack((shifted, beyond)) if len(beyond) or len(shifted) else line.xy_m[-1:]


def _with_ends(xy_m: FloatArray, yaw_rad: float) -> Polyline:
    """Return the line through *xy_m* (N, 2) that goes on straight behind and beyond it."""
    points = without_repeats(xy_m)
    back = points[0] - BEHIND_M * unit(np.asarray(yaw_rad))
    last = points[-1] - points[-2] if len(points) > 1 else unit(np.asarray(yaw_rad))
    onward = points[-1] + _BEYOND_M * last / max(float(np.hypot(*last)), 1e-9)
    return _thinned(np.vstack((back, points, onward)))


def _thinned(xy_m: FloatArray) -> Polyline:
    """Return the line through *xy_m* (N, 2) without points that change it by less than ``_THIN_M``."""
    return Polyline.of(shapely.get_coordinates(shapely.LineString(xy_m).simplify(_THIN_M)))


def _pace(line: Polyline) -> FloatArray:
    """Return (P,) speeds that keep the lateral acceleration down, reached with comfortable braking."""
    s = np.arange(0.0, line.length_m + _PACE_SPACING_M, _PACE_SPACING_M)
    yaw = np.unwrap(np.arctan2(*np.diff(line.at(np.append(s - 2.0, s[-1] + 2.0))[0], axis=0).T[::-1]))
    bend = np.abs(np.gradient(yaw, _PACE_SPACING_M))
    top = np.sqrt(_LATERAL_MPS2 / np.maximum(bend, 1e-4))
    lift = 2.0 * _COMFORT_MPS2 * s
    reached = np.minimum.accumulate((top**2 + lift)[::-1])[::-1] - lift
    return np.asarray(np.sqrt(np.maximum(reached, 1.0)))
