"""The scene as the choice of a manoeuvre needs it: way, speed and size of each vehicle near the target."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.scene import AgentClass, Scene
from advdiff_sumo.core.signal_letters import RED
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.traffic.manoeuvres.required_braking import TargetWay
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S
from advdiff_sumo.traffic.manoeuvres.ways import Way
from advdiff_sumo.traffic.planning.futures import STANDS_MPS
from advdiff_sumo.traffic.planning.lanes_ahead import lane_ahead, lanes_ahead, lanes_of_rows
from advdiff_sumo.traffic.planning.people import velocities

NEAR_M = 70.0
"""Vehicles farther from the target than this are ignored."""
_IN_LANE_M = 1.5  # largest lateral offset of a vehicle on a lane
_SAME_WAY = 0.8  # least cosine between the headings of vehicles that drive the same way
_MAX_GAIN_MPS2 = 3.0
_CLEARING_S = 1.0  # a vehicle ahead must have left a place so long before the target arrives
ROAD_BEYOND_M = 40.0
"""The road must go on for this distance beyond an inserted vehicle."""
_PAST_POSITIONS = 3  # of the history, from which the lateral speed is derived


@dataclass(frozen=True)
class SituationView:
    """The scene, with the way of each vehicle near the target.

    Attributes:
        road: the map.
        scene: the present scene.
        ways: row → way; pedestrians and vehicles on no lane have none.
        off_lane_rows: (R,) rows of those near the target that have no way, the target not included.
    """

    road: RoadMap
    scene: Scene
    ways: Mapping[int, Way]
    off_lane_rows: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @staticmethod
    def of(road: RoadMap, scene: Scene, farther: Collection[str] = ()) -> SituationView:
        """Return the view of all road users within ``NEAR_M`` of the target, and of those with an id in *farther*."""
        history = scene.history
        distance = np.linalg.norm(history.xy_m[:, -1] - history.xy_m[scene.target, -1], axis=-1)
        is_included = (distance <= NEAR_M) | np.isin(history.ids, list(farther))
        rows = np.flatnonzero(history.valid[:, -1] & is_included)
        lanes = lanes_of_rows(road, scene, rows)
        is_walking = history.classes[rows] == AgentClass.PEDESTRIAN
        candidates = zip(rows.tolist(), lanes, is_walking.tolist(), strict=True)
        ways = {
            row: Way(lane).with_drift(history.xy_m[row, -_PAST_POSITIONS:], history.dt_s)
            for row, lane, walks in candidates
            if lane is not None and not walks
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
        links = self.road.link_of_internal_lane
        return None if self.target is None else links.get(self.target.way.present_lane.id)

    def speed(self, row: int) -> float:
        """Return the present speed of *row*, at least 0."""
        return max(float(self.scene.history.speed_mps[row, -1]), 0.0)

    def accel_mps2(self, row: int) -> float:
        """Return the acceleration of *row* over the last step; 0 where that is not known."""
        speed = self.scene.history.speed_mps[row]
        gained = float(speed[-1] - speed[-2]) / self.scene.history.dt_s if len(speed) > 1 else 0.0
        return float(np.nan_to_num(gained))

    def speed_gain_mps2(self, row: int) -> float:
        """Return the acceleration of *row* over the last step, limited to 0 to 3 m/s²."""
        return float(np.clip(self.accel_mps2(row), 0.0, _MAX_GAIN_MPS2))

    def size(self, row: int) -> FloatArray:
        """Return (2,) length and width of *row*."""
        return np.asarray(self.scene.history.size_m[row])

    @cached_property
    def movable(self) -> tuple[int, ...]:
        """Rows that may be moved and are on a lane, ascending."""
        return tuple(row for row in self.ways if self.scene.movable[row])

    def position_on(self, way: Way, row: int) -> tuple[float, float]:
        """Return how far *row* is ahead of the present place on *way*, and its offset to the left of *way*."""
        s, left = way.line.project(self.scene.history.xy_m[row, -1])
        return float(s) - way.lane.s_m, float(left)

    @cached_property
    def on_target_way(self) -> Mapping[int, tuple[float, float]]:
        """Row → distance ahead of the target on its way, and offset to the left; empty where the target is on no lane.

        The target itself is left out.
        """
        if self.target is None:
            return {}
        return {row: self.position_on(self.target.way, row) for row in self.ways if row != self.scene.target}

    @cached_property
    def follower(self) -> int | None:
        """Row of the vehicle next behind the target on its lane; None where there is none near."""
        target = self.scene.target
        if self.target is None:
            return None
        yaw = self.scene.history.yaw_rad[:, -1]
        positions = (
            (*self.position_on(way, target), row)
            for row, way in self.ways.items()
            if row != target and np.cos(yaw[row] - yaw[target]) > _SAME_WAY
        )
        behind = [(ahead, row) for ahead, left, row in positions if ahead > 0.0 and abs(left) < _IN_LANE_M]
        return min(behind)[1] if behind else None

    def gap_m(self, ahead_m: float, first: int, second: int) -> float:
        """Return the bumper gap between the rows *first* and *second*, whose centres are *ahead_m* apart on a way."""
        return abs(ahead_m) - 0.5 * float(self.size(first)[0] + self.size(second)[0])

    def is_clear_to(self, reach_m: float) -> bool:
        """Return whether no vehicle is between the target and a place *reach_m* ahead on its way."""
        positions = self.on_target_way.values()
        return self.target is not None and not _is_any_within(positions, reach_m, _IN_LANE_M)

    def is_clear_on_arrival(self, reach_m: float) -> bool:
        """Return whether all vehicles ahead will have left a place *reach_m* ahead when the target gets there."""
        target = self.target
        if target is None:
            return False
        arrival_s = target.arrival_s(reach_m)
        if not np.isfinite(arrival_s):
            return self.is_clear_to(reach_m)
        for row, (ahead, left) in self.on_target_way.items():
            ahead_then = ahead + self.speed(row) * max(arrival_s - _CLEARING_S, 0.0)
            if abs(left) < _IN_LANE_M and 0.0 < ahead < reach_m and ahead_then < reach_m:
                return False
        return True

    def is_occupied(self, way: Way, reach_m: float, aside_m: float, from_m: float = 0.0) -> bool:
        """Return whether a vehicle but the target is *from_m* to *reach_m* ahead on *way*, within *aside_m* of it."""
        positions = (self.position_on(way, row) for row in self.ways if row != self.scene.target)
        return _is_any_within(positions, reach_m, aside_m, from_m)

    def signal(self, link: Link) -> str:
        """Return SUMO's letter of the light of *link*; "" where no light controls it."""
        return link.signal(self.scene.signals)

    def is_red(self, link: Link) -> bool:
        """Return whether *link* has a red light now."""
        return self.signal(link) in RED

    def neighbour_way(self, row: int, side: str) -> Way | None:
        """Return the way that *row* would follow on the lane to its "left" or "right"; None if there is no lane."""
        way = self.ways[row]
        lane = way.present_lane
        name = lane.left_id if side == "left" else lane.right_id
        if name is None or lane.is_internal or not self.road.lanes[name].is_drivable:
            return None
        neighbour = self.road.lanes[name]
        return self.way_from(neighbour.line.at(min(way.lane.s_m, neighbour.length_m)), self.scene.routes[row])

    def way_from(self, pose: tuple[FloatArray, FloatArray], route: Sequence[str]) -> Way | None:
        """Return the way along *route* from *pose*, on a centre line; None if that is no driving lane."""
        xy_m, yaw_rad = pose
        ahead = lanes_ahead(self.road, xy_m[None], np.array([float(yaw_rad)]), [route])[0]
        return None if ahead is None else Way(replace(ahead, offset_m=0.0))

    def extended_way(self, way: Way, reach_m: float) -> Way:
        """Return *way*, the target's or one beside it, extended to ``ROAD_BEYOND_M`` beyond *reach_m* ahead."""
        lane, route = way.lane, self.scene.routes[self.scene.target]
        reach_m += ROAD_BEYOND_M
        return Way(lane_ahead(self.road.lanes, lane.lanes[0], lane.s_m, 0.0, route, reach_m))

    def constant_speed_poses(self, rows: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return centres (R, T, 2) and headings (R, T) of *rows* that follow their ways at constant speed.

        A standing vehicle keeps its exact pose, also if that is not aligned with its lane.
        """
        history, times = self.scene.history, CHECK_TIMES_S
        xy = np.repeat(history.xy_m[rows, -1:], len(times), axis=1)
        yaw = np.repeat(history.yaw_rad[rows, -1:], len(times), axis=1)
        for k, row in enumerate(rows.tolist()):
            if self.speed(row) > STANDS_MPS:
                xy[k], yaw[k] = self.ways[row].poses(self.speed(row) * times, times)
        return xy, yaw

    @cached_property
    def constant_velocity_poses(self) -> tuple[FloatArray, FloatArray]:
        """Centres (R, T, 2) and headings (R, T) of ``off_lane_rows``, which keep their velocity."""
        history, rows = self.scene.history, self.off_lane_rows
        driven = CHECK_TIMES_S[:, None] * velocities(history)[rows, None]
        yaw = np.repeat(history.yaw_rad[rows, -1:], len(CHECK_TIMES_S), axis=1)
        return history.xy_m[rows, -1:] + driven, yaw


def _is_any_within(
    positions: Iterable[tuple[float, float]], reach_m: float, aside_m: float, from_m: float = 0.0
) -> bool:
    return any(from_m < ahead < reach_m and abs(left) < aside_m for ahead, left in positions)
