"""Attention over the lane pieces that are near a vehicle, or coming, where it has got to."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.geometry import from_segments
from advdiff_sumo.models.model_options import LANES_OF, PIECE_FEATURES, PIECE_POINTS, ModelOptions
from advdiff_sumo.models.perceptron import perceptron, silent

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
        """Return the ``NEAREST`` pieces seen from *place* (B, R, 2), *turn* (B, R) in the frames at the beginning."""
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
        """Return which pieces (B, R, 9) of points *xy* (B, R, L, N, 2) in the vehicles' frames are near or coming."""
        x, y = xy.unbind(-1)
        ahead = torch.where(x > 0.0, _AHEAD * x, x)
        away = torch.addcmul(ahead.square(), y, y).amin(-1).masked_fill(~self.valid, _FAR_M2)
        return away.topk(min(NEAREST, away.shape[-1]), dim=-1, largest=False).indices


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
        self.piece = perceptron(2 * PIECE_POINTS + _CLOSEST + PIECE_FEATURES, width, width, ends_in_relu=True)
        self.query = nn.Linear(query, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.out = silent(nn.Linear(width, options.hidden))

    def forward(self, state: Tensor, pieces: LanePieces) -> Tensor:
        """Return (B, R, D) for *state* (B, R, Q), what each asks with; *pieces* are of ``LanePieces.seen_from``."""
        columns = (0.05 * pieces.xy.flatten(-2), closest(pieces.xy), pieces.features * self.scale)
        embedded = self.piece(torch.cat(columns, dim=-1))  # (B, R, 9, W)
        # keys and values are linear in the pieces: each is asked for and summed up before it is made
        of_key, of_value = (w.reshape(self.heads, -1, w.shape[1]) for w in self.key_value.weight.chunk(2))
        query = self.query(state).unflatten(-1, (self.heads, -1)) * of_key.shape[1] ** -0.5
        asked = torch.einsum("brhd,hdw->brhw", query, of_key)
        mask = pieces.valid[:, :, None]
        score = (asked @ embedded.transpose(-1, -2)).masked_fill(~mask, -1e9)  # (B, R, H, 9)
        weight = torch.softmax(score, dim=-1) * mask
        pooled = torch.einsum("brhw,hdw->brhd", weight @ embedded, of_value).flatten(-2)
        bias = self.key_value.bias.chunk(2)[1]  # that of the keys adds the same to every score
        out: Tensor = self.out(pooled + bias * mask.any(-1))
        return out
