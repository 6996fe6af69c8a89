"""Speeds up natural plans by shifting latents in the direction in which an isolated vehicle drives faster.

Models that imitate drivers learn that a standing vehicle stays where it is (the inertia problem of Codevilla et al.,
ICCV 2019, arXiv:1904.08980). A queue without a cause would block a road for good. The decoder reacts to other road
users in each half second of its rollout, so vehicles with shifted latents still keep their distance.
"""

from __future__ import annotations

import torch
from torch import Tensor

from advdiff_sumo.core.map_view import MAP_PIECES
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.model_options import (
    FUTURE_STEPS,
    HISTORY_STEPS,
    MODEL_STEP_S,
    PIECE_FEATURES,
    PIECE_POINTS,
)

_BASE_SHIFT = 0.22
"""Shift of every vehicle, in standard deviations of the latents."""
_STANDING_SHIFT, _FADES_MPS = 0.9, 8.0
"""Further shift of a standing vehicle, and the speed at which it has fallen to zero."""
_CAR_MPS, _CAR_M = 8.0, (4.6, 1.9)
"""Speed, length and width of the isolated car."""
_DIFFERENCE = 0.5
"""Step of the finite differences, in standard deviations of the latents."""


def with_pace(x: Tensor, faster: Tensor, speed_mps: Tensor, share: Tensor) -> Tensor:
    """Return scaled latents that are decoded to faster motion.

    Args:
        x: (B, A, C, L) scaled latents.
        faster: (C, L) direction of length 1, or 0 where there is none; see :func:`faster_latent`.
        speed_mps: (B, A) speeds now.
        share: (A,) share of the shift with which traffic is about as fast as SUMO's; 0: no shift.
    """
    shift = share * (_BASE_SHIFT + _STANDING_SHIFT * (1.0 - speed_mps / _FADES_MPS).clamp(min=0.0))
    return x + shift[..., None, None] * faster


@torch.no_grad()
def faster_latent(bundle: Bundle) -> Tensor:
    """Return the direction (C, L) of length 1 in which an isolated car's speed at the end of its plan rises most.

    It comes from finite differences at the mean latent, for a car at 8 m/s without a map. It is 0 if the bundle
    diffuses no latents.
    """
    codec = bundle.codec
    size = codec.shape[0] * codec.shape[1]
    if not isinstance(codec, LatentCodec):
        return torch.zeros(codec.shape)
    batch = _isolated_car(sum(MAP_PIECES[bundle.options.model.map_view])).repeat(size + 1)
    x = torch.cat((torch.zeros(1, size), _DIFFERENCE * torch.eye(size))).reshape(size + 1, 1, *codec.shape)
    speed: Tensor = codec.decode(x, bundle.traffic.encoder(batch), batch).speed[:, 0, -1]
    slope = (speed[1:] - speed[0]).reshape(codec.shape)
    length: Tensor = slope.norm().clamp(min=1e-9)
    return slope / length


def _isolated_car(pieces: int) -> SceneBatch:
    """Return a scene of one car that drives straight on, with *pieces* invalid map pieces."""
    present = torch.ones(1, 1, dtype=torch.bool)
    past = torch.zeros(1, 1, HISTORY_STEPS, 4)
    past[0, 0, :, 0] = _CAR_MPS * MODEL_STEP_S * torch.arange(1 - HISTORY_STEPS, 1)
    past[..., 3] = _CAR_MPS
    return SceneBatch(
        past=past,
        past_valid=present[..., None].expand(1, 1, HISTORY_STEPS),
        size=torch.tensor([[_CAR_M]]),
        classes=torch.full((1, 1), int(AgentClass.CAR)),
        present=present,
        moved=present,
        parked=~present,
        map_xy=torch.zeros(1, 1, pieces, PIECE_POINTS, 2),
        map_features=torch.zeros(1, 1, pieces, PIECE_FEATURES),
        map_valid=torch.zeros(1, 1, pieces, dtype=torch.bool),
        future=torch.zeros(1, 1, FUTURE_STEPS, 4),
        future_valid=torch.zeros(1, 1, FUTURE_STEPS, dtype=torch.bool),
    )
