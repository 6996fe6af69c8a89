"""Hand vehicles that have no plan any more back to SUMO without a jump in position, speed or heading."""

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
from advdiff_sumo.sim.target_route import remaining_route
from advdiff_sumo.sim.world import World, stack

# largest heading error of a release; SUMO turns a vehicle along its lane in its first step
_ALIGNED_RAD = 0.05
_STANDING_MPS = 0.5
_MAX_WAIT_S = 8.0  # after this time SUMO gets a vehicle as it is, and the record counts it
_ROUTE_AHEAD_M = 200.0
_PERCEPTION_M = 60.0  # vehicles that are driven back onto their lane see others up to here


class Handover:
    """Hands vehicles back to SUMO, and drives those onto their lane that SUMO could not take without a jump.

    Attributes:
        misaligned_ids: ids that SUMO got although they were not aligned with a lane.
    """

    def __init__(self, world: World, actuator: Actuator, road: RoadMap, sim: SimOptions) -> None:
        self.world, self.actuator, self.road, self.sim = world, actuator, road, sim
        self.misaligned_ids: list[str] = []
        self._relaxation = HeadwayRelaxation(actuator, world, sim.step_s)
        self._waiting_s: dict[int, float] = {}
        self._routes: dict[int, tuple[str, ...]] = {}

    def release_or_align(
        self,
        motion: MovedMotion,
        target: int,
        steps: int,
        routes: Mapping[str, tuple[str, ...]],
        signals: Mapping[str, str] | None = None,
        plans: Tracks | None = None,
    ) -> MovedMotion:
        """Release the moved vehicles that *motion* leaves out; return *motion* with those that are still being aligned.

        Args:
            motion: of the coming steps.
            target: row of the target.
            steps: number of substeps until the next call.
            routes: id → edges of the seed scene's vehicles.
            signals: states of the traffic lights.
            plans: the policy's present plan.
        """
        self._relaxation.advance(steps * self.sim.step_s)
        planned = set(motion.rows.tolist())
        in_sumo = {row for row, state in self.actuator.moved.items() if state.inserted}
        unplanned = sorted((in_sumo | self.actuator.outside) - planned - {target})
        self._waiting_s = {row: waited for row, waited in self._waiting_s.items() if row in unplanned}
        if not unplanned:
            return motion
        rows = np.array(unplanned, dtype=np.int64)
        xy, yaw = self.world.xy_m[rows], self.world.yaw_rad[rows]
        lanes, s_m, d_m, yaw_error = self.road.locate_many(xy, yaw)
        bumper_lanes, _, bumper_offsets, _ = self.road.locate_many(
            bumper_from_centre(xy, yaw, self.world.size_m[rows, 0]), yaw
        )
        sumo_agrees = [
            row in in_sumo and self.actuator.sumo_agrees(row, bumper_lane, offset)
            for row, bumper_lane, offset in zip(unplanned, bumper_lanes, bumper_offsets.tolist(), strict=True)
        ]
        lane_poses = zip(s_m.tolist(), d_m.tolist(), yaw_error.tolist(), strict=True)
        misaligned = []
        for row, lane, lane_pose, agrees in zip(unplanned, lanes, lane_poses, sumo_agrees, strict=True):
            if row in in_sumo and self._is_releasable(row, lane, lane_pose, agrees, steps * self.sim.step_s):
                self.actuator.release(row, self.route(row, routes))
                self._routes.pop(row, None)
                self._relaxation.begin(row)
            else:
                misaligned.append(row)
        if not misaligned:
            return motion
        scene = self._scene_around(np.array(misaligned, dtype=np.int64), routes, signals or {})
        return MovedMotion.join(motion, self._align(scene, plans, steps))

    def _is_releasable(
        self, row: int, lane: str | None, pose: tuple[float, float, float], sumo_agrees: bool, wait_s: float
    ) -> bool:
        """Return whether *row* can be released now: SUMO would leave it where it is, or it has waited long enough.

        *pose* is arc length, lateral offset and heading error on *lane*, the nearest one. *sumo_agrees* is whether SUMO
        has the vehicle on that lane. The next attempt is *wait_s* later.
        """
        s_m, offset_m, yaw_error_rad = pose
        is_aligned = sumo_agrees and lane is not None and abs(yaw_error_rad) <= _ALIGNED_RAD
        if (
            is_aligned
            and abs(offset_m) <= 0.5 * self.road.lanes[str(lane)].width_m
            and self._is_straight_on_lane(row, str(lane), s_m)
        ):
            self._waiting_s.pop(row, None)
            return True
        waited_s = self._waiting_s.get(row, 0.0) + wait_s
        self._waiting_s[row] = waited_s
        if waited_s > _MAX_WAIT_S and lane is not None:
            self.misaligned_ids.append(self.world.ids[row])
            self._waiting_s.pop(row)
            return True
        return False

    def _is_straight_on_lane(self, row: int, lane_id: str, s_m: float) -> bool:
        """Return whether *row* is not in a turn; there SUMO bends its path to the bumper, half a metre off."""
        lane = self.road.lanes[lane_id]
        if lane.is_internal:
            yaw = lane.line.segment_yaw_rad
            return bool(abs(wrap_angle(yaw[-1] - yaw[0])) <= _ALIGNED_RAD)
        return bool(s_m >= 0.5 * self.world.size_m[row, 0] or self.world.speed_mps[row] < _STANDING_MPS)

    def _scene_around(
        self, rows: IntArray, routes: Mapping[str, tuple[str, ...]], signals: Mapping[str, str]
    ) -> Scene:
        """Return the present scene with *rows*, which alone are movable, and all road users near them."""
        world = self.world
        xy = world.xy_m[: len(world)]
        distance = np.linalg.norm(xy[:, None] - xy[rows], axis=-1)
        near_rows = np.flatnonzero((distance < _PERCEPTION_M).any(axis=1))  # NaN compares as False
        now, _ = stack(world, [world.frame()], near_rows, 0.0, self.sim.model_step_s)
        routes_ahead = tuple(self._expected_route(row, routes) for row in near_rows.tolist())
        return Scene(now, 0, np.isin(near_rows, rows), routes_ahead, signals)

    def _expected_route(self, row: int, routes: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
        """Return the edges that *row* is expected to drive, whether SUMO or this package moves it."""
        if row in self.world.in_sumo and row not in self.actuator.moved:
            return remaining_route(self.actuator.api, self.world.sumo_ids[row], self.road.beyond_rim)
        return self.route(row, routes)

    def _align(self, scene: Scene, plans: Tracks | None, steps: int) -> MovedMotion:
        """Drive the movable vehicles of *scene* along their lanes for *steps* substeps."""
        # imports PyTorch, which runs with SUMO's own drivers as background do not need
        from advdiff_sumo.traffic.planning.lane_return import return_to_lanes

        futures = return_to_lanes(self.road, scene, steps * self.sim.step_s, plans)
        movable = scene.movable
        state: State = futures.xy_m[movable, 0], futures.yaw_rad[movable, 0], futures.speed_mps[movable, 0]
        plan: State = futures.xy_m[movable, 1:], futures.yaw_rad[movable, 1:], futures.speed_mps[movable, 1:]
        reference = densify(state, plan, futures.dt_s, self.sim.step_s, steps)
        length = futures.size_m[movable, 0]
        xy, yaw, speed = track(state, reference, length, self.sim.step_s, Limits())
        rows = [self.world.index[name] for name in np.array(scene.history.ids)[movable].tolist()]
        return MovedMotion(
            xy, yaw, speed, np.array(rows, dtype=np.int64), np.ones((len(rows), steps), dtype=np.bool_)
        )

    def note_routes(self, routes: Mapping[str, tuple[str, ...]]) -> None:
        """Note the edges that vehicles inserted by a policy, given by id, are going to drive."""
        for name, route in routes.items():
            row = self.world.row_of(name)
            if row is not None and row not in self._routes:
                self._routes[row] = route

    def note_own_route(self, row: int, route: tuple[str, ...]) -> None:
        """Note the edges that *row* was going to drive before it was taken from SUMO; () if unknown."""
        if route:
            self._routes[row] = route

    def route(self, row: int, routes: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
        """Return the edges that moved vehicle *row* is expected to drive, from its present edge on."""
        return self._routes.get(row) or routes.get(self.world.ids[row], ())

    def predict(
        self, ends: Mapping[int, tuple[FloatArray, float]], routes: Mapping[str, tuple[str, ...]]
    ) -> None:
        """Tell SUMO the routes of the moved vehicles, from their present poses and the ends of their plans.

        Args:
            ends: row → last position (2,) and heading of its plan.
            routes: id → edges of the seed scene's vehicles.
        """
        rows = [row for row in ends if row in self.actuator.moved and self.actuator.moved[row].inserted]
        if not rows:
            return
        row_array = np.array(rows, dtype=np.int64)
        xy = np.concatenate((self.world.xy_m[row_array], [ends[row][0] for row in rows]))
        yaw = np.concatenate((self.world.yaw_rad[row_array], [ends[row][1] for row in rows]))
        lanes, *_ = self.road.locate_many(xy, yaw)
        start_lanes, end_lanes = lanes[: len(rows)], lanes[len(rows) :]
        for row, start, end in zip(rows, start_lanes, end_lanes, strict=True):
            route = self._predicted_route(row, start, end, routes)
            self._routes[row] = route
            self.actuator.predict_route(row, route)

    def _predicted_route(
        self, row: int, start_lane: str | None, end_lane: str | None, routes: Mapping[str, tuple[str, ...]]
    ) -> tuple[str, ...]:
        if start_lane is None:
            return ()
        first = self.road.edge_of(start_lane)
        last = self.road.edge_of(end_lane) if end_lane is not None else first
        known_route = self.route(row, routes)
        if first in known_route and (last in known_route[known_route.index(first) :]):
            return known_route[known_route.index(first) :]
        return guessed_route(self.road, row, first, last)


def guessed_route(road: RoadMap, row: int, first: str, last: str) -> tuple[str, ...]:
    """Return the edges from *first* to *last*, where a plan ends, and a random continuation seeded by *row*."""
    planned = (first,) if first == last else road.route(first, last) or (first,)
    onward = road.random_route(planned[-1], _ROUTE_AHEAD_M, np.random.default_rng(row))
    return (*planned[:-1], *(onward or planned[-1:]))
