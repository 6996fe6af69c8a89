"""Vehicles that nobody plans for any more go back to SUMO without a jump in position, speed or heading."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.bicycle import Limits, clip_controls, step
from advdiff_sumo.core.frames import bumper_from_centre, local_from_world, unit, wrap_angle
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.actuate import Actuator
from advdiff_sumo.sim.background_control import Motion
from advdiff_sumo.sim.sim_options import SimOptions
from advdiff_sumo.sim.world import World

_ALIGNED_RAD = 0.05  # SUMO turns a vehicle along its lane in the step after it takes over
_STANDS_MPS = 0.5
_PATIENCE_S = 8.0  # then SUMO gets it as it is, which is counted
_LOOK_AHEAD_S, _MIN_LOOK_AHEAD_M = 1.0, 5.0
_ROUTE_AHEAD_M = 200.0
_SEES_M, _KEEPS_M, _SIDE_M = 50.0, 1.5, 0.2
_STRAIGHT = 1e-4  # curvature, 1/m
_LATERAL_MPS2, _BEND_BRAKE_MPS2, _LOST_BRAKE_MPS2 = 3.0, 3.0, 6.0


class Handover:
    """Hands vehicles back, and steers those onto their lane that SUMO could not take without a jump.

    Attributes:
        rough: ids that SUMO got although they stood askew.
    """

    def __init__(self, world: World, actuator: Actuator, road: RoadMap, sim: SimOptions) -> None:
        self.world, self.actuator, self.road, self.sim = world, actuator, road, sim
        self.rough: list[str] = []
        self._waiting_s: dict[int, float] = {}
        self._routes: dict[int, tuple[str, ...]] = {}

    def settle(
        self, motion: Motion, target: int, steps: int, routes: Mapping[str, tuple[str, ...]]
    ) -> Motion:
        """Release the moved vehicles that *motion* leaves out; returns *motion* and those still being aligned."""
        planned = set(motion.rows.tolist())
        inside = {row for row, state in self.actuator.moved.items() if state.inserted}
        left = sorted((inside | self.actuator.outside) - planned - {target})
        if not left:
            return motion
        rows = np.array(left, dtype=np.int64)
        xy, yaw = self.world.xy_m[rows], self.world.yaw_rad[rows]
        lanes, s, d, turned = self.road.locate_many(xy, yaw)
        fronts, _, beside, _ = self.road.locate_many(
            bumper_from_centre(xy, yaw, self.world.size_m[rows, 0]), yaw
        )
        held = [
            row in inside and self.actuator.holds(row, front, offset)
            for row, front, offset in zip(left, fronts, beside.tolist(), strict=True)
        ]
        places = zip(s.tolist(), d.tolist(), turned.tolist(), strict=True)
        askew = []
        for row, lane, place, sure in zip(left, lanes, places, held, strict=True):
            if row in inside and self._fits(row, lane, place, sure, steps * self.sim.step_s):
                self.actuator.release(row, self.route(row, routes))
                self._routes.pop(row, None)
            else:
                askew.append(row)
        if not askew:
            return motion
        return Motion.join(motion, self._align(np.array(askew, dtype=np.int64), steps))

    def _fits(
        self, row: int, lane: str | None, place: tuple[float, float, float], sure: bool, wait_s: float
    ) -> bool:
        """Return whether SUMO would leave *row* as it stands at *place*: s, d and heading on *lane*.

        *sure*: SUMO has it on that very lane.
        """
        s_m, offset_m, angle_rad = place
        aligned = sure and lane is not None and abs(angle_rad) <= _ALIGNED_RAD
        if (
            aligned
            and abs(offset_m) <= 0.5 * self.road.lanes[str(lane)].width_m
            and self._whole(row, str(lane), s_m)
        ):
            self._waiting_s.pop(row, None)
            return True
        waited = self._waiting_s.get(row, 0.0) + wait_s
        self._waiting_s[row] = waited
        if waited > _PATIENCE_S and lane is not None:
            self.rough.append(self.world.ids[row])
            self._waiting_s.pop(row)
            return True
        return False

    def _whole(self, row: int, lane_id: str, s_m: float) -> bool:
        """Return whether *row* is not in a turn: there SUMO bends its course to the bumper, half a metre off."""
        lane = self.road.lanes[lane_id]
        if lane.is_internal:
            yaw = lane.line.segment_yaw_rad
            return bool(abs(wrap_angle(yaw[-1] - yaw[0])) <= _ALIGNED_RAD)
        return bool(s_m >= 0.5 * self.world.size_m[row, 0] or self.world.speed_mps[row] < _STANDS_MPS)

    def _align(self, rows: IntArray, steps: int) -> Motion:
        """Steer *rows* onto their lanes by pure pursuit, no faster than now, than who is ahead, and than bends ask.

        Who is near no lane stops.
        """
        world = self.world
        xy, yaw, speed = world.xy_m[rows].copy(), world.yaw_rad[rows].copy(), world.speed_mps[rows].copy()
        length = world.size_m[rows, 0]
        states = []
        for _ in range(steps):
            ways = [self._pursue(xy[i], float(yaw[i]), float(speed[i])) for i in range(len(rows))]
            bend = np.array([0.0 if way is None else way for way in ways])
            lost = np.array([0.0 if way is not None else -_LOST_BRAKE_MPS2 for way in ways])
            poses = zip(rows, xy, yaw, speed, bend, strict=True)
            slower = np.array([min(self._behind(*pose), gently(*pose[3:])) for pose in poses])
            slower = np.minimum(slower, lost)
            accel, bend = clip_controls(speed, slower, bend, length, Limits())
            xy, yaw, speed = step(xy, yaw, speed, accel, bend, self.sim.step_s)
            states.append((xy, yaw, speed))
        return Motion(
            rows,
            np.stack([s[0] for s in states], axis=1),
            np.stack([s[1] for s in states], axis=1),
            np.stack([s[2] for s in states], axis=1),
            np.ones((len(rows), steps), dtype=np.bool_),
        )

    def _behind(self, row: int, xy_m: FloatArray, yaw_rad: float, speed_mps: float, bend: float) -> float:
        """Return the acceleration, at most 0, with which *row* on its arc does not run into who is ahead now."""
        world, count = self.world, len(self.world)
        way, side = on_arc(local_from_world(world.xy_m[:count], xy_m, yaw_rad), bend)
        size = world.size_m[:count]
        turned = world.yaw_rad[:count] - yaw_rad - bend * np.nan_to_num(way)
        cos, sin = np.abs(np.cos(turned)), np.abs(np.sin(turned))
        half, wide = 0.5 * (size[:, 0] * cos + size[:, 1] * sin), 0.5 * (size[:, 1] * cos + size[:, 0] * sin)
        ahead = np.abs(side) < wide + 0.5 * size[row, 1] + _SIDE_M
        ahead &= (way > 0.0) & (way < _SEES_M)  # NaN compares as False
        ahead[row] = False
        if not ahead.any():
            return 0.0
        gap = way[ahead] - half[ahead] - 0.5 * size[row, 0] - _KEEPS_M
        along = world.speed_mps[:count][ahead] * np.cos(turned[ahead])
        closing = np.maximum(speed_mps - np.maximum(along, 0.0), 0.0)
        return -float((0.5 * closing**2 / np.maximum(gap, 0.1)).max())

    def _pursue(self, xy_m: FloatArray, yaw_rad: float, speed_mps: float) -> float | None:
        """Return the curvature towards the nearest lane; None where there is none."""
        pose = self.road.locate(xy_m, yaw_rad)
        if pose is None:
            return None
        ahead = max(_MIN_LOOK_AHEAD_M, _LOOK_AHEAD_S * speed_mps)
        lane = self.road.lanes[pose.lane_id]
        goal, along = self.road.to_world(pose.lane_id, pose.s_m + ahead)
        beyond = max(pose.s_m + ahead - lane.length_m, 0.0)
        delta = goal + beyond * unit(np.asarray(along)) - xy_m
        angle = float(wrap_angle(np.arctan2(delta[1], delta[0]) - yaw_rad))
        return float(2.0 * np.sin(angle) / max(float(np.hypot(*delta)), 1.0))

    def note_routes(self, routes: Mapping[str, tuple[str, ...]]) -> None:
        """Note which edges vehicles that a policy inserts, by id, are going to drive."""
        for name, route in routes.items():
            row = self.world.row_of(name)
            if row is not None and row not in self._routes:
                self._routes[row] = route

    def route(self, row: int, routes: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
        """Return the edges that *row*, which we move, is expected to drive from its present one on."""
        return self._routes.get(row) or routes.get(self.world.ids[row], ())

    def predict(
        self, ends: Mapping[int, tuple[FloatArray, float]], routes: Mapping[str, tuple[str, ...]]
    ) -> None:
        """Tell SUMO where the moved vehicles are going, from their present poses and the ends of their plans."""
        rows = [row for row in ends if row in self.actuator.moved and self.actuator.moved[row].inserted]
        if not rows:
            return
        now = np.array(rows, dtype=np.int64)
        xy = np.concatenate((self.world.xy_m[now], [ends[row][0] for row in rows]))
        yaw = np.concatenate((self.world.yaw_rad[now], [ends[row][1] for row in rows]))
        lanes, *_ = self.road.locate_many(xy, yaw)
        here, there = lanes[: len(rows)], lanes[len(rows) :]
        for row, start, end in zip(rows, here, there, strict=True):
            route = self._predicted(row, start, end, routes)
            self._routes[row] = route
            self.actuator.predict_route(row, route)

    def _predicted(
        self, row: int, start: str | None, end: str | None, routes: Mapping[str, tuple[str, ...]]
    ) -> tuple[str, ...]:
        if start is None:
            return ()
        first = self._edge(start)
        last = self._edge(end) if end is not None else first
        known = self.route(row, routes)
        if first in known and (last in known[known.index(first) :]):
            return known[known.index(first) :]
        joined = (first,) if first == last else self.road.route(first, last) or (first,)
        onward = self.road.random_route(joined[-1], _ROUTE_AHEAD_M, np.random.default_rng(row))
        return (*joined[:-1], *(onward or joined[-1:]))

    def _edge(self, lane_id: str) -> str:
        """Return the edge of a lane; of an internal one, the edge that it leads to."""
        lane = self.road.lanes[lane_id]
        while lane.is_internal and lane.successors:
            lane = self.road.lanes[lane.successors[0].to_lane]
        return lane.edge_id


def on_arc(xy_m: FloatArray, bend: float) -> tuple[FloatArray, FloatArray]:
    """Return how far (N,) along an arc of curvature *bend* points (N, 2) lie, and how far (N,) to its left.

    The arc begins at the origin along the x axis. What is behind, or beyond a third of the circle, is at NaN.
    """
    if abs(bend) < _STRAIGHT:
        return np.where(xy_m[:, 0] >= 0.0, xy_m[:, 0], np.nan), xy_m[:, 1]
    turn, radius = np.sign(bend), 1.0 / abs(bend)
    x, y = xy_m[:, 0], turn * xy_m[:, 1]
    angle = np.arctan2(x, radius - y)
    inside = (angle >= 0.0) & (angle <= 2.0 * np.pi / 3.0)
    return np.where(inside, radius * angle, np.nan), turn * (radius - np.hypot(x, radius - y))


def gently(speed_mps: float, bend: float) -> float:
    """Return the acceleration, at most 0, of who drives a bend faster than drivers do."""
    return -_BEND_BRAKE_MPS2 if speed_mps**2 * abs(bend) > _LATERAL_MPS2 else 0.0
