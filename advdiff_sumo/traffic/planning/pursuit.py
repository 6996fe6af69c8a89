"""Pure pursuit of lanes through the bicycle model of ``core.bicycle``, in compiled loops."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.diffusion.compiled.kernel import kernel

_LOOK_AHEAD_S, _MIN_LOOK_AHEAD_M = 0.8, 4.0
_ACCEL_MPS2, _BRAKE_MPS2, _LATERAL_MPS2 = 1.5, 2.5, 2.0
_EVERY_M, _REACH_M = 0.5, 160.0


class Lines(NamedTuple):
    """Centre lines of V vehicles' lanes, one after the other; F segments in all.

    Attributes:
        xy_m: (F, 2) beginnings of the segments.
        tangent: (F, 2) unit vectors along them.
        yaw_rad: (F,) headings.
        s_m: (F,) arc lengths where they begin.
        first: (V,) segment that each line begins with.
        last: (V,) and ends with.
        begin_m: (V,) arc length of each vehicle.
        limit_mps: (V,) speed limit.
    """

    xy_m: FloatArray
    tangent: FloatArray
    yaw_rad: FloatArray
    s_m: FloatArray
    first: IntArray
    last: IntArray
    begin_m: FloatArray
    limit_mps: FloatArray


@kernel
def wrapped(angle: float) -> float:
    """Return *angle* in (−π, π]."""
    return -((math.pi - angle) % (2.0 * math.pi) - math.pi)


@kernel
def snapped(s_m: float) -> float:
    """Return *s_m* on a grid, within reach."""
    return _EVERY_M * min(float(np.rint(s_m / _EVERY_M)), _REACH_M / _EVERY_M - 1.0)


@kernel
def segment(lines: Lines, row: int, s_m: float, at: int) -> int:
    """Return the segment of line *row* at arc length *s_m*, looked for from *at* on; the end ones go on."""
    while at < lines.last[row] and lines.s_m[at + 1] <= s_m:
        at += 1
    while at > lines.first[row] and lines.s_m[at] > s_m:
        at -= 1
    return at


@kernel
def aim(lines: Lines, row: int, s_m: float, state: FloatArray, at: int) -> tuple[float, float, int]:
    """Return acceleration and curvature towards the lane's centre at its limit, and the segment aimed at.

    Args:
        lines: of all vehicles.
        row: which vehicle.
        s_m: how far it has driven.
        state: (4,) x, y, yaw, speed.
        at: segment to look from.
    """
    begin = lines.begin_m[row]
    look = max(_MIN_LOOK_AHEAD_M, _LOOK_AHEAD_S * state[3])
    ahead = begin + snapped(s_m + look)
    at = segment(lines, row, ahead, at)
    x = lines.xy_m[at, 0] + (ahead - lines.s_m[at]) * lines.tangent[at, 0] - state[0]
    y = lines.xy_m[at, 1] + (ahead - lines.s_m[at]) * lines.tangent[at, 1] - state[1]
    angle = wrapped(math.atan2(y, x) - state[2])
    bend = 2.0 * math.sin(angle) / max(math.hypot(x, y), 1.0)
    far = segment(lines, row, begin + snapped(s_m + 2.0 * look), at)
    turn = abs(wrapped(lines.yaw_rad[far] - state[2])) / (2.0 * look)
    wanted = min(lines.limit_mps[row], math.sqrt(_LATERAL_MPS2 / max(turn, 1e-3)))
    return min(max(wanted - state[3], -_BRAKE_MPS2), _ACCEL_MPS2), bend, at


@kernel
def move(state: FloatArray, accel: float, curvature: float, dt_s: float) -> None:
    """Move *state* (4,) on by *dt_s*, as ``core.bicycle.step``."""
    stop = state[3] / max(-accel, 1e-9) if accel < 0.0 else math.inf
    moving = min(max(stop, 0.0), dt_s)
    travelled = state[3] * moving + 0.5 * accel * moving**2
    half = 0.5 * curvature * travelled
    chord = travelled * (math.sin(half) / half if half != 0.0 else 1.0)
    state[0] += chord * math.cos(state[2] + half)
    state[1] += chord * math.sin(state[2] + half)
    state[2] = wrapped(state[2] + 2.0 * half)
    state[3] = 0.0 if stop <= dt_s else state[3] + accel * dt_s


@kernel
def pursue(
    lines: Lines,
    states: FloatArray,
    bends: FloatArray,
    lateral_mps2: float,
    small_s: float,
    driven: FloatArray,
) -> None:
    """Set *driven* (V, T, K, 4) to the states after K small steps for each of T instants.

    Args:
        lines: of the vehicles.
        states: (V, 4) x, y, yaw, speed; overwritten.
        bends: (V,) largest curvatures by steering.
        lateral_mps2: largest lateral acceleration.
        small_s: duration of a small step.
        driven: to be written.
    """
    _, instants, small_steps, _ = driven.shape
    for row in range(len(states)):
        state, s, at = states[row], 0.0, lines.first[row]
        for t in range(instants):
            for k in range(small_steps):
                accel, bend, at = aim(lines, row, s, state, at)
                bound = min(bends[row], lateral_mps2 / max(state[3], 0.1) ** 2)
                s += state[3] * small_s
                move(state, accel, min(max(bend, -bound), bound), small_s)
                driven[row, t, k] = state
