"""Paths of plans, along which vehicles drive at other speeds than planned."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.traffic.planning.futures import Futures


class PlannedPaths:
    """Planned paths of N road users, unchanged while their speeds change."""

    def __init__(self, futures: Futures) -> None:
        self.xy_m, self.yaw_rad = futures.xy_m, futures.yaw_rad
        self.s_m = futures.travelled_m()

    def at(self, row: int, s_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return points (…, 2) and headings (…,) at arc lengths *s_m* (…,) of a path, clamped to its ends."""
        s = self.s_m[row]
        piece = np.clip(np.searchsorted(s, s_m, side="right") - 1, 0, len(s) - 2)
        share = np.clip((s_m - s[piece]) / np.maximum(s[piece + 1] - s[piece], 1e-9), 0.0, 1.0)
        xy, yaw = self.xy_m[row], self.yaw_rad[row]
        heading = yaw[piece] + share * wrap_angle(yaw[piece + 1] - yaw[piece])
        return xy[piece] + share[..., None] * (xy[piece + 1] - xy[piece]), heading


def drive_along(futures: Futures, paths: PlannedPaths, row: int, driven_m: FloatArray) -> None:
    """Put *row* of *futures* at the distances *driven_m* (T,) along its path, with the speeds of these."""
    xy, yaw = paths.at(row, driven_m)
    futures.put(row, xy, yaw, speeds_of_strides(np.diff(driven_m, prepend=0.0), futures.dt_s))


def speeds_of_strides(stride_m: FloatArray, dt_s: float) -> FloatArray:
    """Return speeds (T,) at the instants of a plan from the distances *stride_m* (T,) driven in its steps."""
    mean = stride_m / dt_s
    last = max(0.0, 1.5 * mean[-1] - 0.5 * mean[-2]) if len(mean) > 1 else mean[-1]
    speed = np.append(0.5 * (mean[:-1] + mean[1:]), last)
    return np.where(stride_m > 1e-6, speed, 0.0)
