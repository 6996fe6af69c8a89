"""Distances and overlaps of vehicles that are approximated by discs; without gradients."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.models.losses import DISCS, discs

_MIDDLE = DISCS // 2
_ROUNDING_M = 0.1
"""Bodies whose half lengths leave a gap of more than this do not touch, whatever the rounding."""


@dataclass(frozen=True)
class Bodies:
    """Boxes (…,), each approximated by discs along its length.

    Attributes:
        centres: (…, 5, 2) centres of the discs in metres, from rear to front.
        radius: (…,) radius of each body's discs in metres.
    """

    centres: Tensor
    radius: Tensor

    @staticmethod
    def of(xy: Tensor, yaw: Tensor, size: Tensor) -> Bodies:
        """Return the bodies of boxes with centres *xy* (…, 2), headings *yaw* (…,) and *size* (…, 2)."""
        return Bodies(*discs(xy, yaw, size.expand(*yaw.shape, 2)))

    def at(self, *index: slice | Tensor | None) -> Bodies:
        """Return the bodies at *index*; it does not index their discs."""
        return Bodies(self.centres[index], self.radius[index])

    def spread(self, shape: torch.Size) -> Bodies:
        """Return the bodies broadcast to *shape*."""
        return Bodies(self.centres.expand(*shape, *self.centres.shape[-2:]), self.radius.expand(shape))

    def half_lengths(self) -> Tensor:
        """Return (…,) half the lengths of the bodies in metres."""
        half: Tensor = (self.centres[..., -1, :] - self.centres[..., _MIDDLE, :]).norm(dim=-1)
        return half + self.radius


def gaps(first: Bodies, second: Bodies) -> Tensor:
    """Return the distances (…,) of bodies in metres, negative if they overlap; shapes are broadcast."""
    return torch.sqrt(_nearest(first.centres, second.centres) + 1e-9) - first.radius - second.radius


def depths(first: Bodies, second: Bodies) -> Tensor:
    """Return the overlaps (…,) of bodies in metres, 0 if they are apart; shapes are broadcast.

    Only pairs that are near enough to touch are compared disc by disc.
    """
    squared = _squared_distance(first.centres[..., _MIDDLE, :], second.centres[..., _MIDDLE, :])
    far = squared > (first.half_lengths() + second.half_lengths() + _ROUNDING_M).square_()
    near = far.logical_not_().nonzero(as_tuple=True)  # bodies at NaN count as near
    depth = torch.zeros_like(squared)
    if len(near[0]):
        near_first, near_second = (body.spread(squared.shape).at(*near) for body in (first, second))
        depth[near] = (-gaps(near_first, near_second)).clamp_(min=0.0)
    return depth


def _nearest(first: Tensor, second: Tensor) -> Tensor:
    """Return the smallest squared distance (…,) between disc centres (…, 5, 2)."""
    x, y = (_pair_differences(first[..., axis], second[..., axis]) for axis in (0, 1))
    return x.square_().add_(y.square_()).flatten(0, 1).amin(0)


def _pair_differences(first: Tensor, second: Tensor) -> Tensor:
    """Return the differences (5, 5, …) between all pairs of discs in one coordinate (…, 5)."""
    extra = first.dim() - second.dim()
    first, second = (values.movedim(-1, 0).contiguous() for values in (first, second))
    first = first.reshape(DISCS, 1, *[1] * max(-extra, 0), *first.shape[1:])
    return first - second.reshape(1, DISCS, *[1] * max(extra, 0), *second.shape[1:])


def _squared_distance(first: Tensor, second: Tensor) -> Tensor:
    x, y = first[..., 0] - second[..., 0], first[..., 1] - second[..., 1]
    return x.square_().add_(y.square_())
