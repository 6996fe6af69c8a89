"""Reaction of a reference driver: one delay, then braking at each instant that is still unsafe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.metrics.reference.driver_models import DriverModel

#: A delay of at most this is over; the rest is rounding.
_DELAY_TOLERANCE_S = 1e-9


@dataclass(frozen=True)
class Reaction:
    """State of the drivers' reactions; arrays of one shape (…).

    Attributes:
        delay_left_s: time until they brake. It decreases at unsafe instants only and is never reset.
        braking_mps2: present deceleration.
    """

    delay_left_s: FloatArray
    braking_mps2: FloatArray

    @staticmethod
    def fresh(model: DriverModel, shape: tuple[int, ...] = ()) -> Reaction:
        """Return the state of drivers that have not begun to react."""
        return Reaction(np.full(shape, model.delay_s), np.zeros(shape))


def react(
    reaction: Reaction, model: DriverModel, demand_mps2: FloatArray, dt_s: float
) -> tuple[Reaction, FloatArray]:
    """Return the reaction at the next instant and the acceleration (…,), 0 or less, until then.

    At a safe instant the driver holds the speed; braking then begins from zero again.

    Args:
        reaction: the reaction so far.
        model: the driver model.
        demand_mps2: (…,) required deceleration, 0 where the situation is safe.
        dt_s: time step.
    """
    unsafe = demand_mps2 > 0.0
    waiting = unsafe & (reaction.delay_left_s > _DELAY_TOLERANCE_S)
    grown = np.minimum(reaction.braking_mps2 + model.jerk_mps3 * dt_s, demand_mps2)
    braking = np.where(waiting, model.coast_mps2, np.where(unsafe, grown, 0.0))
    delay = np.where(waiting, reaction.delay_left_s - dt_s, reaction.delay_left_s)
    return Reaction(delay, braking), -braking
