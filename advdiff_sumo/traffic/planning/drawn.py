"""What a policy's networks, or its search, come to: a joint future, and what led to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from torch import Tensor

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.models.decoder import Rollout


@dataclass(frozen=True)
class Drawn:
    """A drawn plan.

    Attributes:
        rollout: joint future of the view's agents, a batch of one.
        noise: id → starting noise that led to it.
        attackers: ids that were guided.
        shifts: id → what an attacker's latent was shifted by in the last step, (Z,).
        latents: (A, Z) what the decoder was given, scaled.
    """

    rollout: Rollout
    noise: Mapping[str, FloatArray]
    attackers: tuple[str, ...]
    latents: Tensor
    shifts: Mapping[str, FloatArray] = field(default_factory=dict)
