"""What attackers' bodies meet: by ``compiled`` on the CPU, elsewhere by ``tensor_bodies``."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from advdiff_sumo.diffusion.tensor_bodies import Met, Placed, TensorBodies
from advdiff_sumo.models.decoder import Rollout

Bodies: TypeAlias = Callable[[Rollout], Met]
"""Attackers' futures (B, R, T) → what they meet."""


def bodies_of(placed: Placed, compiled: bool | None = None) -> Bodies:
    """Return what attackers meet; by compiled loops if told so, or, with None, where tensors are on the CPU."""
    here = placed.rows.device.type == "cpu" if compiled is None else compiled
    if not here:
        return TensorBodies(placed)
    from advdiff_sumo.diffusion.compiled.body_kernel import CompiledBodies

    return CompiledBodies(placed)
