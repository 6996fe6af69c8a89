"""How a reference driver reacts: a delay that runs once, then braking at each instant that is still unsafe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.metrics.reference.driver_models import DriverModel

_DONE_S = 1e-9


@dataclass(frozen=True)
class Reaction:
    """Where drivers are in their reaction; arrays of one shape (…).

    Attributes:
        delay_left_s: time until they brake; it runs at unsafe instants only and never starts anew.
        braking_mps2: present deceleration.
    """

    delay_left_s: FloatArray
    braking_mps2: FloatArray

    @staticmethod
    def fresh(model: DriverModel, shape: tuple[int, ...] = ()) -> Reaction:
        """Return drivers that nothing has alarmed yet."""
        return Reaction(np.full(shape, model.delay_s), np.zeros(shape))


def react(
    reaction: Reaction, model: DriverModel, demand_mps2: FloatArray, dt_s: float
) -> tuple[Reaction, FloatArray]:
    """Return the reaction one instant on and the acceleration (…,), 0 or less, until then.

    A safe instant holds the speed; braking begins from zero again after it.

    Args:
        reaction: the reaction so far.
        model: who drives.
        demand_mps2: (…,) braking that the situation asks for, 0 where it is safe.
        dt_s: time step.
    """
    unsafe = demand_mps2 > 0.0
    waiting = unsafe & (reaction.delay_left_s > _DONE_S)
    grown = np.minimum(reaction.braking_mps2 + model.jerk_mps3 * dt_s, demand_mps2)
    braking = np.where(waiting, model.coast_mps2, np.where(unsafe, grown, 0.0))
    delay = np.where(waiting, reaction.delay_left_s - dt_s, reaction.delay_left_s)
    return Reaction(delay, braking), -braking
