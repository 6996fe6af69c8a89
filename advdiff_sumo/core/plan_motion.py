"""Check whether a vehicle can drive from state to state of a plan."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.bicycle import Limits

SLACK_M, SLACK_MPS = 0.1, 0.1
"""Tolerances of the distance per step and of the change of speed per step."""
_MAX_YAW_RATE_RADPS = 3.0
_SHORT_SHARE = 0.1
"""Share by which the distance of a step may be less than its lower speed requires: a chord is shorter than its arc."""


def motion_faults(
    xy_m: FloatArray, yaw_rad: FloatArray, speed_mps: FloatArray, dt_s: float, first: int = 0
) -> list[str]:
    """Return the motions that no vehicle can do, as "step N moves farther than its speeds allow"; [] if none.

    Args:
        xy_m: (T + 1, 2) box centres, the first one now.
        yaw_rad: (T + 1,) headings.
        speed_mps: (T + 1,) speeds.
        dt_s: spacing of the states.
        first: number of the second state in the plan.
    """
    limits = Limits()
    yaw, speed = np.unwrap(yaw_rad), speed_mps
    move, chord_yaw = np.diff(xy_m, axis=0), (yaw[1:] + yaw[:-1]) / 2.0
    forward = move[:, 0] * np.cos(chord_yaw) + move[:, 1] * np.sin(chord_yaw)
    farthest = np.maximum(np.abs(speed[1:]), np.abs(speed[:-1])) * dt_s + SLACK_M
    at_lower_speed = np.minimum(speed[1:], speed[:-1]) * dt_s
    least = at_lower_speed - _SHORT_SHARE * np.abs(at_lower_speed) - SLACK_M
    distance, is_behind = np.hypot(*move.T), forward < least
    accel = np.diff(speed) / dt_s
    slack = SLACK_MPS / dt_s
    faults = [
        (distance > farthest, "moves farther than its speeds allow"),
        (
            is_behind & (distance < least),
            "moves less far than its speeds say (box centres, from now + dt on)",
        ),
        (is_behind & (distance >= least), "moves in another direction than it heads (yaw in radians)"),
        (accel > limits.accel_mps2 + slack, f"accelerates by more than {limits.accel_mps2:g} m/s²"),
        (accel < -limits.brake_mps2 - slack, f"brakes by more than {limits.brake_mps2:g} m/s²"),
        (
            np.abs(np.diff(yaw)) > _MAX_YAW_RATE_RADPS * dt_s,
            f"turns faster than {_MAX_YAW_RATE_RADPS:g} rad/s",
        ),
    ]
    return [f"step {first + int(np.argmax(is_fault))} {text}" for is_fault, text in faults if is_fault.any()]
