"""Propose what the target may drive: the model's samples, their speeds along the route, and braking."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.kinematic_states import KinematicStates
from advdiff_sumo.planners.lane_graph.path import SPACING_M, slowed_ahead
from advdiff_sumo.planners.lane_graph.variants import Variant
from advdiff_sumo.planners.learned.guide import Guide

RAW, BRAKE = -1, -2
BRAKES_MPS2 = (2.0, 4.0, 8.0)
_LATERAL_MPS2, _BEND_BRAKE_MPS2 = 3.0, 3.0  # bounds the speed in bends; braking before them
_MAX_BRAKE_MPS2 = 8.0


@dataclass(frozen=True)
class Candidates(KinematicStates):
    """C futures of the target at T instants, (C, T).

    Attributes:
        line: (C,) index of the guide's line that is driven; ``RAW``: the sample as it is; ``BRAKE``: braking.
        sample: (C,) sample from which motion or speed are taken; 0 for braking.
    """

    line: IntArray
    sample: IntArray


def candidates(
    xy_m: FloatArray,
    yaw_rad: FloatArray,
    speed_mps: FloatArray,
    guide: Guide | None,
    now: tuple[FloatArray, float, float],
    dt_s: float,
    route: bool,
    brakes: bool,
) -> Candidates:
    """Return the candidates.

    Args:
        xy_m: (S, T, 2) centres of the target in the model's samples.
        yaw_rad: (S, T) its headings in the samples.
        speed_mps: (S, T) its speeds in the samples.
        guide: lines along the route; None if there are none.
        now: its present centre (2,), heading and speed.
        dt_s: time step.
        route: whether to try the samples' speeds along the lines.
        brakes: whether to try braking.
    """
    count = len(speed_mps)
    groups = [(xy_m, yaw_rad, speed_mps, RAW, np.arange(count))]
    if guide is not None and route:
        for index, line in enumerate(guide.lines):
            states = _along(line, speed_mps, now[2], dt_s)
            groups.append((*states, index, np.arange(count)))
    if brakes:
        time_s = dt_s * np.arange(1, speed_mps.shape[1] + 1)
        speeds = np.maximum(now[2] - np.array(BRAKES_MPS2)[:, None] * time_s, 0.0)
        states = (
            _straight(now, speeds, dt_s) if guide is None else _along(guide.lines[0], speeds, now[2], dt_s)
        )
        groups.append((*states, BRAKE, np.zeros(len(speeds), dtype=np.int64)))
    xy, yaw, speed = (np.concatenate([group[k] for group in groups]) for k in range(3))
    line_of = np.concatenate([np.full(len(group[2]), group[3]) for group in groups])
    return Candidates(xy, yaw, speed, line_of, np.concatenate([group[4] for group in groups]))


def driven_m(speed_mps: FloatArray, now_mps: float, dt_s: float) -> FloatArray:
    """Return the distances (…, T) driven at speeds (…, T), starting from *now_mps*."""
    previous = np.concatenate((np.full((*speed_mps.shape[:-1], 1), now_mps), speed_mps[..., :-1]), axis=-1)
    return np.asarray(np.cumsum(0.5 * (previous + speed_mps) * dt_s, axis=-1))


def _along(
    line: Variant, speed_mps: FloatArray, now_mps: float, dt_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the states of driving *line* at speeds (S, T), slower before and in bends."""
    bend_speeds = _bend_speeds(line)
    s, previous = np.full(len(speed_mps), line.s_m), np.full(len(speed_mps), now_mps)
    s_m, speeds = np.empty_like(speed_mps), np.empty_like(speed_mps)
    for k in range(speed_mps.shape[1]):
        cell = np.clip((s + previous * dt_s) / SPACING_M, 0, len(bend_speeds) - 1).astype(np.int64)
        speed = np.minimum(speed_mps[:, k], np.maximum(bend_speeds[cell], previous - _MAX_BRAKE_MPS2 * dt_s))
        s = s + 0.5 * (previous + speed) * dt_s
        s_m[:, k], speeds[:, k], previous = s, speed, speed
    xy, yaw = line.poses(s_m)
    return xy, yaw, speeds


def _bend_speeds(line: Variant) -> FloatArray:
    """Return (P,) the highest speed at each metre of the line's path, low enough ahead of every bend."""
    bound = np.sqrt(_LATERAL_MPS2) * line.path.bend_mps
    return slowed_ahead(bound, _BEND_BRAKE_MPS2, 1.0)


def _straight(
    now: tuple[FloatArray, float, float], speed_mps: FloatArray, dt_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the states of driving straight on at speeds (S, T)."""
    xy = now[0] + driven_m(speed_mps, now[2], dt_s)[..., None] * unit(np.asarray(now[1]))
    return xy, np.full(speed_mps.shape, now[1]), speed_mps
