"""Speed over time: a first acceleration, then a second one, between a lowest and a highest speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.models.model_options import FUTURE_STEPS, MODEL_STEP_S

PLAN_STEPS, PLAN_DT_S = FUTURE_STEPS, MODEL_STEP_S
"""A plan is as long as the futures of the networks."""
CHECK_DT_S = 0.25
"""Spacing at which boxes are compared."""
CHECK_TIMES_S: FloatArray = np.arange(1.0, round(PLAN_STEPS * PLAN_DT_S / CHECK_DT_S) + 1.0) * CHECK_DT_S
"""(24,) instants of a plan at which boxes are compared."""
FINE_STEPS = 5
"""Integration steps per ``CHECK_DT_S``."""
ADAPTS_S = 0.8
"""Time within which a vehicle adapts its speed."""


@dataclass(frozen=True)
class SpeedProfile:
    """How a vehicle changes its speed.

    Attributes:
        first_mps2: acceleration up to ``switch_s``.
        switch_s: when the second one begins.
        then_mps2: acceleration from then on.
        lowest_mps: speed at which braking ends.
        highest_mps: speed at which accelerating ends.
    """

    first_mps2: float = 0.0
    switch_s: float = 0.0
    then_mps2: float = 0.0
    lowest_mps: float = 0.0
    highest_mps: float = np.inf

    @staticmethod
    def adapting(
        wish_mps: float,
        now_mps: float,
        braking_mps2: float,
        accel_mps2: float,
        lowest_mps: float,
        highest_mps: float,
    ) -> SpeedProfile:
        """Return how a vehicle at *now_mps* gets to *wish_mps* within ``ADAPTS_S``, if these bounds allow it."""
        accel = float(np.clip((wish_mps - now_mps) / ADAPTS_S, -braking_mps2, accel_mps2))
        return SpeedProfile(accel, ADAPTS_S, 0.0, lowest_mps, highest_mps)

    @staticmethod
    def table(profiles: list[SpeedProfile]) -> FloatArray:
        """Return (P, 5) attributes of *profiles*, in the order of their definition."""
        return np.array(
            [(p.first_mps2, p.switch_s, p.then_mps2, p.lowest_mps, p.highest_mps) for p in profiles]
        ).reshape(len(profiles), 5)


def drive_profiles(speed_mps: FloatArray, profiles: list[SpeedProfile]) -> tuple[FloatArray, FloatArray]:
    """Return distances driven (P, 24) and speeds (P, 24) at ``CHECK_TIMES_S``.

    Args:
        speed_mps: (P,) speeds now.
        profiles: P profiles. A present speed beyond a bound is kept until the profile brings it back.
    """
    first, switch, then, lowest, highest = SpeedProfile.table(profiles).T
    step_s = CHECK_DT_S / FINE_STEPS
    time = step_s * (np.arange(FINE_STEPS * len(CHECK_TIMES_S)) + 0.5)
    gain = step_s * np.where(time[:, None] < switch, first, then)
    speed = np.empty((len(time) + 1, len(profiles)))
    speed[0] = speed_mps
    for k, before in enumerate(speed[:-1]):
        slowest = np.maximum(np.minimum(lowest, before), 0.0)
        speed[k + 1] = np.minimum(np.maximum(before + gain[k], slowest), np.maximum(highest, before))
    speed = np.ascontiguousarray(speed.T)
    driven = np.cumsum(0.5 * step_s * (speed[:, 1:] + speed[:, :-1]), axis=1)
    at_checks = slice(FINE_STEPS - 1, None, FINE_STEPS)
    return driven[:, at_checks], speed[:, 1:][:, at_checks]
