"""Features of proximity: gaps to neighbours now and extrapolated, headway, and clearance to the road edge."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import torch
from torch import Tensor

from advdiff_sumo.models.geometry import rotate
from advdiff_sumo.models.losses import DISCS
from advdiff_sumo.models.neighbours import Neighbours
from advdiff_sumo.models.road_edges import RoadEdges

EXTRAPOLATION_S = (0.0, 0.5, 1.0, 1.5, 2.5)
"""Times to which all agents are extrapolated at constant velocity."""
PAIR_FEATURES = len(EXTRAPOLATION_S) + 2
BOX_POINTS = 2 * DISCS
_GAP_M, _HEADWAY_S, _BRAKE_MPS2, _ASIDE_M = 2.0, 1.0, 8.0, 0.3
_LEAST_M, _LEAST_MPS = 0.5, 1.0
_MOST_CLEAR_M = 5.0
_ALONG = [2.0 * k / (DISCS - 1) - 1.0 for k in range(DISCS)]
_DISC_PRODUCTS = [(1.0, b * b, a * a, 2.0 * b, -2.0 * a, -2.0 * a * b) for a, b in product(_ALONG, _ALONG)]
"""Coefficients of the six terms of :func:`extrapolated_gaps` for disc a of the row and b of the other, both −1 … 1."""


def pair_features(near: Neighbours) -> list[Tensor]:
    """Return 7 features (B, R, K) of the proximity of neighbours to the rows.

    The first five are exp(−gap / 2 m) between the discs at ``EXTRAPOLATION_S``. The last two are 0 unless
    the neighbour is ahead in the corridor of the row: exp(−headway / 1 s), and the deceleration that just avoids
    contact, / 8 m/s² and at most 2.
    """
    close = torch.exp(-extrapolated_gaps(near).clamp(min=-_GAP_M) / _GAP_M)
    return [*close.unbind(0), *_following(near)]


def extrapolated_gaps(near: Neighbours) -> Tensor:
    """Return (T, B, R, K) gaps in metres between discs at ``EXTRAPOLATION_S``; negative for overlap.

    The squared distance of disc a of the row and disc b of the other is linear in six terms of the pair. With *p* the
    other's position, *u* its unit heading, *r* the distance of its outermost discs from its centre, and *own* that of
    the row, it is p² + r² b² + own² a² + 2 r b (p · u) − 2 own a pₓ − 2 own r a b uₓ.
    """
    times = near.cos.new_tensor(EXTRAPOLATION_S)[:, None, None, None]
    x = torch.addcmul(near.ahead_m, times, near.speed_mps * near.cos - near.own_speed_mps)
    y = torch.addcmul(near.left_m, times, near.speed_mps * near.sin)  # (T, B, R, K)
    reach = (near.half_length_m - near.half_width_m).clamp(min=0.0)
    own = (near.own_half_length_m - near.own_half_width_m).clamp(min=0.0)
    terms = (
        torch.addcmul(x * x, y, y),
        (reach * reach).expand(x.shape),
        (own * own).expand(x.shape),
        reach * torch.addcmul(x * near.cos, y, near.sin),
        own * x,
        (own * reach * near.cos).expand(x.shape),
    )
    squared = torch.stack(terms, dim=-1) @ x.new_tensor(_DISC_PRODUCTS).t()
    distance = torch.sqrt(squared.amin(-1).clamp(min=0.0) + 1e-6)
    return distance - (near.half_width_m + near.own_half_width_m)


def _following(near: Neighbours) -> tuple[Tensor, Tensor]:
    """Return headway and required-deceleration features (B, R, K) towards agents in the corridor ahead."""
    lead = lead_gaps(near)
    gap = lead.gap_m.clamp(min=0.0)
    close = torch.exp(-gap / near.own_speed_mps.clamp(min=_LEAST_MPS) / _HEADWAY_S)
    brake = lead.closing_mps.clamp(min=0.0).square() / (2.0 * _BRAKE_MPS2 * gap.clamp(min=_LEAST_M))
    return close * lead.inside, brake.clamp(max=2.0) * lead.inside


@dataclass(frozen=True)
class LeadGaps:
    """Relations of R vehicles to those ahead of them, (B, R, K) each.

    Attributes:
        gap_m: from front to rear, along the row's heading.
        closing_mps: rate at which the gap shrinks.
        inside: 0 … 1, degree to which the other is ahead and in the straight corridor of the row's box.
    """

    gap_m: Tensor
    closing_mps: Tensor
    inside: Tensor


def lead_gaps(near: Neighbours) -> LeadGaps:
    """Return gaps, closing speeds and which agents are ahead."""
    cos, sin = near.cos.abs(), near.sin.abs()
    along = torch.addcmul(cos * near.half_length_m, sin, near.half_width_m)
    across = torch.addcmul(cos * near.half_width_m, sin, near.half_length_m)
    aside = near.left_m.abs() - near.own_half_width_m - across
    ahead = (near.ahead_m > 0.0) & ~near.oneself
    return LeadGaps(
        gap_m=near.ahead_m - near.own_half_length_m - along,
        closing_mps=torch.addcmul(near.own_speed_mps, near.speed_mps, near.cos, value=-1.0),
        inside=torch.sigmoid(-aside / _ASIDE_M) * ahead,
    )


def box_clearance(place: Tensor, turn: Tensor, size: Tensor, edges: RoadEdges) -> Tensor:
    """Return (B, R, 10) signed clearances of points on both sides of each box to the road edge, / 5 m, clipped to ±1.

    Centres *place* (B, R, 2), headings *turn* (B, R) and *edges* are in the vehicles' frames at the beginning of the
    rollout; *size* (B, R, 2) are lengths and widths.
    """
    local = place[:, :, None] + rotate(_box_points(size), turn[..., None])
    return (edges.clearance(local) / _MOST_CLEAR_M).clamp(-1.0, 1.0)


def _box_points(size: Tensor) -> Tensor:
    """Return (B, R, 10, 2) five points on each side of boxes of *size* (B, R, 2), left side first."""
    share = torch.linspace(-0.5, 0.5, DISCS, device=size.device, dtype=size.dtype)
    unit = torch.cat([torch.stack((share, torch.full_like(share, side)), -1) for side in (0.5, -0.5)])
    return size[:, :, None] * unit
