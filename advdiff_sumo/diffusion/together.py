"""Makes samples fit together: latents drawn vehicle by vehicle are moved until bodies are apart and on the road.

The paper teaches this to the networks with P_coll (Sec. III-B, joint stage); here the same penalty is lowered by
gradient descent on the finished samples, each held to what was drawn. Vehicles that nothing is wrong with keep their
latents to the bit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.codec import Codec
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.losses import off_road, pair_overlap

_WIDER, _WIDER_M = 1.04, 0.1
_BETAS, _TINY = (0.9, 0.999), 1e-8


@dataclass(frozen=True)
class Together:
    """How samples are made to fit.

    Attributes:
        steps: of Adam.
        rate: of Adam, in deviations of the latents.
        vehicles: weight of the five-disc overlap between vehicles.
        road: weight of the overlap with the road's edge.
        keep: weight of the squared distance from what was drawn.
    """

    steps: int = 60
    rate: float = 0.1
    vehicles: float = 2.0
    road: float = 4.0
    keep: float = 0.1


def penalty(x: Tensor, codec: Codec, context: Context, batch: SceneBatch, how: Together) -> Tensor:
    """Return (B, A) what is wrong with the futures of samples *x*: overlap with others, and with the road's edge.

    Bodies count as a little larger than they are, so that what is 0 here is apart and not just touching.
    """
    rollout = codec.decode(x, context, batch)
    wide = torch.where(batch.present[..., None], _WIDER * batch.size + _WIDER_M, batch.size)
    others = pair_overlap(rollout, wide, batch.present).sum((2, 3))
    road = off_road(rollout, replace(batch, size=wide)).sum(-1)
    return how.vehicles * others + how.road * road


def together(
    drawn: Tensor, codec: Codec, context: Context, batch: SceneBatch, how: Together | None = None
) -> Tensor:
    """Return samples (B, A, C, L) near *drawn* whose futures collide less.

    Args:
        drawn: samples, in the scaled numbers that are diffused.
        codec: between them and futures.
        context: of the scenes.
        batch: the scenes; parked vehicles and those that are not moved keep what was drawn.
        how: weights and steps.
    """
    how = how or Together()
    free = (batch.moved & ~batch.parked).to(drawn.dtype)
    x, first, second = drawn, torch.zeros_like(drawn), torch.zeros_like(drawn)
    for step in range(1, how.steps + 1):
        with torch.enable_grad():
            at = x.detach().requires_grad_(True)
            wrong = (penalty(at, codec, context, batch, how) * free).sum()
            gradient = torch.autograd.grad(wrong, at)[0].nan_to_num()
        gradient = (gradient + 2.0 * how.keep * (x - drawn)) * free[..., None, None]
        first = torch.lerp(gradient, first, _BETAS[0])
        second = torch.lerp(gradient.square(), second, _BETAS[1])
        pace = (second / (1.0 - _BETAS[1] ** step)).sqrt() + _TINY
        x = x - how.rate * first / (1.0 - _BETAS[0] ** step) / pace
    return x
