"""The objective of an attack on the CPU, with its gradient by hand but for what only the kind of attack looks at."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from advdiff_sumo.diffusion.attack_costs import COSTS, SOFT_M, TOUCHES_M, encounter
from advdiff_sumo.diffusion.compiled.body_kernel import CompiledBodies
from advdiff_sumo.diffusion.compiled.decoder_kernel import CompiledDecoder, RowsAgainst, rollout_of
from advdiff_sumo.diffusion.compiled.kernel import Array, array_of
from advdiff_sumo.diffusion.guides import Objective
from advdiff_sumo.diffusion.tensor_attack import (
    OTHERS_WEIGHT,
    PRIOR_WEIGHT,
    ROAD_WEIGHT,
    AttackScene,
    tensor_attack,
)
from advdiff_sumo.diffusion.tensor_bodies import Placed
from advdiff_sumo.models.decoder import Rollout


class CompiledAttack:
    """What the attackers of a scene shall make large, as ``tensor_attack``.

    Args:
        kind: a key of ``COSTS``.
        scene: who attacks, and where.
        decoder: the scene's.
    """

    def __init__(self, kind: str, scene: AttackScene, decoder: CompiledDecoder) -> None:
        self._kind, self._scene, self._decoder = kind, scene, decoder
        self._rows, natural, prior = scene.rows.numpy(), scene.natural, scene.context.prior
        self._runs: dict[int, RowsAgainst] = {}
        self._bodies = CompiledBodies(Placed(scene.batch, scene.rows, natural.rollout))
        self._mean = array_of(prior.mean[:, scene.rows])
        self._precision = np.exp(-array_of(prior.logvar[:, scene.rows]))
        self._scale, self._offset = array_of(scene.codec.std)[0], array_of(scene.codec.mean)[0]

    def __call__(self, latents: Tensor) -> Tensor:
        """Return the objective (B,) of scaled *latents* (B, A, Z), with gradients to them."""
        return self._on_tensors(latents)

    @cached_property
    def _on_tensors(self) -> Objective:
        return tensor_attack(self._kind, self._scene)

    def slope(self, latents: Tensor) -> Tensor:
        """Return the gradient (B, A, Z) of the objective's sum over scenes."""
        given = array_of(latents)
        z = given[:, self._rows] * self._scale + self._offset
        run = self._run(len(z))
        futures = run.forward(z)
        by_z = run.back(self._by_futures(futures)) + PRIOR_WEIGHT * (z - self._mean) * self._precision
        out = np.zeros_like(given)
        out[:, self._rows] = -self._scale / given.dtype.type(len(self._rows)) * by_z
        return torch.from_numpy(out)

    def _by_futures(self, futures: Array) -> Array:
        """Return the gradient (B, T, R, 6) of the sum of all attackers' costs for what they drive, *futures*."""
        poses = np.ascontiguousarray(futures[..., :3].swapaxes(1, 2))
        values, slopes = self._bodies.met(poses)
        by_gap, direct = self._by_aim(futures, values[0])
        by_pose = by_gap[..., None] * slopes[0] + OTHERS_WEIGHT * slopes[1] + ROAD_WEIGHT * slopes[2]
        out = np.zeros_like(futures)
        out[..., :3] = by_pose.swapaxes(1, 2)
        if direct is not None:
            out[..., :4] += direct.swapaxes(1, 2)
        return out

    def _by_aim(self, futures: Array, gap: Array) -> tuple[Array, Array | None]:
        """Return the gradients of the kind's own cost for gaps (B, R, T), and for x, y, yaw, speed (B, R, T, 4)."""
        if self._kind == "any":
            return nearest_slope(gap), None
        scene, rollout = self._scene, rollout_of(futures)
        size = scene.batch.size[0]
        free = [torch.from_numpy(gap), rollout.xy, rollout.yaw, rollout.speed]
        with torch.enable_grad():
            gaps, xy, yaw, speed = (part.requires_grad_(True) for part in free)
            driven = Rollout(xy, yaw, speed, rollout.accel, rollout.curvature)
            met = encounter(driven, size[scene.rows], scene.natural, size[0], gaps)
            aim = COSTS[self._kind](met).sum()
            by = torch.autograd.grad(aim, (gaps, xy, yaw, speed), allow_unused=True, materialize_grads=True)
        by_gap, by_xy, by_yaw, by_speed = (part.numpy() for part in by)
        return by_gap, np.concatenate((by_xy, by_yaw[..., None], by_speed[..., None]), axis=-1)

    def _run(self, count: int) -> RowsAgainst:
        """Return the roll-outs of *count* samples of the scene."""
        if count not in self._runs:
            scene = self._scene
            h, batch, trace = scene.context.h, scene.batch, scene.natural.trace
            if count > 1:
                h, batch, trace = h.expand(count, -1, -1), batch.repeat(count), trace.repeat(count)
            self._runs[count] = RowsAgainst(self._decoder, h, batch, scene.rows, scene.natural.steps, trace)
        return self._runs[count]


def nearest_slope(gap: Array) -> Array:
    """Return the gradient (B, R, T) of the smooth least of gaps (B, R, T), as the cost of kind "any" has it."""
    near = np.maximum(gap, TOUCHES_M)
    share = np.exp((near.min(-1, keepdims=True) - near) / SOFT_M)
    share /= share.sum(-1, keepdims=True)
    slope: Array = np.where(gap >= TOUCHES_M, share, gap.dtype.type(0.0))
    return slope
