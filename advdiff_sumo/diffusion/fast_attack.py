"""The objective of an attack: by ``compiled`` where the decoder is, elsewhere by ``tensor_attack``.

Gradients through a closed-loop decoder take 40 ms each; ``differenced_attack`` does without.
"""

from __future__ import annotations

from advdiff_sumo.diffusion.differenced_attack import DifferencedAttack
from advdiff_sumo.diffusion.guides import Objective
from advdiff_sumo.diffusion.tensor_attack import AttackScene, tensor_attack


def attack_objective(kind: str, scene: AttackScene) -> Objective:
    """Return what the attackers of *scene* shall make large for *kind*, of ``COSTS``, as ``tensor_attack``."""
    if scene.decoder.closed_loop:
        return DifferencedAttack(kind, scene)
    if scene.decoder.compiled is None:
        return tensor_attack(kind, scene)
    from advdiff_sumo.diffusion.compiled.attack import CompiledAttack

    return CompiledAttack(kind, scene, scene.decoder.compiled)
