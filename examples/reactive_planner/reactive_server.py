"""CommonRoad's reactive planner (TU Munich, commonroad-reactive-planner 2025.1) behind the planner kit.

It samples quintic and quartic curves in the Frenet frame of the route's lane (Werling et al. 2010,
doi:10.1109/ROBOT.2010.5509799), checks them against the others, who are taken to keep their velocity, and drives the
cheapest. It knows neither signals nor the right of way. Where it finds no curve we brake. ``setup.sh`` makes its
environment.
"""

from __future__ import annotations

import logging

import commonroad_dc.pycrcc as pycrcc
import numpy as np
from advdiff_sumo.planner_kit import Controls, Trajectory, serve
from commonroad.scenario.scenario import Scenario
from commonroad_rp.reactive_planner import ReactivePlanner
from commonroad_rp.state import ReactivePlannerState
from commonroad_rp.utility.config import ReactivePlannerConfiguration
from commonroad_rp.utility.utils_coordinate_system import create_coordinate_system
from route_line import route_line

STEP_S, STEPS, LATERAL_MPS2, BRAKE_MPS2 = 0.1, 30, 2.0, 8.0
logging.disable(logging.WARNING)


class Reactive:
    """Plans 3 s at 0.1 s; its memory is the acceleration at which it was."""

    def start(self, road, scene, rng):
        return 0.0

    def plan(self, road, scene, memory, rng):
        found = route_line(road, scene, ahead_m=120.0)
        states = None if found is None else self._states(scene, *found, memory)
        if states is None:
            return Controls(np.full(STEPS, -BRAKE_MPS2), np.zeros(STEPS), STEP_S), 0.0
        driven = states[1:]
        yaw = np.array([s.orientation for s in driven])
        axle = np.array([s.position for s in driven])
        back = self.rear_m * np.stack((np.cos(yaw), np.sin(yaw)), axis=-1)
        speed = np.array([s.velocity for s in driven])
        return Trajectory(axle + back, yaw, speed, STEP_S), float(driven[4].acceleration)

    rear_m = 1.4227170936

    def _states(self, scene, line, limit_mps, accel_mps2):
        now, me = scene.history, scene.target
        yaw, speed = float(now.yaw_rad[me, -1]), max(float(now.speed_mps[me, -1]), 0.01)
        config = ReactivePlannerConfiguration()
        config.vehicle.length, config.vehicle.width = map(float, now.size_m[me])
        config.planning.time_steps_computation = STEPS
        config.debug.multiproc, config.debug.logging_level = False, "ERROR"
        config.update(scenario=Scenario(dt=STEP_S), planning_problem=None)
        rear = now.xy_m[me, -1] - self.rear_m * np.array([np.cos(yaw), np.sin(yaw)])
        start = ReactivePlannerState(
            time_step=0,
            position=rear,
            steering_angle=0.0,
            velocity=speed,
            orientation=yaw,
            acceleration=accel_mps2,
            yaw_rate=0.0,
        )
        planner = InTraffic(config)
        planner.reset(
            config,
            initial_state_cart=start,
            collision_checker=_checker(now, me),
            coordinate_system=create_coordinate_system(line),
        )
        planner.set_desired_velocity(min(limit_mps, _bend_limit(line, rear)), speed)
        planned = planner.plan()
        return None if planned is None else planned[0].state_list


class InTraffic(ReactivePlanner):
    """The planner with a checker of the road users alone: it would make one of a CommonRoad map, which there is not."""

    def set_collision_checker(self, scenario=None, collision_checker=None, road_boundary_obstacle=None):
        super().set_collision_checker(collision_checker=collision_checker or pycrcc.CollisionChecker())


def _checker(now, me):
    """Return the others, each with its velocity kept."""
    checker = pycrcc.CollisionChecker()
    for row in np.flatnonzero(now.valid[:, -1]):
        if row == me:
            continue
        moving = pycrcc.TimeVariantCollisionObject(0)
        yaw = float(now.yaw_rad[row, -1])
        step = now.speed_mps[row, -1] * STEP_S * np.array([np.cos(yaw), np.sin(yaw)])
        for k in range(STEPS + 1):
            x, y = now.xy_m[row, -1] + k * step
            moving.append_obstacle(
                pycrcc.RectOBB(0.5 * now.size_m[row, 0], 0.5 * now.size_m[row, 1], yaw, x, y)
            )
        checker.add_collision_object(moving)
    return checker


def _bend_limit(line, xy):
    """Return the speed at which the sharpest bend of the next 30 m is comfortable."""
    first = int(np.linalg.norm(line - xy, axis=1).argmin())
    step = np.diff(line[first : first + 30], axis=0)
    turn = np.abs(np.diff(np.unwrap(np.arctan2(step[:, 1], step[:, 0]))))
    sharpest = float(np.convolve(turn, np.ones(3) / 3.0, "same").max(initial=0.0))
    return float(np.sqrt(LATERAL_MPS2 / max(sharpest, 1e-3)))


if __name__ == "__main__":
    serve(Reactive, version="commonroad-reactive-planner 2025.1")
