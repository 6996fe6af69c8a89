"""Drive the target with SUMO's models, or with a Python planner through the bicycle model."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.bicycle import Limits
from advdiff_sumo.core.errors import PlanRefusedError
from advdiff_sumo.core.plan import Plan, Trajectory
from advdiff_sumo.core.record import Controller
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.core.tracking import State, drive_plan
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.planner_check import motion_problems
from advdiff_sumo.planners.planner_protocol import Planner, Served
from advdiff_sumo.sim.actuate import Actuator
from advdiff_sumo.sim.handover import guessed_route
from advdiff_sumo.sim.heartbeat import Heartbeat, ProcessPhase
from advdiff_sumo.sim.plan_validation import check_plan
from advdiff_sumo.sim.plug_in_guard import PlugInGuard
from advdiff_sumo.sim.sim_options import SimOptions
from advdiff_sumo.sim.start import TARGET_TYPE
from advdiff_sumo.sim.sumo_perception import visible_ids
from advdiff_sumo.sim.target_route import remaining_route
from advdiff_sumo.sim.world import World

_ARRIVAL_M = 6.0
"""The target has arrived when its front is this near to the end of its route."""


class SumoDrive:
    """SUMO drives the target; this class only observes it."""

    def __init__(self, api: Any, world: World, row: int) -> None:
        self.api, self.world, self.row = api, world, row
        self.planning_s: list[float] = []
        self.planned: Plan | None = None  # SUMO does not report its plans

    def start(self, scene: Scene) -> None:
        """Do nothing: there is nothing to prepare."""

    def replan(self, scene: Scene, steps: int) -> None:
        """Do nothing: SUMO plans by itself."""

    def end(self, end: str, time_s: float, failure: str) -> None:
        """Do nothing: SUMO needs no notice."""

    def move(self, k: int) -> None:
        """Do nothing: SUMO moves the target."""

    def visible(self) -> frozenset[str] | None:
        """Return the road users that the target's models take into account, by their names in the record."""
        if self.world.controller[self.row] == Controller.ABSENT:
            return frozenset()
        names = visible_ids(self.api, self.world.sumo_ids[self.row])
        return frozenset(self.world.ids[self.world.index[name]] for name in names if name in self.world.index)

    def arrived(self) -> bool:
        """Return False: SUMO removes an arrived vehicle, which the loop notices."""
        return False

    def route_ahead(self) -> tuple[str, ...]:
        """Return the target's remaining edges."""
        return remaining_route(self.api, self.world.sumo_ids[self.row], self.world.beyond_rim)


class PlannerDrive:
    """A Python planner drives the target."""

    def __init__(
        self,
        planner: Planner,
        road: RoadMap,
        actuator: Actuator,
        row: int,
        route: tuple[str, ...],
        rng: np.random.Generator,
        name: str,
        sim: SimOptions,
        heartbeat: Heartbeat,
    ) -> None:
        self.planner, self.road, self.actuator, self.world = planner, road, actuator, actuator.world
        self.row, self.route, self.rng, self.name, self.sim = row, route, rng, name, sim
        self._guard = PlugInGuard(planner, f"target '{name}'", ProcessPhase.TARGET, heartbeat)
        self.planning_s: list[float] = []
        self.planned: Plan | None = None
        self.implausible = (0, "")
        self._memory: Any = None
        self._states: State | None = None
        self._is_on_lane: BoolArray = np.zeros(0, dtype=np.bool_)  # of the front, at the states
        self._off_route_edge: str | None = None  # the edge under the target while it is off its route
        self._remaining_m = np.inf  # from the front to the end of the route, once on its last edge

    def start(self, scene: Scene) -> None:
        """Call the planner's ``start``."""
        self._memory = self._guard.call(lambda: self.planner.start(self.road, self._view(scene), self.rng))

    def replan(self, scene: Scene, steps: int) -> None:
        """Ask the planner for a plan, and compute the target's states in the coming *steps* substeps.

        Raises:
            PlannerError: the planner raised.
            PlanRefusedError: its plan holds NaN or a jump, or is too short.
        """
        self._locate_on_route()
        self._insert_again()
        view = self._view(scene)
        plan = self._guard.call(lambda: self._plan(view))
        world, row = self.world, self.row
        self.planned = plan
        problems = motion_problems(plan, scene)
        if problems:
            count, first = self.implausible
            self.implausible = count + 1, first or f"{problems[0]} (plan of {scene.time_s:.1f} s)"
        state: State = world.xy_m[row].copy(), world.yaw_rad[row].copy(), world.speed_mps[row].copy()
        length = world.size_m[row, 0]
        self._states = xy, yaw, _ = drive_plan(state, plan, length, self.sim.step_s, steps, Limits())
        self._is_on_lane = self.actuator.is_on_lane(np.array([row]), xy[None], yaw[None])[0]
        self.actuator.predict_route(row, self._expected_route(state, plan))

    def _plan(self, view: Scene) -> Plan:
        """Call the planner's ``plan`` with *view* and return its checked plan."""
        started_s = time.perf_counter()
        answer: Any = self.planner.plan(self.road, view, self._memory, self.rng)
        self.planning_s.append(time.perf_counter() - started_s)
        if not (isinstance(answer, tuple) and len(answer) == 2):
            raise PlanRefusedError(
                f"target '{self.name}' returned {type(answer).__name__}, not (plan, memory)"
            )
        plan, self._memory = answer
        xy_m, sim = self.world.xy_m[self.row], self.sim
        return check_plan(plan, xy_m, sim.model_step_s, f"target '{self.name}'", sim.replan_every)

    def end(self, end: str, time_s: float, failure: str) -> None:
        """Tell a planner in another process that the episode is over."""
        if isinstance(self.planner, Served) and self._memory is not None:
            self.planner.end(self._memory, end, time_s, failure)

    def move(self, k: int) -> None:
        """Move the target to its planned state after substep *k*."""
        if self._states is None:
            return
        xy, yaw, speed = (part[k] for part in self._states)
        self._remaining_m -= float(speed) * self.sim.step_s
        rows = np.array([self.row])
        self.world.set_state(rows, xy, yaw, speed, Controller.PLANNER)
        self.actuator.move(rows, xy[None], np.atleast_1d(yaw), self._is_on_lane[k : k + 1])

    def visible(self) -> frozenset[str] | None:
        """Return None: a Python planner sees all road users."""
        return None

    def arrived(self) -> bool:
        """Return whether the target has reached the end of its route."""
        return self._remaining_m < _ARRIVAL_M

    def route_ahead(self) -> tuple[str, ...]:
        """Return the target's remaining edges."""
        return self.route

    def _expected_route(self, state: State, plan: Plan) -> tuple[str, ...]:
        """Return the edges that the target is about to drive.

        These are the route's remaining edges. If the target is off the route, or its plan leads off it, they are the
        edges of the plan and a random continuation.

        Args:
            state: where it is now.
            plan: what it is about to drive.
        """
        if self._off_route_edge is None or self._states is None:
            turn = self._turn_off_route(*self._planned_poses(state, plan))
            return guessed_route(self.road, self.row, self.route[0], turn) if turn else self.route_ahead()
        xy, yaw = self._states[0][-1], float(self._states[1][-1])
        end_pose = self.road.locate(xy, yaw)
        last_edge = self._off_route_edge if end_pose is None else self.road.edge_of(end_pose.lane_id)
        return guessed_route(self.road, self.row, self._off_route_edge, last_edge)

    def _planned_poses(self, state: State, plan: Plan) -> tuple[FloatArray, FloatArray]:
        """Return (N, 2) positions and (N,) headings of the whole *plan*, a model step apart."""
        if isinstance(plan, Trajectory):
            xy, yaw, dt_s = plan.xy_m, plan.yaw_rad, plan.dt_s
        else:
            dt_s = self.sim.step_s
            count = round(len(plan.accel_mps2) * plan.dt_s / dt_s)
            xy, yaw, _ = drive_plan(state, plan, self.world.size_m[self.row, 0], dt_s, count, Limits())
        stride = max(1, round(self.sim.model_step_s / dt_s))
        return xy[stride - 1 :: stride], yaw[stride - 1 :: stride]

    def _turn_off_route(self, xy_m: FloatArray, yaw_rad: FloatArray) -> str:
        """Return the edge onto which poses (N, 2), (N,) turn off the route; "" if they keep to it.

        Only edges count that follow one of the route's edges.
        """
        possible_edges = {
            edge for route_edge in self.route[:-1] for edge in self.road.edges[route_edge].successors
        }
        for lane in self.road.locate_many(xy_m, yaw_rad, route=self.route)[0]:
            edge = "" if lane is None else self.road.edge_of(lane)
            if edge not in self.route:
                return edge if edge in possible_edges else ""
        return ""

    def _locate_on_route(self) -> None:
        """Drop the edges behind the target, measure the distance to the end, note whether it is off its route."""
        self._off_route_edge = None
        self._remaining_m = np.inf
        pose = self.road.locate(
            self.world.xy_m[self.row], float(self.world.yaw_rad[self.row]), route=self.route
        )
        if pose is None:
            return
        lane, edge = self.road.lanes[pose.lane_id], self.road.edge_of(pose.lane_id)
        self._off_route_edge = None if edge in self.route else edge
        if not lane.is_internal and lane.edge_id in self.route:
            self.route = self.route[self.route.index(lane.edge_id) :]
            front_s_m = pose.s_m + 0.5 * float(self.world.size_m[self.row, 0])
            self._remaining_m = lane.length_m - front_s_m if len(self.route) == 1 else np.inf

    def _insert_again(self) -> None:
        """Insert the target into SUMO again if it is back on a lane."""
        rows = np.array([self.row])
        if self.row in self.actuator.outside and self.actuator.on_lanes(
            rows, self.world.xy_m[rows], self.world.yaw_rad[rows]
        ):
            self.actuator.insert(self.row, TARGET_TYPE)

    def _view(self, scene: Scene) -> Scene:
        """Return a copy of *scene* without what a driver cannot know: the others' routes, and which ones are moved."""
        routes = tuple(self.route if k == scene.target else () for k in range(scene.history.agents))
        return replace(
            scene.copied(),
            routes=routes,
            movable=np.zeros_like(scene.movable),
            replan_s=self.sim.model_step_s * self.sim.replan_every,
        )
