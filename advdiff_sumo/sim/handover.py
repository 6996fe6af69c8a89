"""Vehicles that nobody plans for any more go back to SUMO without a jump in position, speed or heading."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.bicycle import Limits
from advdiff_sumo.core.frames import bumper_from_centre, wrap_angle
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.core.tracking import State, densify, track
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.actuate import Actuator
from advdiff_sumo.sim.background_control import MovedMotion
from advdiff_sumo.sim.headway_relaxation import HeadwayRelaxation
from advdiff_sumo.sim.sim_options import SimOptions
from advdiff_sumo.sim.target_choice import remaining_route
from advdiff_sumo.sim.world import World, stack

_ALIGNED_RAD = 0.05  # SUMO turns a vehicle along its lane in the step after it takes over
_STANDS_MPS = 0.5
_PATIENCE_S = 8.0  # then SUMO gets it as it is, which is counted
_ROUTE_AHEAD_M = 200.0
_SEES_M = 60.0


class Handover:
    """Hands vehicles back, and steers those onto their lane that SUMO could not take without a jump.

    Attributes:
        rough: ids that SUMO got although they stood askew.
    """

    def __init__(self, world: World, actuator: Actuator, road: RoadMap, sim: SimOptions) -> None:
        self.world, self.actuator, self.road, self.sim = world, actuator, road, sim
        self.rough: list[str] = []
        self._relaxation = HeadwayRelaxation(actuator, world, sim.step_s)
        self._waiting_s: dict[int, float] = {}
        self._routes: dict[int, tuple[str, ...]] = {}

    def settle(
        self,
        motion: MovedMotion,
        target: int,
        steps: int,
        routes: Mapping[str, tuple[str, ...]],
        signals: Mapping[str, str] | None = None,
        plans: Tracks | None = None,
    ) -> MovedMotion:
        """Release the moved vehicles that *motion* leaves out; returns *motion* and those still being aligned.

        Args:
            motion: of the coming steps.
            target: row of the target.
            steps: until this is asked again.
            routes: id → edges of the seed scene's vehicles.
            signals: states of the traffic lights.
            plans: what the policy has just planned.
        """
        self._relaxation.advance(steps * self.sim.step_s)
        planned = set(motion.rows.tolist())
        inside = {row for row, state in self.actuator.moved.items() if state.inserted}
        left = sorted((inside | self.actuator.outside) - planned - {target})
        self._waiting_s = {row: waited for row, waited in self._waiting_s.items() if row in left}
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
                self._relaxation.begin(row)
            else:
                askew.append(row)
        if not askew:
            return motion
        scene = self._around(np.array(askew, dtype=np.int64), routes, signals or {})
        return MovedMotion.join(motion, self._align(scene, plans, steps))

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

    def _around(
        self, rows: IntArray, routes: Mapping[str, tuple[str, ...]], signals: Mapping[str, str]
    ) -> Scene:
        """Return *rows*, as those that may be moved, and everybody near them, now."""
        world = self.world
        xy = world.xy_m[: len(world)]
        gap = np.linalg.norm(xy[:, None] - xy[rows], axis=-1)
        near = np.flatnonzero((gap < _SEES_M).any(axis=1))  # NaN compares as False
        now, _ = stack(world, [world.frame()], near, 0.0, self.sim.model_step_s)
        ahead = tuple(self._expected(row, routes) for row in near.tolist())
        return Scene(now, 0, np.isin(near, rows), ahead, signals)

    def _expected(self, row: int, routes: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
        """Return the edges that *row*, whoever moves it, is expected to drive."""
        if row in self.world.in_sumo and row not in self.actuator.moved:
            return remaining_route(self.actuator.api, self.world.sumo_ids[row], self.road.beyond_rim)
        return self.route(row, routes)

    def _align(self, scene: Scene, plans: Tracks | None, steps: int) -> MovedMotion:
        """Drive the movable vehicles of *scene* along their lanes for *steps*."""
        # brings PyTorch with it, which runs whose background is SUMO's do not need
        from advdiff_sumo.traffic.planning.lane_return import return_to_lanes

        futures = return_to_lanes(self.road, scene, steps * self.sim.step_s, plans)
        mine = scene.movable
        state: State = futures.xy_m[mine, 0], futures.yaw_rad[mine, 0], futures.speed_mps[mine, 0]
        plan: State = futures.xy_m[mine, 1:], futures.yaw_rad[mine, 1:], futures.speed_mps[mine, 1:]
        reference = densify(state, plan, futures.dt_s, self.sim.step_s, steps)
        length = futures.size_m[mine, 0]
        xy, yaw, speed = track(state, reference, length, self.sim.step_s, Limits())
        rows = [self.world.index[name] for name in np.array(scene.history.ids)[mine].tolist()]
        return MovedMotion(
            xy, yaw, speed, np.array(rows, dtype=np.int64), np.ones((len(rows), steps), dtype=np.bool_)
        )

    def note_routes(self, routes: Mapping[str, tuple[str, ...]]) -> None:
        """Note which edges vehicles that a policy inserts, by id, are going to drive."""
        for name, route in routes.items():
            row = self.world.row_of(name)
            if row is not None and row not in self._routes:
                self._routes[row] = route

    def note_own_route(self, row: int, route: tuple[str, ...]) -> None:
        """Note which edges *row* was going to drive before it was taken from SUMO; () where that is not known."""
        if route:
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
        first = self.road.edge_of(start)
        last = self.road.edge_of(end) if end is not None else first
        known = self.route(row, routes)
        if first in known and (last in known[known.index(first) :]):
            return known[known.index(first) :]
        return guessed_route(self.road, row, first, last)


def guessed_route(road: RoadMap, row: int, first: str, last: str) -> tuple[str, ...]:
    """Return edges from *first* over *last*, where a plan ends, and on from there, drawn for *row*."""
    joined = (first,) if first == last else road.route(first, last) or (first,)
    onward = road.random_route(joined[-1], _ROUTE_AHEAD_M, np.random.default_rng(row))
    return (*joined[:-1], *(onward or joined[-1:]))
