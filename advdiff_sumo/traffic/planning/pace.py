"""How briskly natural plans are driven: latents are shifted along the way on which a vehicle alone drives faster.

Who imitates drivers takes standing for a reason to stand (the inertia problem of Codevilla et al., ICCV 2019,
arXiv:1904.08980): one queue without a cause at its head blocks a road for good. The decoder looks at everybody again
each half second of its rollout, so that a shifted latent still keeps its distance.
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

_CRUISES, _STANDS, _FADES_MPS = 0.22, 0.9, 8.0
"""Standard deviations for who drives fast, those in addition for who stands, and the speed at which these are gone."""
_ALONE_MPS, _CAR_M, _STEP = 8.0, (4.6, 1.9), 0.5


def with_pace(x: Tensor, faster: Tensor, speed_mps: Tensor, share: Tensor) -> Tensor:
    """Return scaled latents that are driven more briskly.

    Args:
        x: (B, A, C, L) scaled latents.
        faster: (C, L) direction, of length 1 (or 0, where there is none), see :func:`faster_latent`.
        speed_mps: (B, A) speeds now.
        share: (A,) of the shift with which traffic is about as fast as SUMO's drivers; 0 leaves a vehicle as it is.
    """
    shift = share * (_CRUISES + _STANDS * (1.0 - speed_mps / _FADES_MPS).clamp(min=0.0))
    return x + shift[..., None, None] * faster


@torch.no_grad()
def faster_latent(bundle: Bundle) -> Tensor:
    """Return the direction (C, L), of length 1, in which a vehicle alone gets fastest at the end of its plan.

    By differences at the mean latent, for a car at 8 m/s without a map; 0 where no latents are diffused.
    """
    codec = bundle.codec
    size = codec.shape[0] * codec.shape[1]
    if not isinstance(codec, LatentCodec):
        return torch.zeros(codec.shape)
    batch = _alone(sum(MAP_PIECES[bundle.options.model.map_view])).repeat(size + 1)
    x = torch.cat((torch.zeros(1, size), _STEP * torch.eye(size))).reshape(size + 1, 1, *codec.shape)
    speed: Tensor = codec.decode(x, bundle.traffic.encoder(batch), batch).speed[:, 0, -1]
    slope = (speed[1:] - speed[0]).reshape(codec.shape)
    length: Tensor = slope.norm().clamp(min=1e-9)
    return slope / length


def _alone(pieces: int) -> SceneBatch:
    """Return the scene of one car that drives straight on, where there is nothing else."""
    one = torch.ones(1, 1, dtype=torch.bool)
    past = torch.zeros(1, 1, HISTORY_STEPS, 4)
    past[0, 0, :, 0] = _ALONE_MPS * MODEL_STEP_S * torch.arange(1 - HISTORY_STEPS, 1)
    past[..., 3] = _ALONE_MPS
    return SceneBatch(
        past=past,
        past_valid=one[..., None].expand(1, 1, HISTORY_STEPS),
        size=torch.tensor([[_CAR_M]]),
        classes=torch.full((1, 1), int(AgentClass.CAR)),
        present=one,
        moved=one,
        parked=~one,
        map_xy=torch.zeros(1, 1, pieces, PIECE_POINTS, 2),
        map_features=torch.zeros(1, 1, pieces, PIECE_FEATURES),
        map_valid=torch.zeros(1, 1, pieces, dtype=torch.bool),
        future=torch.zeros(1, 1, FUTURE_STEPS, 4),
        future_valid=torch.zeros(1, 1, FUTURE_STEPS, dtype=torch.bool),
    )
