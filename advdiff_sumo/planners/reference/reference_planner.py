"""Drive the target like the lane-graph planner, with the perception and emergency reaction of UN R157.

The models are those of :mod:`advdiff_sumo.metrics.reference`; ``docs/reference-drivers.md`` explains them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.plan import Plan, Trajectory
from advdiff_sumo.core.polylines import stations_m
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.reference.corridor import Meeting, corridor_of, meeting_at, required_braking_mps2
from advdiff_sumo.metrics.reference.driver_models import (
    CRITICAL_TTC_S,
    FSM,
    HUMAN,
    REGULATION,
    RSS,
    DriverModel,
)
from advdiff_sumo.metrics.reference.others_paths import predicted_motion
from advdiff_sumo.metrics.reference.own_way import OwnWay, way_through
from advdiff_sumo.metrics.reference.reaction import Reaction, react
from advdiff_sumo.planners.lane_graph import LaneGraphPlanner
from advdiff_sumo.planners.lane_graph.memory import LaneGraphMemory

#: After so long without an unsafe situation, the driver's reaction delay starts anew.
CALM_S = 2.0
_RADIUS_M = 120.0  # road users within it are perceived
_BEYOND_M = 80.0  # the way is continued so far beyond the end of the plan


@dataclass(frozen=True)
class ReferenceMemory:
    """State between plans.

    Attributes:
        base: memory of the lane-graph planner.
        reactions: state of the driver's reaction at each instant of the last plan.
        alarmed_s: time of the last unsafe situation; −inf for none.
        plan: the last plan; None before the first.
        planned_s: time at which the last plan was made.
    """

    base: LaneGraphMemory
    reactions: tuple[Reaction, ...]
    alarmed_s: float = -np.inf
    plan: Trajectory | None = None
    planned_s: float = 0.0

    def at(self, time_s: float) -> tuple[Reaction, float]:
        """Return the reaction, and the acceleration in m/s², that were planned for *time_s*."""
        if self.plan is None:
            return self.reactions[-1], 0.0
        step = max(round((time_s - self.planned_s) / self.plan.dt_s) - 1, 0)
        return self.reactions[min(step, len(self.reactions) - 1)], _accel(self.plan, step)


class ReferencePlanner:
    """A reference driver on the path and at the speed of :class:`LaneGraphPlanner`, with its options.

    Raises:
        ConfigError: an option has no such name or value.
    """

    model: ClassVar[DriverModel] = HUMAN

    def __init__(self, **options: Any) -> None:
        self.normal = LaneGraphPlanner(**options)

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> ReferenceMemory:
        """Return the memory of a driver before any unsafe situation."""
        return ReferenceMemory(self.normal.start(road, scene, rng), (Reaction.fresh(self.model),))

    def plan(
        self, road: RoadMap, scene: Scene, memory: ReferenceMemory, rng: np.random.Generator
    ) -> tuple[Plan, ReferenceMemory]:
        """Return the plan of the lane-graph planner, with the braking of the reference model, and the new memory."""
        # 1. Plan normal driving.
        normal, base = self.normal.plan(road, scene, memory.base, rng)
        if not isinstance(normal, Trajectory):  # the lane-graph planner plans trajectories only
            return normal, replace(memory, base=base)
        # 2. Find the road users that are or will be in its way, and the deceleration that they demand.
        reaction, accel = memory.at(scene.time_s)
        conflicts = self._meeting(road, scene, normal, base, accel)
        if scene.time_s - memory.alarmed_s > CALM_S:
            reaction = Reaction.fresh(self.model)
        is_reacting = bool(reaction.delay_left_s < self.model.delay_s)
        demands_mps2 = required_braking_mps2(self.model, conflicts, is_reacting, CRITICAL_TTC_S)
        demand_mps2 = float(demands_mps2.max(initial=0.0))
        if demand_mps2 <= 0.0:
            calm = Reaction(reaction.delay_left_s, np.zeros(()))
            return normal, ReferenceMemory(base, (calm,), memory.alarmed_s, normal, scene.time_s)
        # 3. Brake as the reference model does.
        speed = float(scene.history.speed_mps[scene.target, -1])
        braked, states = self._braked(normal, scene, max(speed, 0.0), demand_mps2, reaction)
        return braked, ReferenceMemory(base, tuple(states), scene.time_s, braked, scene.time_s)

    def _meeting(
        self, road: RoadMap, scene: Scene, normal: Trajectory, base: LaneGraphMemory, accel_mps2: float
    ) -> Meeting:
        """Return the conflicts of the planned way with the road users around it."""
        history, row = scene.history, scene.target
        tracks = history.window(max(history.steps - 2, 0), history.steps)
        rows = _rows_near(tracks, row)
        way = _way(normal, tracks, row, base)
        lanes = [_lanes_of(road, scene.routes[other]) for other in rows.tolist()]
        future = predicted_motion(road, tracks, rows, _accelerations(tracks, rows), lanes)
        length, width = (float(value) for value in tracks.size_m[row])
        corridor = corridor_of(way, tracks, rows, future, width)
        s_m = float(way.line.project(tracks.xy_m[row, -1])[0])
        speed = max(float(tracks.speed_mps[row, -1]), 0.0)
        return meeting_at(corridor, tracks.steps - 1, (s_m, speed, accel_mps2), length)

    def _braked(
        self, normal: Trajectory, scene: Scene, speed_mps: float, demand_mps2: float, reaction: Reaction
    ) -> tuple[Trajectory, list[Reaction]]:
        """Return *normal* slowed down by the reaction to a constant *demand_mps2*, and the reaction at each instant."""
        present = scene.history.xy_m[scene.target, -1]
        path = np.vstack((present, normal.xy_m))
        path_s = stations_m(path)
        yaw = np.unwrap(np.append(scene.history.yaw_rad[scene.target, -1], normal.yaw_rad))
        speed, reactions, speeds = speed_mps, [], []
        for planned in normal.speed_mps.tolist():
            reaction, accel = react(reaction, self.model, np.asarray(demand_mps2), normal.dt_s)
            speed = max(min(planned, speed + float(accel) * normal.dt_s), 0.0)
            speeds.append(speed)
            reactions.append(reaction)
        braked = np.array(speeds)
        previous = np.append(speed_mps, braked[:-1])
        s = np.minimum(np.cumsum(0.5 * (braked + previous) * normal.dt_s), path_s[1:])
        xy = np.stack([np.interp(s, path_s, path[:, axis]) for axis in (0, 1)], -1)
        return Trajectory(xy, np.interp(s, path_s, yaw), braked, normal.dt_s), reactions


class CarefulPlanner(ReferencePlanner):
    """``careful``: the careful and competent human driver (``CC_human_driver``)."""


class Reg157Planner(ReferencePlanner):
    """``reg157``: the performance that the regulation requires of the system."""

    model = REGULATION


class RssPlanner(ReferencePlanner):
    """``rss``: responsibility-sensitive safety."""

    model = RSS


class FsmPlanner(ReferencePlanner):
    """``fsm``: the fuzzy safety model."""

    model = FSM


def _rows_near(tracks: Tracks, target: int) -> IntArray:
    """Return the rows of the road users within ``_RADIUS_M`` of the target."""
    offset = tracks.xy_m[:, -1] - tracks.xy_m[target, -1]
    near = tracks.valid[:, -1] & (np.hypot(offset[:, 0], offset[:, 1]) < _RADIUS_M)
    near[target] = False
    return np.flatnonzero(near)


def _way(normal: Trajectory, tracks: Tracks, target: int, base: LaneGraphMemory) -> OwnWay:
    """Return the way of the plan, continued along the lanes chosen by the lane-graph planner."""
    points = [tracks.xy_m[target, -1]]
    for point in normal.xy_m:
        if np.hypot(*(point - points[-1])) > 0.5:
            points.append(point)
    if base.lanes:
        path = base.geometry.path(base.lanes, base.links)
        end = float(path.project(points[-1])[0])
        s = np.arange(end + 2.0, min(end + _BEYOND_M, path.length_m), 2.0)
        points.extend(path.at(s)[0] if len(s) else [])
    return way_through(np.array(points), float(tracks.yaw_rad[target, -1]))


def _lanes_of(road: RoadMap, route: tuple[str, ...]) -> frozenset[str]:
    """Return the lanes of the edges of *route*."""
    return frozenset(lane for edge in route if edge in road.edges for lane in road.edges[edge].lane_ids)


def _accelerations(tracks: Tracks, rows: IntArray) -> FloatArray:
    """Return (N, K) changes of speed over the last step; 0 where unknown."""
    speed = tracks.speed_mps[rows]
    return np.nan_to_num(np.diff(speed, prepend=speed[:, :1], axis=1) / tracks.dt_s)


def _accel(plan: Trajectory, step: int) -> float:
    """Return the acceleration of *plan* from instant *step* on."""
    after = min(step + 1, len(plan.speed_mps) - 1)
    return float(plan.speed_mps[after] - plan.speed_mps[max(after - 1, 0)]) / plan.dt_s
