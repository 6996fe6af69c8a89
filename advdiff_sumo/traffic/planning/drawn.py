"""The proposal of a policy's networks or search: a joint future and how it came about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from torch import Tensor

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.models.decoder import Rollout


@dataclass(frozen=True)
class Drawn:
    """A proposed plan.

    Attributes:
        rollout: joint future of the A agents of the view, a batch of one.
        noise: id → starting noise.
        attackers: ids of the guided vehicles.
        latents: (A, Z) scaled latents that were decoded.
        shifts: id → shift (Z,) of an attacker's latent in the last step.
    """

    rollout: Rollout
    noise: Mapping[str, FloatArray]
    attackers: tuple[str, ...]
    latents: Tensor
    shifts: Mapping[str, FloatArray] = field(default_factory=dict)
