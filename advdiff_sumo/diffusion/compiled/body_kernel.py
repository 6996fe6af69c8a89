"""How attackers' bodies lie among others and on the road, with the gradients of their places and headings by hand.

The same functions as ``tensor_bodies`` has, equal up to rounding. A body's pose is x, y, yaw.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from advdiff_sumo.diffusion.compiled.kernel import Array, array_of, kernel
from advdiff_sumo.diffusion.tensor_bodies import Met, Placed
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.losses import CORNER, DISCS, FAR_M, road_edges

_SOFT_M2 = 1e-9
_LEAST_RADIUS_M = 0.1
_MOST = 2.0


class Around(NamedTuple):
    """What attackers can meet; R of them, O others, target first, S segments of road edges.

    Attributes:
        size: (R, 2) length and width of the attackers.
        others: (O, T, 3) poses.
        sizes: (O, 2) length and width.
        frame: (R, 3) poses in whose frames the segments are.
        segments: (R, S, 4) begin and extent.
        usable: (R, S) 1 where a segment counts, (R, 0) nowhere.
    """

    size: Array
    others: Array
    sizes: Array
    frame: Array
    segments: Array
    usable: Array


@kernel
def reach(length: float, radius: float) -> float:
    """Return how far from the centre the outermost discs of a body are."""
    return max(0.5 * length - radius, 0.0)


@kernel
def apart(mine: Array, my_reach: float, yours: Array, your_reach: float, slope: Array) -> float:
    """Return the distance of the nearest discs of two bodies, and write its *slope* (3,) by the pose *mine* (3,).

    Where several discs are nearest, the slope is the mean of theirs.
    """
    cos, sin = math.cos(mine[2]), math.sin(mine[2])
    ahead, left = math.cos(yours[2]), math.sin(yours[2])
    x, y = mine[0] - yours[0], mine[1] - yours[1]
    step = 2.0 / (DISCS - 1)
    least = math.inf
    count = by_x = by_y = by_yaw = 0.0
    for i in range(DISCS):
        a = my_reach * (step * i - 1.0)
        for j in range(DISCS):
            b = your_reach * (step * j - 1.0)
            dx, dy = x + a * cos - b * ahead, y + a * sin - b * left
            squared = dx * dx + dy * dy
            if squared < least:
                least = squared
                count = by_x = by_y = by_yaw = 0.0
            if squared == least:
                count += 1.0
                by_x += dx
                by_y += dy
                by_yaw += a * (cos * dy - sin * dx)
    distance = math.sqrt(least + _SOFT_M2)
    share = 1.0 / (count * distance)
    slope[0], slope[1], slope[2] = share * by_x, share * by_y, share * by_yaw
    return distance


@kernel
def clearance(x: float, y: float, segments: Array, usable: Array, slope: Array) -> float:
    """Return the signed distance of a point to the nearest road edge, and write its *slope* (2,)."""
    best = math.inf
    out = FAR_M
    slope[0] = slope[1] = 0.0
    for s in range(len(segments)):
        if usable[s] == 0.0:
            continue
        ex, ey = segments[s, 2], segments[s, 3]
        dx, dy = x - segments[s, 0], y - segments[s, 1]
        squared = max(ex * ex + ey * ey, 1e-6)
        share = min(max((dx * ex + dy * ey) / squared, 0.0), 1.0)
        away_x, away_y = dx - share * ex, dy - share * ey
        distance = math.sqrt(away_x * away_x + away_y * away_y + _SOFT_M2)
        aside = (ex * dy - ey * dx) / math.sqrt(squared)
        if distance - CORNER * abs(aside) < best:
            best = distance - CORNER * abs(aside)
            sign = 1.0 if aside >= 0.0 else -1.0
            out = sign * distance
            slope[0], slope[1] = sign * away_x / distance, sign * away_y / distance
    return out


@kernel
def off(pose: Array, length: float, radius: float, row: int, around: Around, slope: Array) -> float:
    """Return how far a body is over the road's edge, as a share of its width, and write its *slope* (3,)."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    frame, most = around.frame[row], 0.0
    c, s = math.cos(frame[2]), math.sin(frame[2])
    by = np.empty(2, pose.dtype)
    slope[0] = slope[1] = slope[2] = 0.0
    wide = 2.0 * max(radius, _LEAST_RADIUS_M)
    for i in range(-1, 2):
        a = reach(length, radius) * i
        x, y = pose[0] + a * cos - frame[0], pose[1] + a * sin - frame[1]
        clear = clearance(c * x + s * y, c * y - s * x, around.segments[row], around.usable[row], by)
        over = (radius - clear) / wide
        if min(over, _MOST) > most:
            most = min(over, _MOST)
            rate = -1.0 / wide if over <= _MOST else 0.0
            by_x, by_y = rate * (c * by[0] - s * by[1]), rate * (s * by[0] + c * by[1])
            slope[0], slope[1], slope[2] = by_x, by_y, a * (cos * by_y - sin * by_x)
    return most


@kernel
def meet(poses: Array, around: Around, values: Array, slopes: Array) -> None:
    """Set *values* and *slopes* for the attackers' *poses*.

    Args:
        poses: (B, R, T, 3).
        around: what they can meet.
        values: (3, B, R, T) to be written: distance of the bodies from the target, overlap with others, off the road.
        slopes: (3, B, R, T, 3) to be written: the values' gradients by the poses.
    """
    scenes, rows, steps = values.shape[1:]
    slope = np.empty(3, poses.dtype)
    for b in range(scenes):
        for r in range(rows):
            length, radius = around.size[r, 0], 0.5 * around.size[r, 1]
            for t in range(steps):
                pose, total = poses[b, r, t], 0.0
                by = slopes[1, b, r, t]
                by[0] = by[1] = by[2] = 0.0
                for o in range(len(around.others)):
                    yours = 0.5 * around.sizes[o, 1]
                    to, wide = around.others[o, t], radius + yours
                    far = abs(pose[0] - to[0]) + abs(pose[1] - to[1])
                    if o > 0 and far > 2.0 * (length + around.sizes[o, 0] + wide):
                        continue
                    distance = apart(pose, reach(length, radius), to, reach(around.sizes[o, 0], yours), slope)
                    if o == 0:
                        values[0, b, r, t] = distance - wide
                        for i in range(3):
                            slopes[0, b, r, t, i] = slope[i]
                    elif distance <= wide:
                        total += 1.0 - distance / wide
                        for i in range(3):
                            by[i] -= slope[i] / wide
                values[1, b, r, t] = total
                values[2, b, r, t] = off(pose, length, radius, r, around, slopes[2, b, r, t])


class CompiledBodies:
    """What attackers meet, on the CPU.

    Args:
        placed: who is where.
    """

    def __init__(self, placed: Placed) -> None:
        batch, rows, natural = placed.batch, placed.rows, placed.natural
        agents = torch.cat((torch.zeros_like(rows[:1]), placed.others()))
        poses = torch.cat((natural.xy, natural.yaw[..., None]), dim=-1)[0, agents]
        first, last, usable = road_edges(batch.rows_of(rows))
        moved = usable & batch.moved[:, rows, None]
        kind = natural.xy.dtype
        self._around = Around(
            array_of(batch.size[0, rows]),
            array_of(poses),
            array_of(batch.size[0, agents]),
            array_of(batch.pose[0, rows, :3]),
            array_of(torch.cat((first, last - first), dim=-1)[0]),
            array_of(moved[0].to(kind)),
        )

    def __call__(self, rollout: Rollout) -> Met:
        """Return what the attackers of *rollout* (B, R, T) meet, with gradients to it."""
        values: Tensor = _Function.apply(rollout.xy, rollout.yaw, self)  # type: ignore[no-untyped-call] # PyTorch's
        return Met(values[0], values[1].sum(-1), values[2].sum(-1))

    def met(self, poses: Array) -> tuple[Array, Array]:
        """Return values (3, B, R, T) and slopes (3, B, R, T, 3) of :func:`meet` at *poses* (B, R, T, 3)."""
        values = np.empty((3, *poses.shape[:3]), poses.dtype)
        slopes = np.empty((3, *poses.shape), poses.dtype)
        meet(poses, self._around, values, slopes)
        return values, slopes


class _Function(torch.autograd.Function):
    """Autograd's view of :meth:`CompiledBodies.met`."""

    @staticmethod
    def forward(ctx: Any, xy: Tensor, yaw: Tensor, bodies: CompiledBodies) -> Tensor:
        values, ctx.slopes = bodies.met(array_of(torch.cat((xy, yaw[..., None]), dim=-1)))
        return torch.from_numpy(values)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor, None]:
        by_pose = torch.from_numpy((grad.numpy()[..., None] * ctx.slopes).sum(0))
        return by_pose[..., :2], by_pose[..., 2], None
