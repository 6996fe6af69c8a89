"""Propose lateral choices: keep the lane, shift in it, or change it; quintics over a reference line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import Link, RoadMap
from advdiff_sumo.planners.lane_graph.chains import (
    Chain,
    Changes,
    detour,
    route_ahead,
    route_chain,
)
from advdiff_sumo.planners.lane_graph.lane_graph_options import LaneGraphOptions
from advdiff_sumo.planners.lane_graph.memory import LaneGraphMemory
from advdiff_sumo.planners.lane_graph.path import Geometry, ReferencePath

_EDGES_AHEAD = 8
_MIN_BLEND_M = 10.0
# lateral offset (m) and heading error (rad) up to which the target counts as on the previous path:
_NEAR = (4.5, 1.0)
_SWUNG_WIDE = (10.0, 2.0)  # coming back after a bend that was too tight for it
_STUCK_S = 6.0  # after standing so long in a lane off its route, it takes a detour
_SHIFTS_M = (0.6, -0.6)  # lateral offsets within the lane


@dataclass(frozen=True)
class TargetState:
    """State of the target at present.

    Attributes:
        xy_m: (2,) centre.
        yaw_rad: heading.
        speed_mps: speed, at least 0.
        accel_mps2: acceleration planned for the present instant.
        curvature_1pm: curvature planned for the present instant.
        length_m: length.
        width_m: width.
    """

    xy_m: FloatArray
    yaw_rad: float
    speed_mps: float
    accel_mps2: float
    curvature_1pm: float
    length_m: float
    width_m: float

    @classmethod
    def of(cls, scene: Scene, accel_mps2: float, curvature_1pm: float) -> TargetState:
        """Return the target of *scene*."""
        row, history = scene.target, scene.history
        return cls(
            xy_m=history.xy_m[row, -1],
            yaw_rad=float(history.yaw_rad[row, -1]),
            speed_mps=max(float(history.speed_mps[row, -1]), 0.0),
            accel_mps2=accel_mps2,
            curvature_1pm=curvature_1pm,
            length_m=float(history.size_m[row, 0]),
            width_m=float(history.size_m[row, 1]),
        )

    @property
    def front_m(self) -> float:
        """Distance from centre to front bumper."""
        return 0.5 * self.length_m


@dataclass(frozen=True)
class Place:
    """Position of the target on the lane graph.

    Attributes:
        lane_id: lane that it is on.
        route: edges ahead; the first one is the lane's own, or the one beyond the junction.
        changes: result of :func:`required_changes` for the route.
        link: link that it is on; None off junctions.
    """

    lane_id: str
    route: tuple[str, ...]
    changes: Changes
    link: Link | None


@dataclass(frozen=True)
class Variant:
    """One lateral choice: a blend over ``blend_m`` from the present offset to ``target_m``.

    Attributes:
        chain: lanes to follow.
        path: reference line of the chain.
        side: 0: the present lane, 1: the lane to the left, −1: to the right.
        s_m: present arc length of the centre along the path.
        d_m: present lateral offset, left positive.
        slope: present change of the offset per metre.
        bend_1pm: present change of the slope per metre.
        target_m: lateral offset at the end of the blend.
        blend_m: length of the blend.
    """

    chain: Chain
    path: ReferencePath
    side: int
    s_m: float
    d_m: float
    slope: float
    bend_1pm: float
    target_m: float
    blend_m: float

    def lateral(self, s_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return offset and slope (…,) at *s_m*: a quintic that ends on ``target_m`` with zero slope and curvature."""
        u, (c1, c2, c3, c4, c5) = self._share(s_m), self._coefficients
        slope = (c1 + u * (2 * c2 + u * (3 * c3 + u * (4 * c4 + u * 5 * c5)))) / self.blend_m
        return self._offset(u), slope

    def offset(self, s_m: FloatArray) -> FloatArray:
        """Return the offset (…,) of :meth:`lateral` alone."""
        return self._offset(self._share(s_m))

    def _share(self, s_m: FloatArray) -> FloatArray:
        """Return the share (…,) of the blend that is done at *s_m*, from 0 to 1."""
        return np.minimum(np.maximum((s_m - self.s_m) / self.blend_m, 0.0), 1.0)

    def _offset(self, u: FloatArray) -> FloatArray:
        """Return the offset (…,) at the shares *u* (…,) of the blend."""
        c1, c2, c3, c4, c5 = self._coefficients
        return self.d_m + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5))))

    @property
    def _coefficients(self) -> tuple[float, float, float, float, float]:
        """Coefficients of the first to fifth power of the share of the blend."""
        c1, c2 = self.slope * self.blend_m, 0.5 * self.bend_1pm * self.blend_m**2
        gap = self.target_m - self.d_m
        c3 = 10.0 * gap - 6.0 * c1 - 3.0 * c2
        c4 = -15.0 * gap + 8.0 * c1 + 3.0 * c2
        return c1, c2, c3, c4, 6.0 * gap - 3.0 * c1 - c2

    def poses(self, s_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return centres (…, 2) and headings (…,) at *s_m*."""
        d, slope = self.lateral(s_m)
        xy, yaw = self.path.at(s_m, d)
        scale = np.maximum(1.0 - self.path.curvature_at(s_m) * d, 0.2)
        return xy, yaw + np.arctan2(slope, scale)


def locate(
    geometry: Geometry, state: TargetState, route: Sequence[str], memory: LaneGraphMemory, waited_s: float
) -> Place | None:
    """Return where the target is; None if no lane is near.

    While it is near the previous path, it is on that path, else on the likeliest lane. A target that has swung wide
    in a bend comes back to the previous path if the lane found does not lead along its route.
    """
    lane = _tracked(geometry, state, memory, *_NEAR)
    if lane is None:
        lane = _likeliest(geometry, state, route, memory)
    if lane is None:
        return None
    edges = _edges_ahead(geometry.road, lane, tuple(route) or memory.route, memory, waited_s)[:_EDGES_AHEAD]
    return Place(lane, edges, geometry.changes(edges), geometry.road.link_of_internal_lane.get(lane))


def _edges_ahead(
    road: RoadMap, lane: str, route: tuple[str, ...], memory: LaneGraphMemory, waited_s: float
) -> tuple[str, ...]:
    """Return the edges ahead; by a detour if the target stands in a lane from which it cannot follow the route."""
    ahead = route_ahead(road, lane, route)
    on_detour = not road.lanes[lane].is_internal and memory.route[:1] == ahead[:1] and memory.detour
    is_stuck = waited_s > _STUCK_S and len(ahead) > 1 and not memory.follows_route
    if (is_stuck or on_detour) and not road.lanes[lane].is_internal:
        return detour(road, lane, route[-1]) or ahead
    return ahead


def _likeliest(
    geometry: Geometry, state: TargetState, route: Sequence[str], memory: LaneGraphMemory
) -> str | None:
    """Return the lane at the target's pose, on its route if possible; None if there is none within 50 m."""
    road = geometry.road
    edges = list(route) if route else None
    pose = road.locate(state.xy_m, state.yaw_rad, vclass="passenger", route=edges)
    if pose is None or (route and not _is_on_route(geometry, pose.lane_id, route)):
        tracked = _tracked(geometry, state, memory, *_SWUNG_WIDE)
        if tracked is not None:
            return tracked
    pose = pose or road.locate(state.xy_m, state.yaw_rad, max_distance_m=50.0)
    return None if pose is None else pose.lane_id


def _is_on_route(geometry: Geometry, lane: str, route: Sequence[str]) -> bool:
    """Return whether *lane*, or the lane beyond it on a junction, is on *route*."""
    link = geometry.road.link_of_internal_lane.get(lane)
    beyond = lane if link is None else link.to_lane
    return geometry.road.lanes[beyond].edge_id in route


def _tracked(
    geometry: Geometry, state: TargetState, memory: LaneGraphMemory, max_offset_m: float, max_error_rad: float
) -> str | None:
    """Return the lane of the previous path at the target, or the lane beside that one where the target is.

    None if its lateral offset exceeds *max_offset_m* or its heading error *max_error_rad*, or if the path is over.
    """
    if not memory.lanes:
        return None
    path = geometry.path(memory.lanes, memory.links)
    s, d = (float(value) for value in path.project(state.xy_m))
    error = abs(float(wrap_angle(state.yaw_rad - float(path.yaw_at(np.asarray(s))))))
    if abs(d) > max_offset_m or error > max_error_rad or s > path.length_m + 1.0:
        return None
    lane = geometry.road.lanes[path.lanes[path.lane_at(s)]]
    while abs(d) > 0.5 * lane.width_m:
        beside = lane.left_id if d > 0.0 else lane.right_id
        if beside is None:
            break
        next_lane = geometry.road.lanes[beside]
        d -= np.copysign(0.5 * (lane.width_m + next_lane.width_m), d)
        lane = next_lane
    return lane.id


def variants(
    geometry: Geometry, state: TargetState, place: Place, memory: LaneGraphMemory, options: LaneGraphOptions
) -> list[Variant]:
    """Return the lateral choices; the first one is the middle of the present lane.

    On a junction no lane change begins, but one that has begun continues.
    """
    road, lane = geometry.road, geometry.road.lanes[place.lane_id]
    reach_m = state.speed_mps * (options.horizon_s + 4.0) + 60.0
    own_chain = _with_junction_behind(_chain(road, place.lane_id, place, reach_m), place, memory)
    choices = _variants(geometry, state, own_chain, 0, (0.0, *_SHIFTS_M), options)
    for side, beside in ((1, lane.left_id), (-1, lane.right_id)):
        if beside is None or (place.link is not None and beside not in memory.lanes):
            continue
        if road.lanes[beside].permits("passenger"):
            chain = _chain(road, beside, replace(place, link=road.link_of_internal_lane.get(beside)), reach_m)
            choices += _variants(geometry, state, chain, side, (0.0,), options)
    return choices


def _chain(road: RoadMap, lane: str, place: Place, reach_m: float) -> Chain:
    """Return the chain from *lane* along the route, or over the link on which the target is."""
    if place.link is None:
        return route_chain(road, lane, place.route, place.changes, reach_m + road.lanes[lane].length_m)
    link = place.link
    beyond = route_chain(road, link.to_lane, place.route, place.changes, reach_m)
    lanes = (link.from_lane, *link.via, *beyond.lanes)
    return Chain(lanes, (link, *beyond.links), beyond.follows_route, 0)


def _with_junction_behind(chain: Chain, place: Place, memory: LaneGraphMemory) -> Chain:
    """Prepend the junction that the target has just left, so that the reference line behind it stays the same."""
    if place.link is not None:
        return chain
    for link in memory.links:
        if link.to_lane == place.lane_id and link.via:
            lanes = (link.from_lane, *link.via, *chain.lanes)
            return Chain(lanes, (link, *chain.links), chain.follows_route, chain.changes)
    return chain


def _variants(
    geometry: Geometry,
    state: TargetState,
    chain: Chain,
    side: int,
    targets_m: Sequence[float],
    options: LaneGraphOptions,
) -> list[Variant]:
    """Return the blends from the target's present offset to each of *targets_m*, along *chain*."""
    path = geometry.path(chain.lanes, chain.links)
    s, d = (float(value) for value in path.project(state.xy_m))
    s_now = np.asarray(s)
    yaw, curvature = float(path.yaw_at(s_now)), float(path.curvature_at(s_now))
    error = min(max(float(wrap_angle(state.yaw_rad - yaw)), -1.0), 1.0)
    scale = max(1.0 - curvature * d, 0.2)
    bend_1pm = min(max(state.curvature_1pm - curvature, -0.1), 0.1)
    slope = scale * np.tan(error)
    blends = [_blend_m(state, target - d, options) for target in targets_m]
    pairs = zip(targets_m, blends, strict=True)
    return [Variant(chain, path, side, s, d, slope, bend_1pm, target, blend) for target, blend in pairs]


def _blend_m(state: TargetState, across_m: float, options: LaneGraphOptions) -> float:
    """Return the length of a blend that moves the target sideways by *across_m*."""
    lanes = min(max(abs(across_m) / 3.2, 0.4), 1.2)
    return max(state.speed_mps * options.lane_change_s * lanes, _MIN_BLEND_M * max(lanes, 0.6))
