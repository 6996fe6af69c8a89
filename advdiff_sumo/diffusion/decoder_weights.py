"""The decoder's weights in the order in which the run-time form multiplies by them, and how edges are embedded."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from advdiff_sumo.models.decoder import Decoder
from advdiff_sumo.models.geometry import RELATIVE_FEATURES

NEAR = 2
"""Column of ``relative_features``: compressed distance."""
PLANES = ((0, 1), (3, 4), (5, 6))
"""Columns that are vectors in the receiver's frame: place, heading, velocity."""
AHEAD_SPEED, OWN_SPEED = 7, 8
PLACE_SCALE, SPEED_SCALE = 0.05, 0.1


@dataclass(frozen=True)
class EdgeTerms:
    """The edge encoder's first layer by what it multiplies, and its second; all but one column are products.

    Attributes:
        planes: (3, 2, E) of the vectors in the receiver's frame, scaled: place, heading, velocity.
        near: (E,) of the compressed distance.
        own: (E,) of the receiver's speed, scaled.
        bias: (E,) of the first layer.
        second: the second layer.
    """

    planes: Tensor
    near: Tensor
    own: Tensor
    bias: Tensor
    second: nn.Linear


def edge_terms(decoder: Decoder) -> EdgeTerms:
    """Return the terms of *decoder*'s edge encoder."""
    first, second = decoder.interaction.edges.net[0], decoder.interaction.edges.net[2]
    assert isinstance(first, nn.Linear)  # noqa: S101 - tells the type checker what stands there
    assert isinstance(second, nn.Linear)  # noqa: S101 - the same
    weight = first.weight.detach().t().clone()  # (9, E)
    assert len(weight) == RELATIVE_FEATURES  # noqa: S101 - the columns named above are those
    own = weight[OWN_SPEED] - weight[AHEAD_SPEED]
    weight[PLANES[2][0]] += weight[AHEAD_SPEED]
    scales = (PLACE_SCALE, 1.0, SPEED_SCALE)
    planes = [scale * weight[list(pair)] for scale, pair in zip(scales, PLANES, strict=True)]
    return EdgeTerms(torch.stack(planes), weight[NEAR], SPEED_SCALE * own, first.bias.detach(), second)
