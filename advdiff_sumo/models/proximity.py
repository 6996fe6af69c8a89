"""How bodies lie to each other and to the road's edge: gaps now and soon, headway, clearance of the box."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import torch
from torch import Tensor

from advdiff_sumo.models.geometry import rotate
from advdiff_sumo.models.losses import DISCS
from advdiff_sumo.models.neighbours import Neighbours
from advdiff_sumo.models.road_edges import RoadEdges

CARRIED_S = (0.0, 0.5, 1.0, 1.5, 2.5)
"""Instants to which everybody is carried on at present velocity."""
PAIR_FEATURES = len(CARRIED_S) + 2
BOX_POINTS = 2 * DISCS
_GAP_M, _HEADWAY_S, _BRAKE_MPS2, _ASIDE_M = 2.0, 1.0, 8.0, 0.3
_LEAST_M, _LEAST_MPS = 0.5, 1.0
_MOST_CLEAR_M = 5.0
_ALONG = [2.0 * k / (DISCS - 1) - 1.0 for k in range(DISCS)]
_DISC_PRODUCTS = [(1.0, b * b, a * a, 2.0 * b, -2.0 * a, -2.0 * a * b) for a, b in product(_ALONG, _ALONG)]
"""What the six terms of :func:`carried_gaps` count for disc a of the row and b of the other, both −1 … 1."""


def pair_features(near: Neighbours) -> list[Tensor]:
    """Return 7 columns (B, R, K): how close the bodies of neighbours are to those of the rows, now and soon.

    The first columns are exp(−gap / 2 m) of the five discs of each body at ``CARRIED_S``. The last two count where
    the other is ahead in the corridor of the row's body: exp(−headway / 1 s), and the deceleration that would just
    avoid the contact, in units of 8 m/s², at most 2.
    """
    close = torch.exp(-carried_gaps(near).clamp(min=-_GAP_M) / _GAP_M)
    return [*close.unbind(0), *_following(near)]


def carried_gaps(near: Neighbours) -> Tensor:
    """Return (T, B, R, K) gaps in metres between discs at ``CARRIED_S``; negative where they overlap.

    The squared distance of disc a of the row and b of the other is linear in six numbers of the pair: with *p* the
    other's place, *u* its heading, *r* how far its outermost discs are from its centre and *own* the row's, it is
    p² + r² b² + own² a² + 2 r b (p · u) − 2 own a pₓ − 2 own r a b uₓ.
    """
    times = near.cos.new_tensor(CARRIED_S)[:, None, None, None]
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
    """Return (B, R, K) closeness in time, and the deceleration needed, behind those in the corridor ahead."""
    lead = lead_gaps(near)
    gap = lead.gap_m.clamp(min=0.0)
    close = torch.exp(-gap / near.own_speed_mps.clamp(min=_LEAST_MPS) / _HEADWAY_S)
    brake = lead.closing_mps.clamp(min=0.0).square() / (2.0 * _BRAKE_MPS2 * gap.clamp(min=_LEAST_M))
    return close * lead.inside, brake.clamp(max=2.0) * lead.inside


@dataclass(frozen=True)
class LeadGaps:
    """How R vehicles stand to those ahead of them, (B, R, K) each.

    Attributes:
        gap_m: from front to rear, along the row's heading.
        closing_mps: how fast that shrinks.
        inside: 0 … 1, how far the other is ahead and in the corridor that the row's body sweeps straight on.
    """

    gap_m: Tensor
    closing_mps: Tensor
    inside: Tensor


def lead_gaps(near: Neighbours) -> LeadGaps:
    """Return gaps, closing speeds and who is ahead."""
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
    """Return (B, R, 10) signed clearances of both sides of each box to the road's edge, in units of 5 m within ±1.

    Centres *place* (B, R, 2), headings *turn* (B, R) and *edges* are in the vehicles' frames at the beginning; *size*
    (B, R, 2) are lengths and widths.
    """
    local = place[:, :, None] + rotate(_box_points(size), turn[..., None])
    return (edges.clearance(local) / _MOST_CLEAR_M).clamp(-1.0, 1.0)


def _box_points(size: Tensor) -> Tensor:
    """Return (B, R, 10, 2) five points on each side of boxes of *size* (B, R, 2), the left side first."""
    share = torch.linspace(-0.5, 0.5, DISCS, device=size.device, dtype=size.dtype)
    unit = torch.cat([torch.stack((share, torch.full_like(share, side)), -1) for side in (0.5, -0.5)])
    return size[:, :, None] * unit
