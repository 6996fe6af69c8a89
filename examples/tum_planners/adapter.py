"""What both planners share: the frame they plan in, the state they start from, and the emergency stop."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from advdiff_sumo.planner_kit import KitRoad, Scene, Trajectory
from prediction import LaneSegments, lane_segments
from reference_line import ReferenceLine, reference_line

STEP_S, REPLAN_STEPS = 0.1, 5
REAR_AXLE_M, WHEELBASE_M = 1.4227170936, 2.5789127700  # BMW 320i, the default vehicle of both
EMERGENCY_MPS2, LEAST_MPS = 8.0, 0.01
LINE_M, LINE_S = 150.0, 9.0  # how far the line leads, at least; longer than the longest plan at any speed
_TRACKED_M, _SLOWEST_MPS = 0.5, 1.0


@dataclass(frozen=True)
class OwnFrame:
    """The vehicle's frame: its centre is the origin, x is its heading.

    Planning in it keeps headings small, which the planners' Frenet frames ask for.
    """

    xy_m: np.ndarray
    yaw_rad: float

    def from_world(self, xy_m: np.ndarray) -> np.ndarray:
        """Return points (…, 2) of the world in this frame."""
        return (xy_m - self.xy_m) @ self._rotation()

    def to_world(self, xy_m: np.ndarray) -> np.ndarray:
        """Return points (…, 2) of this frame in the world."""
        return xy_m @ self._rotation().T + self.xy_m

    def _rotation(self) -> np.ndarray:
        cos, sin = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return np.array([[cos, -sin], [sin, cos]])


@dataclass(frozen=True)
class Expected:
    """Where the last plan meant the vehicle to be now, with what acceleration and curvature."""

    xy_m: np.ndarray
    accel_mps2: float
    curvature_per_m: float


@dataclass(frozen=True)
class Memory:
    """What an episode remembers: the map's lanes and edges, and the last plan."""

    segments: LaneSegments
    boundary_m: np.ndarray
    expected: Expected | None = None


@dataclass(frozen=True)
class Task:
    """One planning problem, in the vehicle's frame.

    Attributes:
        frame: of the vehicle.
        line: what to follow, in the world's frame.
        line_m: (P, 2) the same in the vehicle's frame.
        size_m: length and width.
        speed_mps, accel_mps2, curvature_per_m: of the vehicle now.
        desired_mps: for limits, bends and red lights.
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
    """Return what is to be planned, or None where the vehicle is on no lane of its route."""
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
    """Return acceleration and curvature now: as planned where the plan was kept, else from the last half second."""
    now, me = scene.history, scene.target
    if expected is not None and np.linalg.norm(expected.xy_m - now.xy_m[me, -1]) < _TRACKED_M:
        return expected.accel_mps2, expected.curvature_per_m
    if now.steps < 2 or not now.valid[me, -2]:
        return 0.0, 0.0
    speed, yaw = now.speed_mps[me, -2:], np.unwrap(now.yaw_rad[me, -2:])
    curvature = (yaw[1] - yaw[0]) / now.dt_s / max(float(speed.mean()), _SLOWEST_MPS)
    return float(speed[1] - speed[0]) / now.dt_s, float(curvature)


def planned(task: Task, memory: Memory, axle_m: np.ndarray, states: np.ndarray) -> tuple[Trajectory, Memory]:
    """Return the plan in the world's frame and the memory of it.

    Args:
        task: what was to be planned.
        memory: so far.
        axle_m: (T, 2) places of the rear axle from one step ahead on, in the vehicle's frame.
        states: (T, 4) heading in that frame, speed, acceleration, curvature.
    """
    yaw = states[:, 0]
    centre = axle_m + REAR_AXLE_M * np.stack((np.cos(yaw), np.sin(yaw)), axis=-1)
    xy = task.frame.to_world(centre)
    at = min(REPLAN_STEPS, len(xy)) - 1
    expected = Expected(xy[at], float(states[at, 2]), float(states[at, 3]))
    return Trajectory(xy, yaw + task.frame.yaw_rad, states[:, 1], STEP_S), replace(memory, expected=expected)


class Adapter(ABC):
    """What the planner kit asks of both: a plan where they find a way, else a stop along the line."""

    steps: int

    def start(self, road, scene, rng):
        return started(road)

    def plan(self, road, scene, memory, rng):
        task = task_now(road, scene, memory)
        way = None if task is None else self.way(road, scene, memory, task)
        if way is None:
            return emergency_stop(scene, None if task is None else task.line, self.steps), memory
        return planned(task, memory, *way)

    @abstractmethod
    def way(self, road, scene, memory, task: Task) -> tuple[np.ndarray, np.ndarray] | None:
        """Return places of the rear axle and states, as :func:`planned` takes them; None where there is no way."""


def emergency_stop(scene: Scene, line: ReferenceLine | None, steps: int) -> Trajectory:
    """Return a stop at ``EMERGENCY_MPS2`` beside the line, as far to its side as now; straight on without a line."""
    now, me = scene.history, scene.target
    xy, yaw, speed = now.xy_m[me, -1], float(now.yaw_rad[me, -1]), float(now.speed_mps[me, -1])
    times = STEP_S * np.arange(1, steps + 1)
    braked = np.minimum(times, speed / EMERGENCY_MPS2)
    way = speed * braked - 0.5 * EMERGENCY_MPS2 * braked**2
    speeds = np.maximum(speed - EMERGENCY_MPS2 * times, 0.0)
    if line is None:
        return Trajectory(xy + way[:, None] * [np.cos(yaw), np.sin(yaw)], np.full(steps, yaw), speeds, STEP_S)
    tangent = np.gradient(line.xy_m, axis=0)
    heading = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    at = np.arange(len(line.xy_m), dtype=float)
    along = np.column_stack([np.interp(line.s_m + way, at, line.xy_m[:, k]) for k in (0, 1)])
    base = np.array([np.interp(line.s_m, at, line.xy_m[:, k]) for k in (0, 1)])
    turned = np.interp(line.s_m + way, at, heading) - np.interp(line.s_m, at, heading)
    rotation = np.stack((np.cos(turned), -np.sin(turned), np.sin(turned), np.cos(turned)), axis=-1)
    xy = along + rotation.reshape(-1, 2, 2) @ (xy - base)
    return Trajectory(xy, yaw + turned, speeds, STEP_S)
