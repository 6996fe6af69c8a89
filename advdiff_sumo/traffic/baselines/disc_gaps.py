"""How far bodies of discs are apart, or inside each other; values without gradients, for a search that takes none."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.models.losses import DISCS, discs

_MIDDLE = DISCS // 2
_ROUNDING_M = 0.1
"""Bodies whose middles are farther apart than their half lengths by this do not touch, however distances round."""


@dataclass(frozen=True)
class Bodies:
    """Boxes as discs along their length, (…,) of them.

    Attributes:
        centres: (…, 5, 2) of the discs in metres, from rear to front.
        radius: (…,) of each body's discs in metres.
    """

    centres: Tensor
    radius: Tensor

    @staticmethod
    def of(xy: Tensor, yaw: Tensor, size: Tensor) -> Bodies:
        """Return the bodies of boxes at *xy* (…, 2) along *yaw* (…,), of *size* (…, 2) each."""
        return Bodies(*discs(xy, yaw, size.expand(*yaw.shape, 2)))

    def at(self, *index: slice | Tensor | None) -> Bodies:
        """Return the bodies at *index*, which does not reach their discs."""
        return Bodies(self.centres[index], self.radius[index])

    def spread(self, shape: torch.Size) -> Bodies:
        """Return the bodies broadcast to *shape*."""
        return Bodies(self.centres.expand(*shape, *self.centres.shape[-2:]), self.radius.expand(shape))

    def halves(self) -> Tensor:
        """Return (…,) how far the bodies reach from their middles, in metres."""
        half: Tensor = (self.centres[..., -1, :] - self.centres[..., _MIDDLE, :]).norm(dim=-1)
        return half + self.radius


def gaps(mine: Bodies, yours: Bodies) -> Tensor:
    """Return the distances (…,) of bodies in metres, less than 0 inside; shapes are broadcast."""
    return torch.sqrt(_nearest(mine.centres, yours.centres) + 1e-9) - mine.radius - yours.radius


def depths(mine: Bodies, yours: Bodies) -> Tensor:
    """Return (…,) how far bodies are inside each other in metres, 0 outside: :func:`gaps` where any could touch."""
    apart = _squared(mine.centres[..., _MIDDLE, :], yours.centres[..., _MIDDLE, :])
    far = apart > (mine.halves() + yours.halves() + _ROUNDING_M).square_()
    near = far.logical_not_().nonzero(as_tuple=True)  # who is nowhere is near
    depth = torch.zeros_like(apart)
    if len(near[0]):
        first, second = (body.spread(apart.shape).at(*near) for body in (mine, yours))
        depth[near] = (-gaps(first, second)).clamp_(min=0.0)
    return depth


def _nearest(mine: Tensor, yours: Tensor) -> Tensor:
    """Return the least squared distance (…,) of discs (…, 5, 2)."""
    x, y = (_of_pairs(mine[..., axis], yours[..., axis]) for axis in (0, 1))
    return x.square_().add_(y.square_()).flatten(0, 1).amin(0)


def _of_pairs(mine: Tensor, yours: Tensor) -> Tensor:
    """Return the differences (5, 5, …) of all pairs of a coordinate (…, 5) of discs."""
    first, second = (body.movedim(-1, 0).contiguous() for body in (mine, yours))
    more = mine.dim() - yours.dim()
    first = first.reshape(DISCS, 1, *[1] * max(-more, 0), *first.shape[1:])
    return first - second.reshape(1, DISCS, *[1] * max(more, 0), *second.shape[1:])


def _squared(first: Tensor, second: Tensor) -> Tensor:
    x, y = first[..., 0] - second[..., 0], first[..., 1] - second[..., 1]
    return x.square_().add_(y.square_())
