"""A planner by other authors as a target: the CommonRoad IDM planner of the TU Munich.

The package plans speeds along a given path with the Intelligent Driver Model (Treiber, Hennecke and Helbing 2000,
doi:10.1103/PhysRevE.62.1805); the lead vehicle is the one that enters the path first. Here, the path is the route's
lane. The others are dynamic obstacles with constant velocity. Our bicycle model drives the planned speeds::

    pip install commonroad-idm-planner
    advdiff-sumo run --target examples.commonroad_idm:CommonRoadIdm
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np
from commonroad.common.util import Interval
from commonroad.geometry.shape import Rectangle
from commonroad.planning.goal import GoalRegion
from commonroad.planning.planning_problem import PlanningProblem
from commonroad.prediction.prediction import TrajectoryPrediction
from commonroad.scenario.lanelet import Lanelet
from commonroad.scenario.obstacle import DynamicObstacle, ObstacleType
from commonroad.scenario.scenario import Scenario
from commonroad.scenario.state import CustomState, InitialState
from commonroad.scenario.trajectory import Trajectory as CommonRoadTrajectory
from commonroad_idm_planner.configuration.planner_config import IDMConfigFactory
from commonroad_idm_planner.idm_path import IDMPathFactory
from commonroad_idm_planner.idm_planner import IDMPlanner

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.bicycle import Limits
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.plan import Controls, Plan, Trajectory
from advdiff_sumo.core.polylines import Polyline
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.core.tracking import track
from advdiff_sumo.maps import RoadMap

STEP_S, STEPS = 0.1, 20
_AHEAD_M, _SPACING_M, _HALF_WIDTH_M = 90.0, 0.5, 1.7  # of the path
_LATERAL_MPS2 = 2.0  # comfortable lateral acceleration
_NO_LANE_BRAKE_MPS2 = 4.0


@dataclass(frozen=True)
class CommonRoadIdm:
    """Drives along the route's lane at the speeds of ``commonroad_idm_planner``.

    The planner considers neither signals nor the right of way, and does not change lanes.

    Attributes:
        headway_s: desired time headway.
        accel_mps2: strongest acceleration.
        decel_mps2: comfortable deceleration.
        jam_m: gap at standstill.
    """

    headway_s: float = 1.2
    accel_mps2: float = 1.5
    decel_mps2: float = 2.0
    jam_m: float = 2.0

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> None:
        """Silence the package's log; no memory is needed."""
        del road, scene, rng
        logging.getLogger("cr_idm").setLevel(logging.WARNING)

    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> tuple[Plan, Any]:
        """Return states for 2 s, every 0.1 s; a stop if the route's lane is not found."""
        del rng
        path = _path_ahead(road, scene)
        if path is None:
            return Controls(np.full(STEPS, -_NO_LANE_BRAKE_MPS2), np.zeros(STEPS), STEP_S), memory
        line, limit_mps = path
        speed = self._speeds(scene, line, limit_mps)
        return _tracked(scene, line, speed), memory

    def _speeds(self, scene: Scene, line: Polyline, limit_mps: float) -> FloatArray:
        """Return the feasible speeds (STEPS,) that the package plans."""
        now, row = scene.history, scene.target
        config = IDMConfigFactory.generate_custom_config(
            v_desired=max(min(limit_mps, _bend_limit(line)), 1.0),
            safe_time_headway=self.headway_s,
            maximum_acceleration=self.accel_mps2,
            desired_deceleration=self.decel_mps2,
            acceleration_exponent=4.0,
            jam_distance_zero=self.jam_m,
            jam_distance_one=0.0,
            vehicle_length=float(now.size_m[row, 0]),
            vehicle_width=float(now.size_m[row, 1]),
            planning_horizon=STEPS,
            ignore_static_obstacles=False,
        )
        path = IDMPathFactory.generate_idm_path_from_np_2d_positional_array(line.xy_m)
        planner = IDMPlanner(_scenario(now, row, line), _problem(now, row), config, path, logging.WARNING)
        states = planner.plan().state_list[1 : STEPS + 1]
        planned = np.array([float(state.velocity) for state in states])
        return _feasible(planned, max(float(now.speed_mps[row, -1]), 0.0))


def _path_ahead(road: RoadMap, scene: Scene) -> tuple[Polyline, float] | None:
    """Return the line that the target follows and the present speed limit; None if the route's lane is not found."""
    now, route = scene.history, scene.routes[scene.target]
    xy, yaw = now.xy_m[scene.target, -1], float(now.yaw_rad[scene.target, -1])
    pose = road.locate(xy, yaw, route=route or None)
    if pose is None or not route:
        return None
    paths = road.lane_path(route, pose.lane_id, _AHEAD_M, start_s_m=pose.s_m)
    if not paths or paths[0].line.length_m < 2.0 * _SPACING_M:
        return None
    return paths[0].line.resample(spacing_m=_SPACING_M), float(paths[0].speed_mps[0])


def _scenario(now: Tracks, row: int, line: Polyline) -> Scenario:
    """Return a scenario with the line as the only lanelet, and all others than *row* at constant velocity."""
    scenario = Scenario(dt=STEP_S)
    left, right = line.offset(_HALF_WIDTH_M).resample(count=len(line.xy_m)), line.offset(-_HALF_WIDTH_M)
    right = right.resample(count=len(line.xy_m))
    scenario.add_objects(Lanelet(left.xy_m, line.xy_m, right.xy_m, 1))
    for other in np.flatnonzero(now.valid[:, -1]).tolist():
        if other != row:
            scenario.add_objects(_obstacle(now, other))
    return scenario


def _obstacle(now: Tracks, row: int) -> DynamicObstacle:
    shape = Rectangle(float(now.size_m[row, 0]), float(now.size_m[row, 1]))
    xy, yaw, speed = now.xy_m[row, -1], float(now.yaw_rad[row, -1]), float(now.speed_mps[row, -1])
    velocity = speed * unit(np.asarray(yaw))
    states = [
        CustomState(time_step=k, position=xy + k * STEP_S * velocity, orientation=yaw, velocity=speed)
        for k in range(1, STEPS + 2)
    ]
    prediction = TrajectoryPrediction(CommonRoadTrajectory(1, states), shape)
    return DynamicObstacle(row + 100, ObstacleType.CAR, shape, _initial(xy, yaw, speed), prediction)


def _problem(now: Tracks, row: int) -> PlanningProblem:
    """Return a planning problem whose goal is never reached, since only the next seconds are planned."""
    xy, yaw = now.xy_m[row, -1], float(now.yaw_rad[row, -1])
    goal = GoalRegion([CustomState(time_step=Interval(10_000, 20_000))])
    return PlanningProblem(1, _initial(xy, yaw, max(float(now.speed_mps[row, -1]), 0.0)), goal)


def _initial(xy_m: FloatArray, yaw_rad: float, speed_mps: float) -> InitialState:
    return InitialState(
        time_step=0,
        position=xy_m,
        orientation=yaw_rad,
        velocity=speed_mps,
        acceleration=0.0,
        yaw_rate=0.0,
        slip_angle=0.0,
    )


def _bend_limit(line: Polyline) -> float:
    """Return the comfortable speed in the sharpest bend within the next 25 m."""
    near = np.abs(line.curvature_1pm[line.s_m < 25.0])
    return float(np.sqrt(_LATERAL_MPS2 / max(float(near.max(initial=0.0)), 1e-3)))


def _feasible(planned_mps: FloatArray, now_mps: float) -> FloatArray:
    """Return *planned_mps* (T,) limited by a vehicle's accelerations, extended to STEPS with the last value."""
    limits, speeds, before = Limits(), np.empty(STEPS), now_mps
    for k in range(STEPS):
        goal = float(planned_mps[min(k, len(planned_mps) - 1)])
        goal = goal if np.isfinite(goal) else 0.0
        low, high = before - limits.brake_mps2 * STEP_S, before + limits.accel_mps2 * STEP_S
        before = speeds[k] = max(float(np.clip(goal, low, high)), 0.0)
    return speeds


def _tracked(scene: Scene, line: Polyline, speed_mps: FloatArray) -> Trajectory:
    """Return the trajectory of a bicycle model that tracks *line* at *speed_mps* (T,)."""
    now, row = scene.history, scene.target
    start = max(float(now.speed_mps[row, -1]), 0.0)
    s = float(line.project(now.xy_m[row, -1])[0])
    before = np.append(start, speed_mps[:-1])
    xy, yaw = line.at(s + np.cumsum(0.5 * (before + speed_mps) * STEP_S), extrapolate=True)
    state = now.xy_m[row, -1], now.yaw_rad[row, -1], np.asarray(start)
    return Trajectory(*track(state, (xy, yaw, speed_mps), now.size_m[row, 0], STEP_S, Limits()), dt_s=STEP_S)
