"""Comfort of the target's ride: accelerations, jerk and yaw rate, computed from the recorded states.

Derivatives are those of a least-squares polynomial over ``WINDOW_S`` around each instant (Savitzky and
Golay 1964, doi:10.1021/ac60214a047): second degree for acceleration and yaw rate, third for jerk, which is the
second derivative of speed. SUMO turns a vehicle on the spot by some degrees where a lane bends or a lane change
begins. The window smooths such a step; its difference quotient would be tens of m/s² of lateral acceleration. An
instantaneous lane change of SUMO divides the record into stretches that are evaluated separately.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, stretches
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.metrics.kinematics import snaps, unbroken_steps

#: Time over which a polynomial is fitted; at least ``_LEAST_WINDOW`` instants.
WINDOW_S = 1.0
_LEAST_WINDOW = 5


@dataclass(frozen=True)
class Comfort:
    """Mean and greatest absolute values over the instants; None if the record is too short.

    Attributes:
        accel_mean_mps2: longitudinal acceleration.
        accel_max_mps2: longitudinal acceleration.
        brake_max_mps2: strongest braking, positive.
        lateral_mean_mps2: speed times yaw rate.
        lateral_max_mps2: speed times yaw rate.
        jerk_mean_mps3: longitudinal jerk.
        jerk_max_mps3: longitudinal jerk.
        yaw_rate_mean_radps: yaw rate.
        yaw_rate_max_radps: yaw rate.
    """

    accel_mean_mps2: float | None = None
    accel_max_mps2: float | None = None
    brake_max_mps2: float | None = None
    lateral_mean_mps2: float | None = None
    lateral_max_mps2: float | None = None
    jerk_mean_mps3: float | None = None
    jerk_max_mps3: float | None = None
    yaw_rate_mean_radps: float | None = None
    yaw_rate_max_radps: float | None = None


def comfort(tracks: Tracks, row: int) -> Comfort:
    """Return the comfort of agent *row* over all of *tracks*, which should end before a collision.

    Stretches of fewer than five instants are left out.
    """
    parts = [derivatives(tracks, row, part) for part in _stretches(tracks, row)]
    if not parts:
        return Comfort()
    accel, jerk, yaw_rate, lateral = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Comfort(
        *_abs_mean_max(accel),
        max(0.0, float(-accel.min())),
        *_abs_mean_max(lateral),
        *_abs_mean_max(jerk),
        *_abs_mean_max(yaw_rate),
    )


def derivatives(
    tracks: Tracks, row: int, part: slice
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return acceleration (m/s²), jerk (m/s³), yaw rate (rad/s) and lateral acceleration (m/s²) of agent *row*.

    Args:
        tracks: T instants.
        row: row of the agent.
        part: a stretch of five or more instants without a break; each result has its length.
    """
    from scipy.signal import savgol_filter  # late: a second to import

    speed = tracks.speed_mps[row, part]
    yaw = np.unwrap(tracks.yaw_rad[row, part])
    full_window = max(_LEAST_WINDOW, 2 * round(0.5 * WINDOW_S / tracks.dt_s) + 1)
    window = min(full_window, len(speed) - 1 + len(speed) % 2)
    accel = savgol_filter(speed, window, 2, deriv=1, delta=tracks.dt_s)
    jerk = savgol_filter(speed, window, 3, deriv=2, delta=tracks.dt_s)
    yaw_rate = savgol_filter(yaw, window, 2, deriv=1, delta=tracks.dt_s)
    return accel, jerk, yaw_rate, yaw_rate * speed


def _stretches(tracks: Tracks, row: int) -> list[slice]:
    """Return the stretches of instants without a break or an instantaneous lane change."""
    own = tracks.rows([row])
    usable = unbroken_steps(own)[0] & ~snaps(own)[0]
    return [slice(a, b + 1) for a, b in stretches(usable) if b + 1 - a >= _LEAST_WINDOW]


def _abs_mean_max(values: FloatArray) -> tuple[float, float]:
    magnitude = np.abs(values)
    return float(magnitude.mean()), float(magnitude.max())
