"""Find the other road users near the target, their lanes, and the ways that each may take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.scene import AgentClass, Scene
from advdiff_sumo.maps import Link
from advdiff_sumo.planners.lane_graph.chains import Chain, plausible_chains, route_chain
from advdiff_sumo.planners.lane_graph.path import Geometry, PathStack, ReferencePath, straight_path

RADIUS_M = 90.0
_MAX_LANE_OFFSET_M = 2.6
_MAX_YAW_ERROR_RAD = 1.0
_REACH_S, _REACH_M = 6.0, 25.0  # a way is as long as the drive of 6 s, plus 25 m
_MAX_EXTRA_OFFSET_M = 0.8  # lateral offset of a way over that of the closest way of the same road user


@dataclass(frozen=True)
class Others:
    """Present states of the N other road users near the target.

    Attributes:
        rows: (N,) row indices in the scene's history.
        xy_m: (N, 2) centres.
        yaw_rad: (N,) headings.
        speed_mps: (N,) speeds.
        accel_mps2: (N,) change of speed over the last model step.
        size_m: (N, 2) length and width.
        standing: (N,) whether they stood still through the whole history.
    """

    rows: IntArray
    xy_m: FloatArray
    yaw_rad: FloatArray
    speed_mps: FloatArray
    accel_mps2: FloatArray
    size_m: FloatArray
    standing: BoolArray


@dataclass(frozen=True)
class PossibleWay:
    """A way that a road user may take.

    Attributes:
        other: index of the road user in :class:`Others`.
        path: reference line; straight and without lanes if the road user is not on a lane.
        s_m: arc length of its centre along the path.
        d_m: lateral offset from the path, left positive.
        yaw_error_rad: heading relative to the path's.
        weight: share among the ways of the same road user; they sum to 1.
    """

    other: int
    path: ReferencePath
    s_m: float
    d_m: float
    yaw_error_rad: float
    weight: float

    @property
    def on_junction(self) -> bool:
        """Whether its centre is on an internal lane."""
        lanes = self.path.lanes
        return bool(lanes) and lanes[self.path.lane_at(self.s_m)].startswith(":")

    def next_link(self, front_m: float) -> tuple[Link, float] | None:
        """Return the first link not yet passed, and the distance from the front bumper to its stop line.

        *front_m* is the distance from the centre to the front bumper. None if no link is left.
        """
        for link, stop, beyond in zip(self.path.links, self.path.stop_m, self.path.exit_m, strict=True):
            if self.s_m < beyond:
                return link, stop - (self.s_m + front_m)
        return None


def others_near(scene: Scene) -> Others:
    """Return the road users within ``RADIUS_M`` of the target."""
    history = scene.history
    valid_now = history.valid[:, -1].copy()
    valid_now[scene.target] = False
    distance = np.hypot(*(history.xy_m[:, -1] - history.xy_m[scene.target, -1]).T)
    rows = np.flatnonzero(valid_now & (distance < RADIUS_M))
    speed = history.speed_mps[rows, -1]
    before = history.speed_mps[rows, -2] if history.steps > 1 else speed
    accel = np.nan_to_num((speed - np.where(np.isfinite(before), before, speed)) / history.dt_s)
    speeds = np.where(history.valid[rows], np.abs(history.speed_mps[rows]), np.inf)
    return Others(
        rows=rows,
        xy_m=history.xy_m[rows, -1],
        yaw_rad=history.yaw_rad[rows, -1],
        speed_mps=np.maximum(speed, 0.0),
        accel_mps2=np.clip(accel, -8.0, 4.0),
        size_m=history.size_m[rows],
        standing=np.asarray((speeds < 0.2).all(-1) & (history.steps > 1)),
    )


def ways_of(geometry: Geometry, scene: Scene, others: Others) -> list[PossibleWay]:
    """Return the ways that *others* may take: along lanes for those on a lane, else straight ahead."""
    if not len(others.rows):
        return []
    lanes, _, d, error = geometry.road.locate_many(others.xy_m, others.yaw_rad)
    owners, paths = list[int](), list[ReferencePath]()
    for i, row in enumerate(others.rows.tolist()):
        lane, reach = lanes[i], float(others.speed_mps[i]) * _REACH_S + _REACH_M
        on_lane = lane is not None and abs(d[i]) < _MAX_LANE_OFFSET_M and abs(error[i]) < _MAX_YAW_ERROR_RAD
        if lane is None or not on_lane or scene.history.classes[row] == AgentClass.PEDESTRIAN:
            own_paths = [straight_path(others.xy_m[i], float(others.yaw_rad[i]), reach)]
        else:
            chains = _chains(geometry, lane, scene.routes[row], reach)
            own_paths = [geometry.path(chain.lanes, chain.links) for chain in chains]
        owners += [i] * len(own_paths)
        paths += own_paths
    return _placed(np.array(owners), paths, others)


def _placed(owner: IntArray, paths: Sequence[ReferencePath], others: Others) -> list[PossibleWay]:
    """Return the ways of road users *owner* (N,) on *paths*, except those with a much larger offset than another."""
    stack = PathStack(paths)
    s, d = stack.project(others.xy_m[owner][:, None])
    error = wrap_angle(others.yaw_rad[owner] - stack.at(s, np.zeros_like(s))[1][:, 0])
    least_offset = np.full(len(others.rows), np.inf)
    np.minimum.at(least_offset, owner, np.abs(d[:, 0]))
    near_enough = np.flatnonzero(np.abs(d[:, 0]) < least_offset[owner] + _MAX_EXTRA_OFFSET_M)
    share = 1.0 / np.bincount(owner[near_enough], minlength=len(others.rows))
    return [
        PossibleWay(
            int(owner[n]), paths[n], float(s[n, 0]), float(d[n, 0]), float(error[n]), float(share[owner[n]])
        )
        for n in near_enough.tolist()
    ]


def _chains(geometry: Geometry, lane: str, route: Sequence[str], reach_m: float) -> list[Chain]:
    """Return the chains that a vehicle on *lane* may drive.

    On a junction they begin with the lane before it: the vehicle may be on any connection from that lane.
    """
    road = geometry.road
    link = geometry.road.link_of_internal_lane.get(lane)
    length_m = reach_m + road.lanes[lane].length_m
    if link is None:
        return plausible_chains(road, lane, route, length_m, geometry.changes)
    parallel = [x for x in road.lanes[link.from_lane].successors if x.via and not x.turns_round] or [link]
    fitting = [x for x in parallel if road.lanes[x.to_lane].edge_id in route]
    return [_chain_over(geometry, x, route, length_m) for x in fitting or parallel]


def _chain_over(geometry: Geometry, link: Link, route: Sequence[str], reach_m: float) -> Chain:
    """Return the chain over *link* and along *route* beyond it, or straight on if that is off the route."""
    road = geometry.road
    if road.lanes[link.to_lane].edge_id in route:
        beyond = plausible_chains(road, link.to_lane, route, reach_m, geometry.changes)[0]
    else:
        beyond = route_chain(road, link.to_lane, (), {}, reach_m)
    return Chain((link.from_lane, *link.via, *beyond.lanes), (link, *beyond.links))
