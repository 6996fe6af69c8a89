"""Attention over the lane pieces near and ahead of a vehicle's position in the rollout."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.geometry import from_segments
from advdiff_sumo.models.model_options import LANES_OF, PIECE_FEATURES, PIECE_POINTS, ModelOptions
from advdiff_sumo.models.perceptron import perceptron, zero_initialised

NEAREST = 9
"""Lane pieces that a vehicle attends to."""
_AHEAD = 0.4
"""Factor on distances ahead, so that pieces ahead rank as nearer, as in ``maps.vector_map``."""
_FAR_M2 = 1e8
_OFFSET_M = 5.0
_CLOSEST = 4
_SCALE = (0.25, 0.1, *[1.0] * (PIECE_FEATURES - 2))


@dataclass(frozen=True)
class LanePieces:
    """Lane pieces around R vehicles, in the frame of each vehicle at the beginning of the rollout.

    Attributes:
        xy: (B, R, L, N, 2) points in driving direction.
        features: (B, R, L, F) as in ``SceneBatch.map_features``.
        valid: (B, R, L) whether the piece is real, not padding.
    """

    xy: Tensor
    features: Tensor
    valid: Tensor

    @staticmethod
    def of(batch: SceneBatch) -> LanePieces:
        """Return the lane pieces of all agents of *batch*, without its road edges."""
        lanes = slice(0, LANES_OF[batch.map_xy.shape[2]])
        return LanePieces(
            batch.map_xy[:, :, lanes], batch.map_features[:, :, lanes], batch.map_valid[:, :, lanes]
        )

    def seen_from(self, place: Tensor, turn: Tensor) -> LanePieces:
        """Return the ``NEAREST`` pieces in new frames at *place* (B, R, 2) and *turn* (B, R) of the present ones."""
        cos, sin = torch.cos(turn), torch.sin(turn)
        into = torch.stack((cos, -sin, sin, cos), dim=-1).reshape(*turn.shape, 2, 2)
        shape = self.xy.shape
        xy = ((self.xy.flatten(2, 3) - place[:, :, None]) @ into).view(shape)
        which = self._nearest(xy.detach())
        points = which[..., None].expand(*which.shape, 2 * shape[3])
        columns = which[..., None].expand(*which.shape, self.features.shape[-1])
        return LanePieces(
            xy.flatten(3).gather(2, points).reshape(*which.shape, *shape[3:]),
            self.features.gather(2, columns),
            self.valid.gather(2, which),
        )

    def _nearest(self, xy: Tensor) -> Tensor:
        """Return the indices (B, R, 9) of the nearest pieces, whose points are *xy* (B, R, L, N, 2)."""
        x, y = xy.unbind(-1)
        ahead = torch.where(x > 0.0, _AHEAD * x, x)
        away = torch.addcmul(ahead.square(), y, y).amin(-1).masked_fill(~self.valid, _FAR_M2)
        return away.topk(min(NEAREST, away.shape[-1]), dim=-1, largest=False).indices


def closest(xy: Tensor) -> Tensor:
    """Return (…, 4) lateral offset and distance of the origin from polylines (…, N, 2), and their unit direction.

    All refer to the nearest segment; the offset is positive left of it. Both lengths are / 5 m and clipped to ±1.
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
    """Attention of each vehicle to the lane pieces near it; the output is initialised to zero."""

    scale: Tensor

    def __init__(self, options: ModelOptions, query: int) -> None:
        super().__init__()
        width = options.message
        self.heads = options.heads
        self.register_buffer("scale", torch.tensor(_SCALE), persistent=False)
        self.piece = perceptron(2 * PIECE_POINTS + _CLOSEST + PIECE_FEATURES, width, width, ends_in_relu=True)
        self.query = nn.Linear(query, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.out = zero_initialised(nn.Linear(width, options.hidden))

    def forward(self, state: Tensor, pieces: LanePieces) -> Tensor:
        """Return (B, R, D) for queries from *state* (B, R, Q) to *pieces* of ``LanePieces.seen_from``."""
        columns = (0.05 * pieces.xy.flatten(-2), closest(pieces.xy), pieces.features * self.scale)
        embedded = self.piece(torch.cat(columns, dim=-1))  # (B, R, 9, W)
        # keys and values are linear in the pieces, so that they are applied to query and pooled pieces instead
        of_key, of_value = (w.reshape(self.heads, -1, w.shape[1]) for w in self.key_value.weight.chunk(2))
        query = self.query(state).unflatten(-1, (self.heads, -1)) * of_key.shape[1] ** -0.5
        projected_query = torch.einsum("brhd,hdw->brhw", query, of_key)
        mask = pieces.valid[:, :, None]
        score = (projected_query @ embedded.transpose(-1, -2)).masked_fill(~mask, -1e9)  # (B, R, H, 9)
        weight = torch.softmax(score, dim=-1) * mask
        pooled = torch.einsum("brhw,hdw->brhd", weight @ embedded, of_value).flatten(-2)
        bias = self.key_value.bias.chunk(2)[1]  # the keys' bias adds the same to every score
        out: Tensor = self.out(pooled + bias * mask.any(-1))
        return out
