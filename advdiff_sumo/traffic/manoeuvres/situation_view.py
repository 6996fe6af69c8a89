"""What the choice of a manoeuvre is made from: everybody's way, speed and box, the target's first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.scene import AgentClass, Scene
from advdiff_sumo.core.signal_letters import RED
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.traffic.manoeuvres.answers import TargetWay
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S
from advdiff_sumo.traffic.manoeuvres.ways import Way
from advdiff_sumo.traffic.planning.futures import STANDS_MPS
from advdiff_sumo.traffic.planning.lanes_ahead import lane_ahead, lanes_ahead
from advdiff_sumo.traffic.planning.people import velocities

NEAR_M = 70.0
"""Vehicles farther from the target than this do not matter to it."""
_IN_LANE_M, _SAME_WAY = 1.5, 0.8
_GAINS_MPS2 = 3.0
_CLEARS_S = 1.0
ROAD_BEYOND_M = 40.0
"""So far beyond where somebody comes in the road goes on."""
_PAST = 3  # places that tell how fast somebody moves sideways


@dataclass(frozen=True)
class SituationView:
    """The scene as ways.

    Attributes:
        road: the map.
        scene: now.
        ways: row → way; who is on foot or on no lane has none.
        astray: (R,) rows of those near who have none, the target left out.
    """

    road: RoadMap
    scene: Scene
    ways: Mapping[int, Way]
    off_lane_rows: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @staticmethod
    def of(road: RoadMap, scene: Scene) -> SituationView:
        """Return the view of everybody within ``NEAR_M`` of the target."""
        now = scene.history
        apart = np.linalg.norm(now.xy_m[:, -1] - now.xy_m[scene.target, -1], axis=-1)
        rows = np.flatnonzero(now.valid[:, -1] & (apart <= NEAR_M))
        lanes = lanes_ahead(
            road, now.xy_m[rows, -1], now.yaw_rad[rows, -1], [scene.routes[row] for row in rows.tolist()]
        )
        walks = now.classes[rows] == AgentClass.PEDESTRIAN
        pairs = zip(rows.tolist(), lanes, walks.tolist(), strict=True)
        ways = {
            row: Way(lane).with_drift(now.xy_m[row, -_PAST:], now.dt_s)
            for row, lane, on_foot in pairs
            if lane is not None and not on_foot
        }
        return SituationView(road, scene, ways, np.setdiff1d(rows, [*ways, scene.target]))

    @cached_property
    def target(self) -> TargetWay | None:
        """The target on its way; None where it is on no lane."""
        row = self.scene.target
        way = self.ways.get(row)
        return None if way is None else TargetWay(way, self.speed(row), self.size(row))

    @cached_property
    def target_link(self) -> Link | None:
        """The link over the junction that the target is on; None where it is on none."""
        return None if self.target is None else self.road.link_over.get(self.target.way.present_lane.id)

    def speed(self, row: int) -> float:
        """Return the speed of *row* now, at least 0."""
        return max(float(self.scene.history.speed_mps[row, -1]), 0.0)

    def speed_gain_mps2(self, row: int) -> float:
        """Return how fast *row* has gained speed over the last step, 0 to 3 m/s²."""
        speed = self.scene.history.speed_mps[row]
        gained = float(speed[-1] - speed[-2]) / self.scene.history.dt_s if len(speed) > 1 else 0.0
        return float(np.clip(np.nan_to_num(gained), 0.0, _GAINS_MPS2))

    def size(self, row: int) -> FloatArray:
        """Return (2,) length and width of *row*."""
        return np.asarray(self.scene.history.size_m[row])

    @cached_property
    def movable(self) -> tuple[int, ...]:
        """Rows that may be moved and are on a lane, ascending."""
        return tuple(row for row in self.ways if self.scene.movable[row])

    def position_on(self, way: Way, row: int) -> tuple[float, float]:
        """Return how far *row* is along *way* from where it begins now, and to the left of it."""
        s, left = way.line.project(self.scene.history.xy_m[row, -1])
        return float(s) - way.lane.s_m, float(left)

    @cached_property
    def on_target_way(self) -> Mapping[int, tuple[float, float]]:
        """Row → how far each other is along the target's way, and to the left of it; empty where it is on no lane."""
        if self.target is None:
            return {}
        return {row: self.position_on(self.target.way, row) for row in self.ways if row != self.scene.target}

    @cached_property
    def follower(self) -> int | None:
        """Row of who is next behind the target on its lane; None where nobody is near."""
        target = self.scene.target
        if self.target is None:
            return None
        yaw = self.scene.history.yaw_rad[:, -1]
        places = (
            (*self.position_on(way, target), row)
            for row, way in self.ways.items()
            if row != target and np.cos(yaw[row] - yaw[target]) > _SAME_WAY
        )
        behind = [(ahead, row) for ahead, left, row in places if ahead > 0.0 and abs(left) < _IN_LANE_M]
        return min(behind)[1] if behind else None

    def gap_m(self, ahead_m: float, first: int, second: int) -> float:
        """Return the bumper gap of two boxes whose centres are *ahead_m* apart on one way."""
        return abs(ahead_m) - 0.5 * float(self.size(first)[0] + self.size(second)[0])

    def is_clear_to(self, reach_m: float) -> bool:
        """Return whether nobody is between the target and a place *reach_m* ahead on its way."""
        on_way = self.on_target_way.values()
        return self.target is not None and not _anybody(on_way, reach_m, _IN_LANE_M)

    def is_clear_on_arrival(self, reach_m: float) -> bool:
        """Return whether whoever is ahead will have left a place *reach_m* ahead of the target when it gets there."""
        target = self.target
        if target is None:
            return False
        arrives_s = target.arrival_s(reach_m)
        if not np.isfinite(arrives_s):
            return self.is_clear_to(reach_m)
        for row, (ahead, left) in self.on_target_way.items():
            then = ahead + self.speed(row) * max(arrives_s - _CLEARS_S, 0.0)
            if abs(left) < _IN_LANE_M and 0.0 < ahead < reach_m and then < reach_m:
                return False
        return True

    def is_occupied(self, way: Way, reach_m: float, aside_m: float, from_m: float = 0.0) -> bool:
        """Return whether anybody but the target is *from_m* to *reach_m* ahead on *way*, within *aside_m* of it."""
        places = (self.position_on(way, row) for row in self.ways if row != self.scene.target)
        return _anybody(places, reach_m, aside_m, from_m)

    def signal(self, link: Link) -> str:
        """Return SUMO's letter of the light of *link*; "" where none controls it."""
        return link.signal(self.scene.signals)

    def is_red(self, link: Link) -> bool:
        """Return whether *link* has a red light now."""
        return self.signal(link) in RED

    def yields_to(self, link: Link, other: Link) -> bool:
        """Return whether *link* has to give way to *other* of the same junction, and not the other way round."""
        return self.road.must_yield(link, other) and not self.road.must_yield(other, link)

    def neighbour_way(self, row: int, side: str) -> Way | None:
        """Return the way that *row* would follow on the lane to its "left" or "right"; None without one."""
        way = self.ways[row]
        lane = way.present_lane
        name = lane.left_id if side == "left" else lane.right_id
        if name is None or lane.is_internal or not self.road.lanes[name].is_drivable:
            return None
        there = self.road.lanes[name]
        return self.way_from(there.line.at(min(way.lane.s_m, there.length_m)), self.scene.routes[row])

    def way_from(self, pose: tuple[FloatArray, FloatArray], route: Sequence[str]) -> Way | None:
        """Return the way along *route* from *pose*, a place on a lane's centre line; None where no lane is driven."""
        xy_m, yaw_rad = pose
        ahead = lanes_ahead(self.road, xy_m[None], np.array([float(yaw_rad)]), [route])[0]
        return None if ahead is None else Way(replace(ahead, offset_m=0.0))

    def extended_way(self, way: Way, reach_m: float) -> Way:
        """Return the target's *way*, or one beside it, as far as *reach_m* ahead and some more."""
        lane, route = way.lane, self.scene.routes[self.scene.target]
        reach_m += ROAD_BEYOND_M
        return Way(lane_ahead(self.road.lanes, lane.lanes[0], lane.s_m, 0.0, route, reach_m))

    def constant_speed_poses(self, rows: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return centres (R, T, 2) and headings (R, T) of *rows* on their ways that keep their speed.

        Who stands stays as it is, askew or beside its lane.
        """
        now, times = self.scene.history, CHECK_TIMES_S
        xy = np.repeat(now.xy_m[rows, -1:], len(times), axis=1)
        yaw = np.repeat(now.yaw_rad[rows, -1:], len(times), axis=1)
        for k, row in enumerate(rows.tolist()):
            if self.speed(row) > STANDS_MPS:
                xy[k], yaw[k] = self.ways[row].poses(self.speed(row) * times, times)
        return xy, yaw

    @cached_property
    def constant_velocity_poses(self) -> tuple[FloatArray, FloatArray]:
        """Return centres (R, T, 2) and headings (R, T) of who is ``off_lane_rows``: they keep their velocity."""
        now, rows = self.scene.history, self.off_lane_rows
        driven = CHECK_TIMES_S[:, None] * velocities(now)[rows, None]
        yaw = np.repeat(now.yaw_rad[rows, -1:], len(CHECK_TIMES_S), axis=1)
        return now.xy_m[rows, -1:] + driven, yaw


def _anybody(
    places: Iterable[tuple[float, float]], reach_m: float, aside_m: float, from_m: float = 0.0
) -> bool:
    return any(from_m < ahead < reach_m and abs(left) < aside_m for ahead, left in places)
