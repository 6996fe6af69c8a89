"""How hard a driver brakes or speeds up towards what is ahead, for all combinations at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.planners.lane_graph.lane_graph_options import LaneGraphOptions

_STOP_HEADWAY_S = 0.5


@dataclass(frozen=True)
class Idm:
    """The improved Intelligent Driver Model towards what is ahead, and towards where to stop.

    Attributes:
        accel_mps2: strongest acceleration.
        decel_mps2: comfortable deceleration.
        brake_mps2: strongest deceleration.
        min_gap_m: gap at standstill.
        headway_s: (2, 1) gap in time to what is ahead, and to where to stop.
        closing_mps2: what the square of speeds is divided by.
    """

    accel_mps2: float
    decel_mps2: float
    brake_mps2: float
    min_gap_m: float
    headway_s: FloatArray
    closing_mps2: float

    @staticmethod
    def of(options: LaneGraphOptions) -> Idm:
        """Return the model of *options*."""
        a, b = options.accel_mps2, options.decel_mps2
        headway = np.array([[options.time_headway_s], [_STOP_HEADWAY_S]])
        return Idm(a, b, options.brake_mps2, options.min_gap_m, headway, float(2.0 * np.sqrt(a * b)))

    def accelerations(
        self, speed: FloatArray, wish: FloatArray, gap: FloatArray, lead: FloatArray, alone: BoolArray
    ) -> FloatArray:
        """Return accelerations (2, C).

        Args:
            speed: (C,) own speeds.
            wish: (C,) desired ones.
            gap: (2, C) gaps.
            lead: (2, C) speeds of what is ahead.
            alone: (2, C) where nothing is.
        """
        a = self.accel_mps2
        ratio = speed / wish
        over = 1.0 - np.minimum(1.0 / np.maximum(ratio, 1e-3), 1.0)
        free = np.where(ratio < 1.0, a * (1.0 - ratio**4), -self.decel_mps2 * over * 3.0)
        closing = speed * (speed - lead) / self.closing_mps2
        desired = self.min_gap_m + np.maximum(speed * self.headway_s + closing, 0.0)
        z = desired / np.maximum(gap, 0.1)
        limit = np.maximum(a * (1.0 - np.minimum(z, 10.0) ** 2), -self.brake_mps2)
        follow = np.where(z < 1.0, np.maximum(free, 0.0) * (1.0 - z**4) + np.minimum(free, 0.0), limit)
        return np.where(alone, free, np.minimum(free, follow))
