"""Speed over time: a first acceleration, then another one, between a lowest and a highest speed."""

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
"""Steps of the integration in one of those."""


@dataclass(frozen=True)
class SpeedProfile:
    """How a vehicle changes its speed.

    Attributes:
        first_mps2: acceleration up to ``switch_s``.
        switch_s: when the second one begins.
        then_mps2: acceleration from then on.
        lowest_mps: speed that braking ends at.
        highest_mps: speed that accelerating ends at.
    """

    first_mps2: float = 0.0
    switch_s: float = 0.0
    then_mps2: float = 0.0
    lowest_mps: float = 0.0
    highest_mps: float = np.inf

    @staticmethod
    def table(profiles: list[SpeedProfile]) -> FloatArray:
        """Return (P, 5) the attributes of *profiles*, in their order."""
        return np.array(
            [(p.first_mps2, p.switch_s, p.then_mps2, p.lowest_mps, p.highest_mps) for p in profiles]
        ).reshape(len(profiles), 5)


def drive_profiles(speed_mps: FloatArray, profiles: list[SpeedProfile]) -> tuple[FloatArray, FloatArray]:
    """Return distances driven (P, 24) and speeds (P, 24) at ``CHECK_TIMES_S``.

    Args:
        speed_mps: (P,) speeds now.
        profiles: P profiles. A speed beyond a bound now stays as it is until the profile takes it back.
    """
    first, switch, then, lowest, highest = SpeedProfile.table(profiles).T
    small = CHECK_DT_S / FINE_STEPS
    time = small * (np.arange(FINE_STEPS * len(CHECK_TIMES_S)) + 0.5)
    gain = small * np.where(time[:, None] < switch, first, then)
    speed = np.empty((len(time) + 1, len(profiles)))
    speed[0] = speed_mps
    for k, now in enumerate(speed[:-1]):
        slowest = np.maximum(np.minimum(lowest, now), 0.0)
        speed[k + 1] = np.minimum(np.maximum(now + gain[k], slowest), np.maximum(highest, now))
    speed = np.ascontiguousarray(speed.T)
    driven = np.cumsum(0.5 * small * (speed[:, 1:] + speed[:, :-1]), axis=1)
    at = slice(FINE_STEPS - 1, None, FINE_STEPS)
    return driven[:, at], speed[:, 1:][:, at]
