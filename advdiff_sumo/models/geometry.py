"""Frames and relative poses of tensors."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def wrap_angle(angle: Tensor) -> Tensor:
    """Return *angle* in [−π, π)."""
    return torch.remainder(angle + math.pi, 2.0 * math.pi) - math.pi


def rotate(xy: Tensor, yaw: Tensor) -> Tensor:
    """Return vectors (…, 2) turned by *yaw* (…,) counter-clockwise."""
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    x, y = xy[..., 0], xy[..., 1]
    return torch.stack((cos * x - sin * y, sin * x + cos * y), dim=-1)


def into_frame(xy: Tensor, origin: Tensor, yaw: Tensor) -> Tensor:
    """Return points (…, 2) as seen from a pose at *origin* (…, 2) that looks along *yaw* (…,)."""
    return rotate(xy - origin, -yaw)


RELATIVE_FEATURES = 9


def relative_features(xy: Tensor, yaw: Tensor, speed: Tensor, rows: Tensor | None = None) -> Tensor:
    """Return relative states of agents at *xy* (B, A, 2), with *yaw* and *speed* (B, A), as seen by *rows* (R,).

    *rows* None: by all. Entry [b, i, j] of (B, R, A, 9) is agent j in i's frame: position / 20 m, exp(−range / 10 m),
    unit heading, and, all / 10 m/s, velocity, velocity along i's heading relative to i, and i's own speed.
    """
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    place, ci, si, own = (x if rows is None else x[:, rows] for x in (xy, cos, sin, speed))
    ci, si = ci[:, :, None], si[:, :, None]
    delta = xy[:, None] - place[:, :, None]
    dx = ci * delta[..., 0] + si * delta[..., 1]
    dy = ci * delta[..., 1] - si * delta[..., 0]
    cj, sj = cos[:, None], sin[:, None]
    turn_cos, turn_sin = ci * cj + si * sj, ci * sj - si * cj
    return torch.stack(relative_columns(dx, dy, turn_cos, turn_sin, speed[:, None], own[:, :, None]), dim=-1)


def relative_columns(
    ahead_m: Tensor, left_m: Tensor, cos: Tensor, sin: Tensor, speed_mps: Tensor, own_speed_mps: Tensor
) -> tuple[Tensor, ...]:
    """Return the columns of :func:`relative_features` for agents at these positions and headings in the own frame."""
    vx, vy = 0.1 * speed_mps * cos, 0.1 * speed_mps * sin
    own = (0.1 * own_speed_mps).expand_as(vx)
    near = torch.exp(-0.1 * torch.sqrt(ahead_m * ahead_m + left_m * left_m + 1e-6))
    return 0.05 * ahead_m, 0.05 * left_m, near, cos, sin, vx, vy, vx - own, own


def from_segments(points: Tensor, first: Tensor, along: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the position of *points* relative to segments from *first* to *first* + *along*, (…, 2) each.

    Returns:
        Vectors (…, 2) from the nearest point of the segment and from its first point, and its squared length (…).
    """
    delta = points - first
    squared = along.square().sum(-1).clamp(min=1e-6)
    share = ((delta * along).sum(-1) / squared).clamp(0.0, 1.0)
    return delta - share[..., None] * along, delta, squared
