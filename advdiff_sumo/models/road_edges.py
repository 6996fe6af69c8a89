"""Segments of the road edge around vehicles, and signed distances of points from them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.model_options import LANES_OF

_ROAD_EDGE = 4
_LEAST_M = 1e-3
FAR_M = 1e3
"""Clearance if there is no road edge."""
CORNER = 1e-3
"""Weight of the lateral distance where two segments are equally near, see :meth:`RoadEdges._nearest`."""


@dataclass(frozen=True)
class RoadEdges:
    """S segments in the frames of R vehicles.

    Attributes:
        usable: (B, R, S) which segments are real.
        lines: (B, R, S, 7) unit direction, left normal, coordinates of the first point along both, and length.
        along: (B, R, 3, S) matrix from points (x, y, 1) to their positions along the segments.
        left: (B, R, 3, S) matrix from points (x, y, 1) to their distances left of the segments.
    """

    usable: Tensor
    lines: Tensor
    along: Tensor
    left: Tensor

    @staticmethod
    def between(first: Tensor, last: Tensor, usable: Tensor) -> RoadEdges:
        """Return the segments from *first* to *last*, (B, R, S, 2) each, of which *usable* (B, R, S) are real."""
        along = last - first
        length = along.norm(dim=-1, keepdim=True)
        x, y = (along / length.clamp(min=_LEAST_M)).unbind(-1)
        x = torch.where(length[..., 0] < _LEAST_M, 1.0, x)  # a segment of no length has any direction
        begin = torch.stack(
            (x * first[..., 0] + y * first[..., 1], x * first[..., 1] - y * first[..., 0]), -1
        )
        lines = torch.cat((torch.stack((x, y, -y, x), -1), begin, length), dim=-1)
        of_along, of_left = (
            torch.stack(rows, -2) for rows in ((x, y, -begin[..., 0]), (-y, x, -begin[..., 1]))
        )
        return RoadEdges(usable, lines, of_along, of_left)

    @staticmethod
    def of(batch: SceneBatch) -> RoadEdges:
        """Return the road edges around all agents of *batch*, in each agent's frame."""
        return RoadEdges.between(*road_edges(batch))

    def expand(self, scenes: int) -> RoadEdges:
        """Return the segments of one scene, repeated for *scenes* scenes."""
        return RoadEdges(*(part.expand(scenes, *part.shape[1:]) for part in vars(self).values()))

    def clearance(self, points: Tensor) -> Tensor:
        """Return signed distances (B, R, M) of *points* (B, R, M, 2) to the nearest segment, positive left of it.

        ``FAR_M`` without segments.
        """
        which, real = self._nearest(points)
        line = self.lines.gather(2, which[..., None].expand(*which.shape, self.lines.shape[-1]))
        along = (points * line[..., :2]).sum(-1) - line[..., 4]
        left = (points * line[..., 2:4]).sum(-1) - line[..., 5]
        beyond = along - torch.minimum(along.clamp(min=0.0), line[..., 6])
        distance = torch.sqrt(left.square() + beyond.square() + 1e-9)
        return torch.where(real, torch.where(left >= 0.0, distance, -distance), FAR_M)

    @torch.no_grad()
    def _nearest(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Return the index of the segment nearest to each point, and whether it is real, (B, R, M) each."""
        local = torch.cat((points, torch.ones_like(points[..., :1])), dim=-1)
        along, left = local @ self.along, local @ self.left  # (B, R, M, S)
        beyond = along.sub_(torch.minimum(along.clamp(min=0.0), self.lines[:, :, None, :, 6]))
        distance = left.square().addcmul_(beyond, beyond).sqrt_()
        # near a corner two segments are equally near; the one with the greater lateral distance has the right sign
        score = distance.sub_(left.abs_(), alpha=CORNER).masked_fill_(~self.usable[:, :, None], FAR_M)
        which = score.argmin(dim=-1)
        return which, self.usable.gather(2, which)


def road_edges(batch: SceneBatch) -> tuple[Tensor, Tensor, Tensor]:
    """Return ends (B, A, S, 2) of the road edges' segments in each agent's frame, and which are real (B, A, S)."""
    is_edge = batch.map_valid & (batch.map_features[..., _ROAD_EDGE] > 0.5)
    selected: slice | Tensor
    if is_edge.is_cuda:  # on a GPU, finding empty pieces takes longer than computing with them
        selected = slice(LANES_OF[is_edge.shape[-1]], None)
    else:
        selected = is_edge.flatten(0, 1).any(0)
        selected[0] |= ~selected.any()  # keep at least one piece, although it is not usable
    pieces, is_edge = batch.map_xy[:, :, selected], is_edge[:, :, selected]
    first, last = pieces[..., :-1, :].flatten(2, 3), pieces[..., 1:, :].flatten(2, 3)
    usable = is_edge[..., None].expand(*is_edge.shape, pieces.shape[3] - 1).flatten(2)
    return first, last, usable
