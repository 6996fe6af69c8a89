"""The agents nearest to each row of a scene, in that row's frame."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.models.geometry import relative_columns

_ABSENT_M2 = 1e10


@dataclass(frozen=True)
class Neighbours:
    """K agents in the frames of R rows; tensors (B, R, K), those of the row itself (own_…) (B, R, 1).

    Attributes:
        which: indices of the agents; None: all A agents in order.
        ahead_m: position along the row's heading.
        left_m: position to its left.
        cos: of the angle from the row's heading to the other's.
        sin: of the same.
        speed_mps: the other's speed.
        half_length_m: half the other's length.
        half_width_m: half the other's width.
        own_speed_mps: the row's speed.
        own_half_length_m: half its length.
        own_half_width_m: half its width.
        oneself: whether this agent is the row itself.
    """

    which: Tensor | None
    ahead_m: Tensor
    left_m: Tensor
    cos: Tensor
    sin: Tensor
    speed_mps: Tensor
    half_length_m: Tensor
    half_width_m: Tensor
    own_speed_mps: Tensor
    own_half_length_m: Tensor
    own_half_width_m: Tensor
    oneself: Tensor

    @staticmethod
    def of(
        xy: Tensor, yaw: Tensor, speed: Tensor, size: Tensor, rows: Tensor, which: Tensor | None = None
    ) -> Neighbours:
        """Return agents at *xy* (B, A, 2), with *yaw* and *speed* (B, A) and *size* (B, A, 2), as seen by *rows* (R,).

        The agents are *which* (B, R, K), of :func:`nearest_agents`; None: all.
        """
        x, y = xy.unbind(-1)
        length, width = (0.5 * size).unbind(-1)
        columns = torch.stack(
            (x, y, torch.cos(yaw), torch.sin(yaw), speed, length, width), dim=1
        )  # (B, 7, A)
        own = columns.index_select(2, rows)[..., None].unbind(1)
        if which is None:
            other = columns[:, :, None].unbind(1)
            oneself = rows[:, None] == torch.arange(xy.shape[1], device=xy.device)
        else:
            picked = columns.gather(2, which.flatten(1)[:, None].expand(-1, columns.shape[1], -1))
            other = picked.reshape(*picked.shape[:2], *which.shape[1:]).unbind(1)
            oneself = which == rows[:, None]
        x, y, cos, sin, speed, length, width = other
        east, north = x - own[0], y - own[1]
        return Neighbours(
            which=which,
            ahead_m=torch.addcmul(own[2] * east, own[3], north),
            left_m=torch.addcmul(own[2] * north, own[3], east, value=-1.0),
            cos=torch.addcmul(own[2] * cos, own[3], sin),
            sin=torch.addcmul(own[2] * sin, own[3], cos, value=-1.0),
            speed_mps=speed.expand(east.shape),
            half_length_m=length.expand(east.shape),
            half_width_m=width.expand(east.shape),
            own_speed_mps=own[4],
            own_half_length_m=own[5],
            own_half_width_m=own[6],
            oneself=oneself.expand(east.shape),
        )

    def relative_features(self) -> tuple[Tensor, ...]:
        """Return the columns, (B, R, K) each, of ``geometry.relative_features``."""
        speeds = self.speed_mps, self.own_speed_mps
        return relative_columns(self.ahead_m, self.left_m, self.cos, self.sin, *speeds)

    def among(self, values: Tensor) -> Tensor:
        """Return (B, R or 1, K, …) the *values* (B, A, …) of these agents."""
        if self.which is None:
            return values[:, None]
        agents = values.shape[1]
        first = agents * torch.arange(values.shape[0], device=values.device)
        index = (self.which + first[:, None, None]).flatten()
        picked = values.flatten(0, 1).index_select(0, index)
        return picked.reshape(*self.which.shape, *values.shape[2:])


@torch.no_grad()
def nearest_agents(xy: Tensor, present: Tensor, rows: Tensor, count: int) -> Tensor | None:
    """Return indices (B, R, K) of the *count* agents nearest to *rows* (R,), the rows included; None: all agents.

    *xy* (B, A, 2) are centres. Agents that are not *present* (B, A) rank last. A *count* of 0 means all agents.
    """
    if count <= 0 or count >= xy.shape[1]:
        return None
    squared = (xy.index_select(1, rows)[:, :, None] - xy[:, None]).square().sum(-1)
    squared = squared + torch.where(present, 0.0, _ABSENT_M2)[:, None]
    return squared.topk(count, dim=-1, largest=False).indices
