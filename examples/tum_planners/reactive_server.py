"""Serve CommonRoad's reactive planner (TU Munich, commonroad-reactive-planner 2025.1) with the planner kit.

It samples quintic and quartic curves in the Frenet frame of a reference line (Werling et al. 2010,
doi:10.1109/ROBOT.2010.5509799), removes those that are not feasible or collide, and drives the cheapest. Horizon,
sampling, costs, vehicle and constraints are its defaults; it plans in one process instead of six. The adapter provides
what its authors take from a CommonRoad scenario: reference line, desired speed, predictions of the others, and the
road's edges. It does not consider the right of way. If it finds no curve, the adapter stops along the line or stands.
The planner itself can also plan to stand, but version 2025.1 raises then, because it logs a cost that such a plan
lacks.
"""

from __future__ import annotations

import logging

import commonroad_dc.pycrcc as pycrcc
import numpy as np
from adapter import REAR_AXLE_M, STEP_S, WHEELBASE_M, Adapter, Task
from advdiff_sumo.planner_kit import serve
from collision_check import checker_of
from commonroad_clcs.pycrccosy import (
    CartesianProjectionDomainError,
    CurvilinearProjectionDomainLateralError,
    CurvilinearProjectionDomainLongitudinalError,
)
from commonroad.scenario.scenario import Scenario
from commonroad_rp.reactive_planner import ReactivePlanner
from commonroad_rp.state import ReactivePlannerState
from commonroad_rp.utility.config import ReactivePlannerConfiguration
from commonroad_rp.utility.utils_coordinate_system import create_coordinate_system
from prediction import predicted_poses

HORIZON = 60  # steps
STANDS_MPS = 0.05  # largest speed at which the planner may plan to stand still
OUTSIDE = (
    CartesianProjectionDomainError,
    CurvilinearProjectionDomainLateralError,
    CurvilinearProjectionDomainLongitudinalError,
)
logging.disable(logging.WARNING)


class Reactive(Adapter):
    """Plans 6 s in steps of 0.1 s."""

    steps = HORIZON

    def path(self, road, scene, memory, task: Task):
        states = self._states(road, scene, memory, task)
        if states is None:
            return None
        rows = [
            (s.orientation, s.velocity, s.acceleration, np.tan(s.steering_angle) / WHEELBASE_M)
            for s in states
        ]
        return np.array([s.position for s in states]), np.array(rows)

    def _states(self, road, scene, memory, task: Task):
        """Return the states of its plan from the next step on, in the vehicle's frame; None if there is no plan."""
        config = ReactivePlannerConfiguration()
        config.vehicle.length, config.vehicle.width = map(float, task.size_m)
        config.planning.time_steps_computation = HORIZON
        config.debug.multiproc, config.debug.logging_level = False, "ERROR"
        config.update(scenario=Scenario(dt=STEP_S), planning_problem=None)
        poses, sizes = predicted_poses(road, memory.segments, scene, HORIZON, STEP_S)
        planner = InTraffic(config)
        try:
            planner.reset(
                config,
                initial_state_cart=_initial(task),
                collision_checker=checker_of(task.frame, poses, sizes, memory.boundary_m, continuous=False),
                coordinate_system=frenet_frame(task.line_m),
            )
        except (ValueError, *OUTSIDE):  # the vehicle is outside the domain of the Frenet frame
            return None
        planner.set_desired_velocity(task.desired_mps, task.speed_mps)
        try:
            result = planner.plan()
        except TypeError:
            if task.speed_mps > STANDS_MPS:
                raise
            return None  # it planned to stand still, and its log line about this raised
        return None if result is None else result[0].state_list[1:]


class InTraffic(ReactivePlanner):
    """The planner with a given collision checker; by default, it would make one from a CommonRoad map."""

    def set_collision_checker(self, scenario=None, collision_checker=None, road_boundary_obstacle=None):
        super().set_collision_checker(collision_checker=collision_checker or pycrcc.CollisionChecker())


def frenet_frame(line_m: np.ndarray):
    """Return the planner's Frenet frame of a line.

    Beside a sharp bend, some samples are outside the frame's domain. The planner removes them if the conversion returns
    None, but the frame of commonroad-clcs 2025.2 raises, which would end the plan.
    """
    frame = create_coordinate_system(line_m)
    convert = frame.convert_to_cartesian_coords

    def position_or_none(s: float, d: float):
        try:
            return convert(s, d)
        except OUTSIDE:
            return None

    frame.convert_to_cartesian_coords = position_or_none
    return frame


def _initial(task: Task) -> ReactivePlannerState:
    return ReactivePlannerState(
        time_step=0,
        position=np.array([-REAR_AXLE_M, 0.0]),
        steering_angle=float(np.arctan(WHEELBASE_M * task.curvature_per_m)),
        velocity=task.speed_mps,
        orientation=0.0,
        acceleration=task.accel_mps2,
        yaw_rate=task.curvature_per_m * task.speed_mps,
    )


if __name__ == "__main__":
    serve(Reactive, version="commonroad-reactive-planner 2025.1")
