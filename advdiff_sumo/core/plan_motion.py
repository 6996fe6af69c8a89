"""Whether a vehicle can drive from state to state as a plan says."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.bicycle import Limits

SLACK_M, SLACK_MPS = 0.1, 0.1
_MAX_YAW_RATE_RADPS = 3.0
_SHORT_SHARE = 0.1
"""By how much the way of a step may fall short of its lower speed: a chord is shorter than its arc."""


def motion_faults(
    xy_m: FloatArray, yaw_rad: FloatArray, speed_mps: FloatArray, dt_s: float, first: int = 0
) -> list[str]:
    """Return what of these states no vehicle can do, as "step N moves farther than its speeds allow"; [] for nothing.

    Args:
        xy_m: (T + 1, 2) box centres, the first one now.
        yaw_rad: (T + 1,) headings.
        speed_mps: (T + 1,) speeds.
        dt_s: spacing.
        first: number of the second state in the plan.
    """
    limits = Limits()
    yaw, speed = np.unwrap(yaw_rad), speed_mps
    stride, chord_rad = np.diff(xy_m, axis=0), (yaw[1:] + yaw[:-1]) / 2.0
    forward = stride[:, 0] * np.cos(chord_rad) + stride[:, 1] * np.sin(chord_rad)
    farthest = np.maximum(np.abs(speed[1:]), np.abs(speed[:-1])) * dt_s + SLACK_M
    least = np.minimum(speed[1:], speed[:-1]) * dt_s
    short = least - _SHORT_SHARE * np.abs(least) - SLACK_M
    gain = np.diff(speed) / dt_s
    slack = SLACK_MPS / dt_s
    faults = [
        (np.hypot(*stride.T) > farthest, "moves farther than its speeds allow"),
        (forward < short, "moves less far than its speeds say (box centres, from now + dt on)"),
        (gain > limits.accel_mps2 + slack, f"accelerates by more than {limits.accel_mps2:g} m/s²"),
        (gain < -limits.brake_mps2 - slack, f"brakes by more than {limits.brake_mps2:g} m/s²"),
        (
            np.abs(np.diff(yaw)) > _MAX_YAW_RATE_RADPS * dt_s,
            f"turns faster than {_MAX_YAW_RATE_RADPS:g} rad/s",
        ),
    ]
    return [f"step {first + int(np.argmax(bad))} {words}" for bad, words in faults if bad.any()]
