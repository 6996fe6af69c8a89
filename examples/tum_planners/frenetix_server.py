"""Serve Frenetix (TU Munich, frenetix 0.4) with the planner kit.

Frenetix is a C++ library that samples curves in the Frenet frame of a reference line, computes their feasibility and
costs, and sorts them (Trauth et al. 2024, doi:10.1109/ACCESS.2024.3436835). Sampling, costs, constraints, emergency
stop and the collision check against predictions and the road's edges are those of its authors' motion planner. It does
not consider the right of way. If no curve is feasible, the adapter stops along the line.
"""

from __future__ import annotations

from itertools import product

import frenetix
import frenetix.trajectory_functions.cost_functions as cf
import frenetix.trajectory_functions.feasability_functions as ff
import numpy as np
from adapter import REAR_AXLE_M, STEP_S, WHEELBASE_M, Adapter, Task
from advdiff_sumo.planner_kit import serve
from collision_check import checker_of, own_box
from frenetix.trajectory_functions import FillCoordinates
from prediction import predicted_poses

HORIZON_S, SHORTEST_S, LOW_MPS = 3.0, 1.1, 2.0
STEPS = round(HORIZON_S / STEP_S)
SIDE_M, SAMPLES = 3.0, 9  # largest final lateral offset; number of final speeds and of final lateral offsets
TIMES_S = np.round(np.arange(SHORTEST_S, HORIZON_S + STEP_S, 0.3), 2)
ACCEL_MPS2, SWITCH_MPS, FASTEST_MPS, STEER_RAD, STEER_RADPS = 11.5, 7.319, 50.8, 1.066, 0.4  # BMW 320i
WEIGHTS = {"lateral_jerk": 1.0, "longitudinal_jerk": 1.0, "distance_to_reference_path": 3.0}
SPEED_WEIGHT, COLLISION_WEIGHT, VARIANCE_M2, SPEED_STEP_MPS = 1.0, 200.0, 0.1, 5.0
_TIME, _SPEED, _SIDE = 1, 5, 10  # columns of a sampling matrix


class Frenetix(Adapter):
    """Plans 3 s in steps of 0.1 s."""

    steps = STEPS

    def path(self, road, scene, memory, task: Task):
        sample = self._sample(road, scene, memory, task)
        if sample is None:
            return None
        curve = sample.cartesian
        axle = np.column_stack((curve.x, curve.y))[1:]
        return axle, np.column_stack((curve.theta, curve.v, curve.a, curve.kappa))[1:]

    def _sample(self, road, scene, memory, task: Task):
        """Return the cheapest feasible curve without collision, else :func:`soonest_stop`; None if none is feasible."""
        poses, sizes = predicted_poses(road, memory.segments, scene, STEPS, STEP_S)
        frame = frenetix.CoordinateSystemWrapper(np.ascontiguousarray(task.line_m))
        low = task.speed_mps < LOW_MPS
        steer = float(np.arctan(WHEELBASE_M * task.curvature_per_m))
        axle_now = np.array([-REAR_AXLE_M, 0.0])
        state = frenetix.CartesianPlannerState(axle_now, 0.0, task.speed_mps, task.accel_mps2, steer)
        start = frenetix.compute_initial_state(frame, state, WHEELBASE_M, low)
        matrix = sampling_matrix(start.x0_lon, start.x0_lat, task.speed_mps)
        handler = _handler(task, frame, low, predictions(task, poses, sizes))
        handler.generate_trajectories(matrix, low)
        handler.evaluate_all_current_functions(True)
        feasible = [sample for sample in handler.get_sorted_trajectories() if sample.feasible]
        checker = checker_of(task.frame, poses, sizes, memory.boundary_m, continuous=True)
        for sample in feasible:
            curve = sample.cartesian
            axle = np.column_stack((curve.x, curve.y))
            if not checker.collide(own_box(axle, np.asarray(curve.theta), task.size_m)):
                return sample
        return soonest_stop(feasible, float(start.x0_lat[0]))


def sampling_matrix(lon: np.ndarray, lat: np.ndarray, speed_mps: float) -> np.ndarray:
    """Return (N, 13) the curves to sample: all combinations of final times, speeds and lateral offsets."""
    slowest = max(0.01, speed_mps - 0.5 * ACCEL_MPS2 * HORIZON_S)
    fastest = min(speed_mps + ACCEL_MPS2 / 7.0 * HORIZON_S, FASTEST_MPS)
    times = np.union1d(TIMES_S[TIMES_S <= HORIZON_S], HORIZON_S)
    speeds = np.union1d(np.linspace(slowest, fastest, SAMPLES), lon[1])
    sides = np.union1d(np.linspace(-SIDE_M, SIDE_M, SAMPLES), lat[0])
    rows = [
        (0.0, t, *lon, speed, 0.0, *lat, side, 0.0, 0.0) for t, speed, side in product(times, speeds, sides)
    ]
    return np.array(rows)


def soonest_stop(samples, side_m: float):
    """Return the curve with the least final speed, then time, then change of lateral offset; None if there are none."""

    def order(sample):
        parameters = np.asarray(sample.sampling_parameters)
        return parameters[_SPEED], parameters[_TIME], abs(parameters[_SIDE] - side_m)

    return min(samples, key=order, default=None)


def predictions(task: Task, poses: np.ndarray, sizes_m: np.ndarray) -> dict:
    """Return the others as Frenetix objects: poses from the next step on, with a variance, in the vehicle's frame."""
    covariance = np.zeros((6, 6), order="F")
    covariance[0, 0] = covariance[1, 1] = VARIANCE_M2
    objects = {}
    for number, (pose, (length, width)) in enumerate(zip(poses, sizes_m, strict=True)):
        xy, yaw = task.frame.from_world(pose[1:, :2]), pose[1:, 2] - task.frame.yaw_rad
        path = [
            frenetix.PoseWithCovariance(
                np.array([x, y, 0.0]),
                np.array([0.0, 0.0, np.sin(turn / 2.0), np.cos(turn / 2.0)]),
                covariance,
            )
            for (x, y), turn in zip(xy, yaw, strict=True)
        ]
        objects[number] = frenetix.PredictedObject(number, path, float(length), float(width))
    return objects


def _handler(task: Task, frame, low: bool, others: dict):
    """Return the C++ handler with its constraints and costs."""
    handler = frenetix.TrajectoryHandler(dt=STEP_S)
    handler.add_feasability_function(ff.CheckYawRateConstraint(STEER_RAD, WHEELBASE_M, False))
    handler.add_feasability_function(ff.CheckAccelerationConstraint(SWITCH_MPS, ACCEL_MPS2, False))
    handler.add_feasability_function(ff.CheckCurvatureConstraint(STEER_RAD, WHEELBASE_M, False))
    handler.add_feasability_function(ff.CheckCurvatureRateConstraint(WHEELBASE_M, STEER_RADPS, False))
    handler.add_function(FillCoordinates(low, 0.0, frame, HORIZON_S))
    costs = (
        cf.CalculateLateralJerkCost,
        cf.CalculateLongitudinalJerkCost,
        cf.CalculateDistanceToReferencePathCost,
    )
    for cost, (name, weight) in zip(costs, WEIGHTS.items(), strict=True):
        handler.add_cost_function(cost(name, weight))
    desired = float(
        np.clip(task.desired_mps, max(task.speed_mps - SPEED_STEP_MPS, 0.0), task.speed_mps + SPEED_STEP_MPS)
    )
    handler.add_cost_function(
        cf.CalculateVelocityOffsetCost("velocity_offset", SPEED_WEIGHT, desired, STEP_S, SHORTEST_S, False, 2)
    )
    length, width = map(float, task.size_m)
    handler.add_cost_function(
        cf.CalculateCollisionProbabilityFast(
            "prediction", COLLISION_WEIGHT, others, length, width, REAR_AXLE_M
        )
    )
    return handler


if __name__ == "__main__":
    serve(Frenetix, version="frenetix 0.4")
