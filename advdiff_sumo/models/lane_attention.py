"""Attention over the lane pieces that are near a vehicle, or coming, where it has got to."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.geometry import from_segments, into_frame
from advdiff_sumo.models.model_options import LANES_OF, PIECE_FEATURES, PIECE_POINTS, ModelOptions

NEAREST = 9
"""Lane pieces that a vehicle attends to."""
_AHEAD = 0.4
"""What lies ahead counts as nearer than it is, as in ``maps.vector_map``."""
_FAR_M2 = 1e8
_OFFSET_M = 5.0
_CLOSEST = 4
_SCALE = (0.25, 0.1, *[1.0] * (PIECE_FEATURES - 2))


@dataclass(frozen=True)
class LanePieces:
    """Lane pieces around R vehicles, in the frame that each of them had at the beginning.

    Attributes:
        xy: (B, R, L, N, 2) points in driving direction.
        features: (B, R, L, F) columns, as in ``SceneBatch.map_features``.
        valid: (B, R, L) whether the piece is real.
    """

    xy: Tensor
    features: Tensor
    valid: Tensor

    @staticmethod
    def of(batch: SceneBatch) -> LanePieces:
        """Return the lane pieces of all agents of *batch*; its other pieces are road edges."""
        lanes = slice(0, LANES_OF[batch.map_xy.shape[2]])
        return LanePieces(
            batch.map_xy[:, :, lanes], batch.map_features[:, :, lanes], batch.map_valid[:, :, lanes]
        )

    def seen_from(self, place: Tensor, turn: Tensor) -> LanePieces:
        """Return the ``NEAREST`` pieces in the frames that the vehicles have now.

        Args:
            place: (B, R, 2) where they are in their frames at the beginning.
            turn: (B, R) their headings there.
        """
        with torch.no_grad():
            which = self._nearest(place, turn)
        points = which[..., None, None].expand(*which.shape, *self.xy.shape[-2:])
        columns = which[..., None].expand(*which.shape, self.features.shape[-1])
        xy = _into(self.xy.gather(2, points), place, turn)
        return LanePieces(xy, self.features.gather(2, columns), self.valid.gather(2, which))

    def _nearest(self, place: Tensor, turn: Tensor) -> Tensor:
        """Return which pieces (B, R, 9) are near or coming."""
        xy = _into(self.xy, place, turn)
        ahead = torch.where(xy[..., 0] > 0.0, _AHEAD * xy[..., 0], xy[..., 0])
        away = (ahead.square() + xy[..., 1].square()).amin(-1).masked_fill(~self.valid, _FAR_M2)
        return away.topk(min(NEAREST, away.shape[-1]), dim=-1, largest=False).indices


def _into(xy: Tensor, place: Tensor, turn: Tensor) -> Tensor:
    """Return points (B, R, L, N, 2) in frames at *place* (B, R, 2) that look along *turn* (B, R)."""
    yaw = turn[:, :, None, None].expand(xy.shape[:-1])
    return into_frame(xy, place[:, :, None, None], yaw)


def closest(xy: Tensor) -> Tensor:
    """Return (…, 4) how the origin lies to polylines (…, N, 2): offset, distance, and the line's unit direction.

    The offset is to the left of the line's nearest segment; both lengths are in units of 5 m, at most 1.
    """
    first, along = xy[..., :-1, :], xy[..., 1:, :] - xy[..., :-1, :]
    away, _, squared = from_segments(first.new_zeros(2), first, along)
    distance = torch.sqrt(away.square().sum(-1) + 1e-6)
    which = distance.argmin(-1, keepdim=True)
    unit = along / squared.sqrt()[..., None]
    left = (unit[..., 1] * first[..., 0] - unit[..., 0] * first[..., 1]).gather(-1, which)
    direction = unit.gather(-2, which[..., None].expand(*which.shape, 2)).squeeze(-2)
    near = torch.cat((left, distance.gather(-1, which)), dim=-1) / _OFFSET_M
    return torch.cat((near.clamp(-1.0, 1.0), direction), dim=-1)


class LaneAttention(nn.Module):
    """What the nearest and coming lane pieces say to each vehicle; begins as nothing."""

    scale: Tensor

    def __init__(self, options: ModelOptions, query: int) -> None:
        super().__init__()
        width = options.message
        self.heads = options.heads
        self.register_buffer("scale", torch.tensor(_SCALE), persistent=False)
        self.piece = nn.Sequential(
            nn.Linear(2 * PIECE_POINTS + _CLOSEST + PIECE_FEATURES, width),
            nn.ReLU(),
            nn.Linear(width, width),
            nn.ReLU(),
        )
        self.query = nn.Linear(query, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.out = nn.Linear(width, options.hidden)
        nn.init.zeros_(self.out.weight)
        nn.init.constant_(self.out.bias, 0.0)

    def forward(self, state: Tensor, pieces: LanePieces) -> Tensor:
        """Return (B, R, D).

        Args:
            state: (B, R, Q) what each vehicle asks with.
            pieces: of :meth:`LanePieces.seen_from`.
        """
        columns = (0.05 * pieces.xy.flatten(-2), closest(pieces.xy), pieces.features * self.scale)
        key, value = self.key_value(self.piece(torch.cat(columns, dim=-1))).chunk(2, dim=-1)
        key, value = (part.unflatten(-1, (self.heads, -1)) for part in (key, value))  # (B, R, 9, H, W / H)
        query = self.query(state).unflatten(-1, (self.heads, -1))[:, :, None]
        score = (query * key).sum(-1) * key.shape[-1] ** -0.5
        mask = pieces.valid[..., None]
        weight = torch.softmax(score.masked_fill(~mask, -1e9), dim=2) * mask
        out: Tensor = self.out((weight[..., None] * value).sum(2).flatten(-2))
        return out
