"""What the target may drive: the model's samples, their speeds along the route, and braking."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.kinematic_states import KinematicStates
from advdiff_sumo.planners.lane_graph.path import SPACING_M
from advdiff_sumo.planners.lane_graph.variants import Variant
from advdiff_sumo.planners.learned.guide import Guide

RAW, BRAKE = -1, -2
BRAKES_MPS2 = (2.0, 4.0, 8.0)
_LATERAL_MPS2, _BEND_BRAKE_MPS2 = 3.0, 3.0
_MOST_BRAKE_MPS2 = 8.0


@dataclass(frozen=True)
class Candidates(KinematicStates):
    """C futures of the target at T instants, (C, T).

    Attributes:
        line: (C,) index of the guide's line that is driven, ``RAW`` for a sample as it is, ``BRAKE`` for braking.
        sample: (C,) the sample whose motion or speed it is; 0 for braking.
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
    """Return what may be driven.

    Args:
        xy_m: (S, T, 2) the target in the model's samples.
        yaw_rad: (S, T) its headings there.
        speed_mps: (S, T) its speeds there.
        guide: lines along the route, where there are any.
        now: its centre (2,), heading and speed.
        dt_s: spacing.
        route: whether the samples' speeds are tried along the lines.
        brakes: whether braking is tried.
    """
    count = len(speed_mps)
    parts = [(xy_m, yaw_rad, speed_mps, RAW, np.arange(count))]
    if guide is not None and route:
        for number, line in enumerate(guide.lines):
            braked = _along(line, speed_mps, now[2], dt_s)
            parts.append((*braked, number, np.arange(count)))
    if brakes:
        steps = dt_s * np.arange(1, speed_mps.shape[1] + 1)
        slowed = np.maximum(now[2] - np.array(BRAKES_MPS2)[:, None] * steps, 0.0)
        braked = (
            _straight(now, slowed, dt_s) if guide is None else _along(guide.lines[0], slowed, now[2], dt_s)
        )
        parts.append((*braked, BRAKE, np.zeros(len(slowed), dtype=np.int64)))
    xy, yaw, speed = (np.concatenate([part[k] for part in parts]) for k in range(3))
    lines = np.concatenate([np.full(len(part[2]), part[3]) for part in parts])
    return Candidates(xy, yaw, speed, lines, np.concatenate([part[4] for part in parts]))


def driven_m(speed_mps: FloatArray, now_mps: float, dt_s: float) -> FloatArray:
    """Return the distances (…, T) that speeds (…, T) lead to, from *now_mps* on."""
    before = np.concatenate((np.full((*speed_mps.shape[:-1], 1), now_mps), speed_mps[..., :-1]), axis=-1)
    return np.asarray(np.cumsum(0.5 * (before + speed_mps) * dt_s, axis=-1))


def _along(
    line: Variant, speed_mps: FloatArray, now_mps: float, dt_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return states of driving *line* at speeds (S, T), slower where a bend asks for it."""
    pace = _pace(line)
    s, before = np.full(len(speed_mps), line.s_m), np.full(len(speed_mps), now_mps)
    places, paces = np.empty_like(speed_mps), np.empty_like(speed_mps)
    for k in range(speed_mps.shape[1]):
        cell = np.clip((s + before * dt_s) / SPACING_M, 0, len(pace) - 1).astype(np.int64)
        speed = np.minimum(speed_mps[:, k], np.maximum(pace[cell], before - _MOST_BRAKE_MPS2 * dt_s))
        s = s + 0.5 * (before + speed) * dt_s
        places[:, k], paces[:, k], before = s, speed, speed
    xy, yaw = line.poses(places)
    return xy, yaw, paces


def _pace(line: Variant) -> FloatArray:
    """Return (P,) the highest speed along the line's path from which every bend can be reached slow enough."""
    top = np.sqrt(_LATERAL_MPS2) * line.path.bend_mps
    lift = 2.0 * _BEND_BRAKE_MPS2 * SPACING_M * np.arange(len(top))
    reached = np.minimum.accumulate((top**2 + lift)[::-1])[::-1] - lift
    return np.asarray(np.sqrt(np.maximum(reached, 1.0)))


def _straight(
    now: tuple[FloatArray, float, float], speed_mps: FloatArray, dt_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    xy = now[0] + driven_m(speed_mps, now[2], dt_s)[..., None] * unit(np.asarray(now[1]))
    return xy, np.full(speed_mps.shape, now[1]), speed_mps
