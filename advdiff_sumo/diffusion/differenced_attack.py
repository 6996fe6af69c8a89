"""The objective of an attack with its slope by central differences, for decoders whose gradient is dear.

Only latents of which the windows hold much are moved: of the shipped closed-loop decoder's 32, the four of the largest
deviation carry 95 % of the squared gradient. All are tried in one roll-out without gradients, for all attackers at
once: each looks at what becomes of itself.
"""

from __future__ import annotations

import torch
from torch import Tensor

from advdiff_sumo.diffusion.attack import AttackScene, attack_losses, plain_objective
from advdiff_sumo.diffusion.attack_slope import SlopedAttack, attack_code
from advdiff_sumo.diffusion.guides import Objective

WIDEST = 4
"""Latents along which the objective is differenced."""
STEP = 0.25
"""How far to each side, in deviations of the latents."""


def attack_objective(kind: str, scene: AttackScene) -> Objective:
    """Return what the attackers of *scene* shall make large for *kind*, of ``COSTS``.

    Gradients through a closed-loop decoder take 40 ms each; there it is differenced.
    """
    if scene.decoder.closed_loop:
        return DifferencedAttack(kind, scene)
    code = attack_code(scene.decoder, scene.natural.steps)
    return plain_objective(kind, scene) if code is None else SlopedAttack(kind, scene, code)


class DifferencedAttack:
    """What the attackers of a scene shall make large, as ``attack``.

    Args:
        kind: a key of ``COSTS``.
        scene: who attacks, and where.
    """

    def __init__(self, kind: str, scene: AttackScene) -> None:
        self._losses, self._rows = attack_losses(kind, scene), scene.rows
        deviations = scene.codec.std.flatten()
        self._widest = deviations.topk(min(WIDEST, len(deviations))).indices

    def __call__(self, latents: Tensor) -> Tensor:
        """Return the objective (B,) of scaled *latents* (B, A, Z), with gradients to them."""
        return -self._losses(latents).mean(-1)

    @torch.no_grad()
    def slope(self, latents: Tensor) -> Tensor:
        """Return the slope (B, A, Z) of the objective at scaled *latents* (B, A, Z), 0 along all but the widest."""
        along = STEP * torch.eye(latents.shape[-1], device=latents.device)[self._widest]
        moves = torch.cat((along, -along))  # (2 K, Z)
        tried = latents[:, None].repeat(1, len(moves), 1, 1)
        tried[:, :, self._rows] += moves[:, None]
        losses = self._losses(tried.flatten(0, 1)).reshape(len(latents), len(moves), -1)
        ahead, behind = losses.chunk(2, dim=1)  # (B, K, R)
        rises = (behind - ahead) / (2.0 * STEP * len(self._rows))
        out = torch.zeros_like(latents)
        out[:, self._rows[:, None], self._widest] = rises.transpose(1, 2)
        return out
