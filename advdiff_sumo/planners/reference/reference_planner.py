"""Targets that drive as the lane-graph planner does, with the perception and emergency reaction of UN R157.

The models are those of :mod:`advdiff_sumo.metrics.reference`; ``docs/reference-drivers.md`` says what they are.
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
from advdiff_sumo.metrics.reference.corridor import Meeting, corridor_of, demands, meeting
from advdiff_sumo.metrics.reference.driver_models import (
    CRITICAL_TTC_S,
    FSM,
    HUMAN,
    REGULATION,
    RSS,
    DriverModel,
)
from advdiff_sumo.metrics.reference.others_paths import expected
from advdiff_sumo.metrics.reference.own_way import OwnWay, way_through
from advdiff_sumo.metrics.reference.reaction import Reaction, react
from advdiff_sumo.planners.lane_graph import LaneGraphPlanner
from advdiff_sumo.planners.lane_graph.memory import LaneGraphMemory

#: After so long without alarm a driver is taken by surprise again.
CALM_S = 2.0
_RADIUS_M = 120.0
_BEYOND_M = 80.0


@dataclass(frozen=True)
class ReferenceMemory:
    """State between plans.

    Attributes:
        base: memory of the lane-graph planner.
        reactions: how far the driver's reaction is at each instant of the last plan.
        alarmed_s: when the situation was last unsafe; −inf for never.
        plan: the last plan; None before the first.
        planned_s: when it was made.
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
        due = max(round((time_s - self.planned_s) / self.plan.dt_s) - 1, 0)
        return self.reactions[min(due, len(self.reactions) - 1)], _accel(self.plan, due)


class ReferencePlanner:
    """A reference driver; takes the options of :class:`LaneGraphPlanner`, whose way and pace it drives.

    Raises:
        ConfigError: an option has no such name or value.
    """

    model: ClassVar[DriverModel] = HUMAN

    def __init__(self, **options: Any) -> None:
        self.normal = LaneGraphPlanner(**options)

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> ReferenceMemory:
        """Return the memory of a driver whom nothing has alarmed yet."""
        return ReferenceMemory(self.normal.start(road, scene, rng), (Reaction.fresh(self.model),))

    def plan(
        self, road: RoadMap, scene: Scene, memory: ReferenceMemory, rng: np.random.Generator
    ) -> tuple[Plan, ReferenceMemory]:
        """Return the lane-graph planner's plan, braked where the reference model reacts, and the new memory."""
        # 1. normal driving
        normal, base = self.normal.plan(road, scene, memory.base, rng)
        if not isinstance(normal, Trajectory):  # the lane-graph planner plans trajectories only
            return normal, replace(memory, base=base)
        # 2. who is, or will be, in the way of it
        reaction, accel = memory.at(scene.time_s)
        met = self._meeting(road, scene, normal, base, accel)
        if scene.time_s - memory.alarmed_s > CALM_S:
            reaction = Reaction.fresh(self.model)
        reacting = bool(reaction.delay_left_s < self.model.delay_s)
        demand = float(demands(self.model, met, reacting, CRITICAL_TTC_S).max(initial=0.0))
        if demand <= 0.0:
            calm = Reaction(reaction.delay_left_s, np.zeros(()))
            return normal, ReferenceMemory(base, (calm,), memory.alarmed_s, normal, scene.time_s)
        # 3. react
        speed = float(scene.history.speed_mps[scene.target, -1])
        braked, states = self._braked(normal, scene, max(speed, 0.0), demand, reaction)
        return braked, ReferenceMemory(base, tuple(states), scene.time_s, braked, scene.time_s)

    def _meeting(
        self, road: RoadMap, scene: Scene, normal: Trajectory, base: LaneGraphMemory, accel_mps2: float
    ) -> Meeting:
        history, row = scene.history, scene.target
        tracks = history.window(max(history.steps - 2, 0), history.steps)
        rows = _near(tracks, row)
        way = _way(normal, tracks, row, base)
        lanes = [_lanes_of(road, scene.routes[other]) for other in rows.tolist()]
        future = expected(road, tracks, rows, _accelerations(tracks, rows), lanes)
        length, width = (float(x) for x in tracks.size_m[row])
        corridor = corridor_of(way, tracks, rows, future, width)
        place = float(way.line.project(tracks.xy_m[row, -1])[0])
        speed = max(float(tracks.speed_mps[row, -1]), 0.0)
        return meeting(corridor, tracks.steps - 1, (place, speed, accel_mps2), length)

    def _braked(
        self, normal: Trajectory, scene: Scene, speed_mps: float, demand_mps2: float, reaction: Reaction
    ) -> tuple[Trajectory, list[Reaction]]:
        """Return *normal* slowed down by the reaction to a lasting demand, and the reaction at each instant."""
        here = scene.history.xy_m[scene.target, -1]
        path = np.vstack((here, normal.xy_m))
        along = stations_m(path)
        yaw = np.unwrap(np.append(scene.history.yaw_rad[scene.target, -1], normal.yaw_rad))
        speed, states, speeds = speed_mps, [], []
        for wish in normal.speed_mps.tolist():
            reaction, accel = react(reaction, self.model, np.asarray(demand_mps2), normal.dt_s)
            speed = max(min(wish, speed + float(accel) * normal.dt_s), 0.0)
            speeds.append(speed)
            states.append(reaction)
        paced = np.array(speeds)
        before = np.append(speed_mps, paced[:-1])
        s = np.minimum(np.cumsum(0.5 * (paced + before) * normal.dt_s), along[1:])
        xy = np.stack([np.interp(s, along, path[:, axis]) for axis in (0, 1)], -1)
        return Trajectory(xy, np.interp(s, along, yaw), paced, normal.dt_s), states


class CarefulPlanner(ReferencePlanner):
    """``careful``: the careful and competent human driver (``CC_human_driver``)."""


class Reg157Planner(ReferencePlanner):
    """``reg157``: the regulation's requirement on the system."""

    model = REGULATION


class RssPlanner(ReferencePlanner):
    """``rss``: responsibility-sensitive safety."""

    model = RSS


class FsmPlanner(ReferencePlanner):
    """``fsm``: the fuzzy safety model."""

    model = FSM


def _near(tracks: Tracks, target: int) -> IntArray:
    offset = tracks.xy_m[:, -1] - tracks.xy_m[target, -1]
    near = tracks.valid[:, -1] & (np.hypot(offset[:, 0], offset[:, 1]) < _RADIUS_M)
    near[target] = False
    return np.flatnonzero(near)


def _way(normal: Trajectory, tracks: Tracks, target: int, base: LaneGraphMemory) -> OwnWay:
    """Return the way of the plan, and of the lanes chosen for it beyond the plan's end."""
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
    return frozenset(lane for edge in route if edge in road.edges for lane in road.edges[edge].lane_ids)


def _accelerations(tracks: Tracks, rows: IntArray) -> FloatArray:
    """Return (N, K) changes of speed over the last step; 0 where it is not known."""
    speed = tracks.speed_mps[rows]
    return np.nan_to_num(np.diff(speed, prepend=speed[:, :1], axis=1) / tracks.dt_s)


def _accel(plan: Trajectory, due: int) -> float:
    """Return the acceleration that *plan* has at instant *due*."""
    after = min(due + 1, len(plan.speed_mps) - 1)
    return float(plan.speed_mps[after] - plan.speed_mps[max(after - 1, 0)]) / plan.dt_s
