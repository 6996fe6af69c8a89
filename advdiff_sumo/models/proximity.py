"""How bodies lie to each other and to the road's edge: gaps now and soon, headway, clearance of the box."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.models.geometry import into_frame, rotate
from advdiff_sumo.models.losses import DISCS, clearance_from

CARRIED_S = (0.0, 0.5, 1.0, 1.5, 2.5)
"""Instants to which everybody is carried on at present velocity."""
PAIR_FEATURES = len(CARRIED_S) + 2
BOX_POINTS = 2 * DISCS
_GAP_M, _HEADWAY_S, _BRAKE_MPS2, _ASIDE_M = 2.0, 1.0, 8.0, 0.3
_LEAST_M, _LEAST_MPS = 0.5, 1.0
_MOST_CLEAR_M = 5.0


def pair_features(xy: Tensor, yaw: Tensor, speed: Tensor, size: Tensor, rows: Tensor) -> Tensor:
    """Return (B, R, A, 7) how close the bodies of all agents are to those of *rows*, now and soon.

    The first columns are exp(−gap / 2 m) of the five discs of each body at ``CARRIED_S``. The last two count where
    the other is ahead in the corridor of the row's body: exp(−headway / 1 s), and the deceleration that would just
    avoid the contact, in units of 8 m/s², at most 2.

    Args:
        xy: (B, A, 2) box centres.
        yaw: (B, A) headings.
        speed: (B, A) speeds.
        size: (B, A, 2) lengths and widths.
        rows: (R,) agents that look.
    """
    close = torch.exp(-carried_gaps(xy, yaw, speed, size, rows).clamp(min=-_GAP_M) / _GAP_M)
    return torch.cat((close, _following(xy, yaw, speed, size, rows)), dim=-1)


def carried_gaps(xy: Tensor, yaw: Tensor, speed: Tensor, size: Tensor, rows: Tensor) -> Tensor:
    """Return (B, R, A, T) gaps in metres between discs at ``CARRIED_S``; negative where they overlap."""
    times = torch.tensor(CARRIED_S, device=xy.device, dtype=xy.dtype)[:, None, None]
    ahead = torch.stack((torch.cos(yaw), torch.sin(yaw)), dim=-1)
    places = xy[:, None] + times * (speed[..., None] * ahead)[:, None]  # (B, T, A, 2)
    radius = 0.5 * size[..., 1]
    reach = ((0.5 * size[..., 0] - radius).clamp(min=0.0)[..., None] * ahead)[:, None]  # (B, 1, A, 2)
    mine, yours = _nearest_discs(places, reach, rows)
    begin = places[:, :, rows][:, :, :, None] + mine[..., None] * reach[:, :, rows][:, :, :, None]
    end = places[:, :, None] + yours[..., None] * reach[:, :, None]
    distance = torch.sqrt((begin - end).square().sum(-1) + 1e-6).permute(0, 2, 3, 1)
    return distance - (radius[:, rows][:, :, None] + radius[:, None])[..., None]


@torch.no_grad()
def _nearest_discs(places: Tensor, reach: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
    """Return where along their boxes, −1 … 1, the nearest discs of rows and agents are, (B, T, R, A) each."""
    offsets = torch.linspace(-1.0, 1.0, DISCS, device=places.device, dtype=places.dtype)
    centres = places[..., None, :] + offsets[:, None] * reach[..., None, :]  # (B, T, A, 5, 2)
    apart = torch.cdist(centres[:, :, rows].flatten(2, 3), centres.flatten(2, 3))  # (B, T, R·5, A·5)
    shape = (*apart.shape[:2], len(rows), DISCS, places.shape[2], DISCS)
    which = apart.reshape(shape).transpose(3, 4).flatten(-2).argmin(-1)
    return offsets[which // DISCS], offsets[which % DISCS]


def _following(xy: Tensor, yaw: Tensor, speed: Tensor, size: Tensor, rows: Tensor) -> Tensor:
    """Return (B, R, A, 2) closeness in time, and the deceleration needed, behind those in the corridor ahead."""
    lead = lead_gaps(xy, yaw, speed, size, rows)
    own = speed[:, rows][:, :, None]
    gap = lead.gap_m.clamp(min=0.0)
    near = torch.exp(-gap / own.clamp(min=_LEAST_MPS) / _HEADWAY_S)
    brake = lead.closing_mps.clamp(min=0.0).square() / (2.0 * gap.clamp(min=_LEAST_M)) / _BRAKE_MPS2
    return torch.stack((near, brake.clamp(max=2.0)), dim=-1) * lead.inside[..., None]


@dataclass(frozen=True)
class LeadGaps:
    """How R vehicles stand to those ahead of them, (B, R, A) each.

    Attributes:
        gap_m: from front to rear, along the row's heading.
        closing_mps: how fast that shrinks.
        inside: 0 … 1, how far the other is ahead and in the corridor that the row's body sweeps straight on.
    """

    gap_m: Tensor
    closing_mps: Tensor
    inside: Tensor


def lead_gaps(xy: Tensor, yaw: Tensor, speed: Tensor, size: Tensor, rows: Tensor) -> LeadGaps:
    """Return gaps, closing speeds and who is ahead, of all agents as *rows* see them; arguments as above."""
    place = into_frame(
        xy[:, None], xy[:, rows][:, :, None], yaw[:, rows][:, :, None].expand(-1, -1, xy.shape[1])
    )
    turn = yaw[:, None] - yaw[:, rows][:, :, None]
    cos, sin = torch.cos(turn).abs(), torch.sin(turn).abs()
    length, width = 0.5 * size[:, None, :, 0], 0.5 * size[:, None, :, 1]
    gap = place[..., 0] - 0.5 * size[:, rows, None, 0] - (cos * length + sin * width)
    aside = place[..., 1].abs() - 0.5 * size[:, rows, None, 1] - (cos * width + sin * length)
    inside = torch.sigmoid(-aside / _ASIDE_M) * (place[..., 0] > 0.0)
    inside = inside * (torch.arange(xy.shape[1], device=xy.device) != rows[:, None])
    closing = speed[:, rows][:, :, None] - speed[:, None] * torch.cos(turn)
    return LeadGaps(gap, closing, inside)


def box_clearance(place: Tensor, turn: Tensor, size: Tensor, edges: tuple[Tensor, Tensor, Tensor]) -> Tensor:
    """Return (B, R, 10) signed clearances of both sides of each box to the road's edge, in units of 5 m within ±1.

    Args:
        place: (B, R, 2) box centres in the vehicles' frames at the beginning.
        turn: (B, R) headings there.
        size: (B, R, 2) lengths and widths.
        edges: segments in these frames, of ``losses.road_edges``.
    """
    along = torch.linspace(-0.5, 0.5, DISCS, device=place.device, dtype=place.dtype) * size[..., :1]
    side = torch.stack((size[..., 1], -size[..., 1]), dim=-1) * 0.5
    points = torch.stack(
        (
            along[..., None, :].expand(*side.shape, DISCS),
            side[..., None].expand(*side.shape, DISCS),
        ),
        dim=-1,
    ).flatten(2, 3)  # (B, R, 10, 2)
    local = place[:, :, None] + rotate(points, turn[..., None].expand(points.shape[:-1]))
    return (clearance_from(local, *edges) / _MOST_CLEAR_M).clamp(-1.0, 1.0)
