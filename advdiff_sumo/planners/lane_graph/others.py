"""Who is around, on which lanes, and which ways each may take."""

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
_LOOK_S, _LOOK_M = 6.0, 25.0
_MAX_WORSE_M = 0.8


@dataclass(frozen=True)
class Others:
    """States now of the N other road users near the target.

    Attributes:
        rows: (N,) rows in the scene.
        xy_m: (N, 2) centres.
        yaw_rad: (N,) headings.
        speed_mps: (N,) speeds.
        accel_mps2: (N,) change of speed over the last model step.
        size_m: (N, 2) length and width.
        standing: (N,) stood still through the whole history.
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
    """One way that a road user may take.

    Attributes:
        other: index in :class:`Others`.
        path: reference line; of no lane where it goes straight on.
        s_m: where its centre is along the path.
        d_m: how far left of the path.
        yaw_error_rad: heading against the path's.
        weight: share of this way among those of the same road user.
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
        """Return the first link not left behind and how far its line is from the front, *front_m* before the centre."""
        for link, stop, beyond in zip(self.path.links, self.path.stop_m, self.path.exit_m, strict=True):
            if self.s_m < beyond:
                return link, stop - (self.s_m + front_m)
        return None


def others_near(scene: Scene) -> Others:
    """Return the road users within ``RADIUS_M`` of the target."""
    history = scene.history
    now = history.valid[:, -1].copy()
    now[scene.target] = False
    distance = np.hypot(*(history.xy_m[:, -1] - history.xy_m[scene.target, -1]).T)
    rows = np.flatnonzero(now & (distance < RADIUS_M))
    speed = history.speed_mps[rows, -1]
    before = history.speed_mps[rows, -2] if history.steps > 1 else speed
    accel = np.nan_to_num((speed - np.where(np.isfinite(before), before, speed)) / history.dt_s)
    past = np.where(history.valid[rows], np.abs(history.speed_mps[rows]), np.inf)
    return Others(
        rows=rows,
        xy_m=history.xy_m[rows, -1],
        yaw_rad=history.yaw_rad[rows, -1],
        speed_mps=np.maximum(speed, 0.0),
        accel_mps2=np.clip(accel, -8.0, 4.0),
        size_m=history.size_m[rows],
        standing=np.asarray((past < 0.2).all(-1) & (history.steps > 1)),
    )


def ways_of(geometry: Geometry, scene: Scene, others: Others) -> list[PossibleWay]:
    """Return the ways that *others* may take, along lanes where they are on one, else straight on."""
    if not len(others.rows):
        return []
    lanes, _, d, error = geometry.road.locate_many(others.xy_m, others.yaw_rad)
    owner, paths = list[int](), list[ReferencePath]()
    for i, row in enumerate(others.rows.tolist()):
        lane, reach = lanes[i], float(others.speed_mps[i]) * _LOOK_S + _LOOK_M
        along = lane is not None and abs(d[i]) < _MAX_LANE_OFFSET_M and abs(error[i]) < _MAX_YAW_ERROR_RAD
        if lane is None or not along or scene.history.classes[row] == AgentClass.PEDESTRIAN:
            ways = [straight_path(others.xy_m[i], float(others.yaw_rad[i]), reach)]
        else:
            ways = [
                geometry.path(c.lanes, c.links) for c in _chains(geometry, lane, scene.routes[row], reach)
            ]
        owner += [i] * len(ways)
        paths += ways
    return _placed(np.array(owner), paths, others)


def _placed(owner: IntArray, paths: Sequence[ReferencePath], others: Others) -> list[PossibleWay]:
    """Return the ways of *owner* (N,) along *paths*; those much farther off than another one are dropped."""
    stack = PathStack(paths)
    s, d = stack.project(others.xy_m[owner][:, None])
    error = wrap_angle(others.yaw_rad[owner] - stack.at(s, np.zeros_like(s))[1][:, 0])
    best = np.full(len(others.rows), np.inf)
    np.minimum.at(best, owner, np.abs(d[:, 0]))
    kept = np.flatnonzero(np.abs(d[:, 0]) < best[owner] + _MAX_WORSE_M)
    share = 1.0 / np.bincount(owner[kept], minlength=len(others.rows))
    return [
        PossibleWay(
            int(owner[n]), paths[n], float(s[n, 0]), float(d[n, 0]), float(error[n]), float(share[owner[n]])
        )
        for n in kept.tolist()
    ]


def _chains(geometry: Geometry, lane: str, route: Sequence[str], reach_m: float) -> list[Chain]:
    """Return chains from *lane*; on a junction from the lane before it, over every connection that may be it."""
    road = geometry.road
    link = geometry.road.link_over.get(lane)
    ahead = reach_m + road.lanes[lane].length_m
    if link is None:
        return plausible_chains(road, lane, route, ahead, geometry.changes)
    parallel = [x for x in road.lanes[link.from_lane].successors if x.via and not x.turns_round] or [link]
    fitting = [x for x in parallel if road.lanes[x.to_lane].edge_id in route]
    return [_over(geometry, x, route, ahead) for x in fitting or parallel]


def _over(geometry: Geometry, link: Link, route: Sequence[str], reach_m: float) -> Chain:
    road = geometry.road
    if road.lanes[link.to_lane].edge_id in route:
        beyond = plausible_chains(road, link.to_lane, route, reach_m, geometry.changes)[0]
    else:
        beyond = route_chain(road, link.to_lane, (), {}, reach_m)
    return Chain((link.from_lane, *link.via, *beyond.lanes), (link, *beyond.links))
