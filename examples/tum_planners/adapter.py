"""Common parts of both adapters: the planning frame, the initial state, and the emergency stop."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from advdiff_sumo.planner_kit import KitRoad, Scene, Trajectory
from prediction import LaneSegments, lane_segments
from reference_line import ReferenceLine, reference_line

STEP_S, REPLAN_STEPS = 0.1, 5
REAR_AXLE_M, WHEELBASE_M = 1.4227170936, 2.5789127700  # BMW 320i, the default vehicle of both planners
EMERGENCY_MPS2, LEAST_MPS = 8.0, 0.01  # deceleration of the emergency stop; least speed given to the planners
LINE_M, LINE_S = 150.0, 9.0  # least length of the reference line, and its least duration at the present speed
_TRACKED_M = 0.5  # the last plan was followed if the vehicle is nearer than this to its planned position
_SLOWEST_MPS = 1.0  # least speed for estimating the curvature


@dataclass(frozen=True)
class OwnFrame:
    """The vehicle's frame: the origin is its centre, x points along its heading.

    In this frame headings are small, as the planners' Frenet frames require.
    """

    xy_m: np.ndarray
    yaw_rad: float

    def from_world(self, xy_m: np.ndarray) -> np.ndarray:
        """Return points (…, 2), given in the world's frame, in this frame."""
        return (xy_m - self.xy_m) @ self._rotation()

    def to_world(self, xy_m: np.ndarray) -> np.ndarray:
        """Return points (…, 2), given in this frame, in the world's frame."""
        return xy_m @ self._rotation().T + self.xy_m

    def _rotation(self) -> np.ndarray:
        cos, sin = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return np.array([[cos, -sin], [sin, cos]])


@dataclass(frozen=True)
class Expected:
    """Position, acceleration and curvature that the last plan has for the present instant."""

    xy_m: np.ndarray
    accel_mps2: float
    curvature_per_m: float


@dataclass(frozen=True)
class Memory:
    """Memory of an episode: the lanes, the edges (K, 2, 2) of the road, and the state expected by the last plan."""

    segments: LaneSegments
    boundary_m: np.ndarray
    expected: Expected | None = None


@dataclass(frozen=True)
class Task:
    """A planning problem.

    Attributes:
        frame: the vehicle's frame.
        line: reference line in the world's frame.
        line_m: (P, 2) the same line in the vehicle's frame.
        size_m: length and width of the vehicle.
        speed_mps, accel_mps2, curvature_per_m: present motion of the vehicle.
        desired_mps: speed that respects limits, bends and red lights.
    """

    frame: OwnFrame
    line: ReferenceLine
    line_m: np.ndarray
    size_m: np.ndarray
    speed_mps: float
    accel_mps2: float
    curvature_per_m: float
    desired_mps: float


def started(road: KitRoad) -> Memory:
    """Return the memory of a new episode."""
    rings = [ring for polygon in road.drivable_area for ring in polygon]
    pieces = [np.stack((ring[:-1], ring[1:]), axis=1) for ring in rings]
    return Memory(lane_segments(road), np.concatenate(pieces) if pieces else np.zeros((0, 2, 2)))


def task_now(road: KitRoad, scene: Scene, memory: Memory) -> Task | None:
    """Return the planning problem of the present instant; None if the vehicle is on no lane of its route."""
    now, me = scene.history, scene.target
    line = reference_line(road, scene, ahead_m=max(LINE_M, LINE_S * float(now.speed_mps[me, -1])))
    if line is None:
        return None
    frame = OwnFrame(now.xy_m[me, -1], float(now.yaw_rad[me, -1]))
    accel, curvature = _motion(scene, memory.expected)
    return Task(
        frame=frame,
        line=line,
        line_m=frame.from_world(line.xy_m),
        size_m=now.size_m[me],
        speed_mps=max(float(now.speed_mps[me, -1]), LEAST_MPS),
        accel_mps2=accel,
        curvature_per_m=curvature,
        desired_mps=line.desired_mps(float(now.size_m[me, 0])),
    )


def _motion(scene: Scene, expected: Expected | None) -> tuple[float, float]:
    """Return the present acceleration and curvature.

    They are those of the last plan if it was followed; otherwise they are estimated from the last half second.
    """
    now, me = scene.history, scene.target
    if expected is not None and np.linalg.norm(expected.xy_m - now.xy_m[me, -1]) < _TRACKED_M:
        return expected.accel_mps2, expected.curvature_per_m
    if now.steps < 2 or not now.valid[me, -2]:
        return 0.0, 0.0
    speed, yaw = now.speed_mps[me, -2:], np.unwrap(now.yaw_rad[me, -2:])
    curvature = (yaw[1] - yaw[0]) / now.dt_s / max(float(speed.mean()), _SLOWEST_MPS)
    return float(speed[1] - speed[0]) / now.dt_s, float(curvature)


def planned(task: Task, memory: Memory, axle_m: np.ndarray, states: np.ndarray) -> tuple[Trajectory, Memory]:
    """Return the plan in the world's frame, and the memory with the state that it expects at the next call.

    Args:
        task: the planning problem.
        memory: the memory so far.
        axle_m: (T, 2) positions of the rear axle from the next step on, in the vehicle's frame.
        states: (T, 4) heading in that frame, speed, acceleration, curvature.
    """
    yaw = states[:, 0]
    centre = axle_m + REAR_AXLE_M * np.stack((np.cos(yaw), np.sin(yaw)), axis=-1)
    xy = task.frame.to_world(centre)
    replan = min(REPLAN_STEPS, len(xy)) - 1
    expected = Expected(xy[replan], float(states[replan, 2]), float(states[replan, 3]))
    return Trajectory(xy, yaw + task.frame.yaw_rad, states[:, 1], STEP_S), replace(memory, expected=expected)


class Adapter(ABC):
    """A planner of the planner kit: returns the plan that :meth:`path` finds, otherwise a stop along the line."""

    steps: int

    def start(self, road, scene, rng):
        return started(road)

    def plan(self, road, scene, memory, rng):
        task = task_now(road, scene, memory)
        path = None if task is None else self.path(road, scene, memory, task)
        if path is None:
            return emergency_stop(scene, None if task is None else task.line, self.steps), memory
        return planned(task, memory, *path)

    @abstractmethod
    def path(self, road, scene, memory, task: Task) -> tuple[np.ndarray, np.ndarray] | None:
        """Return positions of the rear axle and states, as arguments of :func:`planned`; None if there is no path."""


def emergency_stop(scene: Scene, line: ReferenceLine | None, steps: int) -> Trajectory:
    """Return a stop at ``EMERGENCY_MPS2`` along the line at the present lateral offset; straight on without a line."""
    now, me = scene.history, scene.target
    xy, yaw, speed = now.xy_m[me, -1], float(now.yaw_rad[me, -1]), float(now.speed_mps[me, -1])
    times = STEP_S * np.arange(1, steps + 1)
    braking_s = np.minimum(times, speed / EMERGENCY_MPS2)
    distance = speed * braking_s - 0.5 * EMERGENCY_MPS2 * braking_s**2
    speeds = np.maximum(speed - EMERGENCY_MPS2 * times, 0.0)
    if line is None:
        xy = xy + distance[:, None] * [np.cos(yaw), np.sin(yaw)]
        return Trajectory(xy, np.full(steps, yaw), speeds, STEP_S)
    tangent = np.gradient(line.xy_m, axis=0)
    heading = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    s = np.arange(len(line.xy_m), dtype=float)  # the points of the line are a metre apart
    on_line = np.column_stack([np.interp(line.s_m + distance, s, line.xy_m[:, k]) for k in (0, 1)])
    start = np.array([np.interp(line.s_m, s, line.xy_m[:, k]) for k in (0, 1)])
    turn = np.interp(line.s_m + distance, s, heading) - np.interp(line.s_m, s, heading)
    rotation = np.stack((np.cos(turn), -np.sin(turn), np.sin(turn), np.cos(turn)), axis=-1)
    xy = on_line + rotation.reshape(-1, 2, 2) @ (xy - start)
    return Trajectory(xy, yaw + turn, speeds, STEP_S)
