"""Sets up the guide of one plan: who attacks, and what by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.diffusion.attack import AttackScene, Natural
from advdiff_sumo.diffusion.attack_slope import attack_objective
from advdiff_sumo.diffusion.guides import Guidance, Term
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.view import View
from advdiff_sumo.traffic.diffusion.diffusion_networks import Networks
from advdiff_sumo.traffic.diffusion.diffusion_options import DiffusionOptions
from advdiff_sumo.traffic.planning.attackers import can_attack, choose
from advdiff_sumo.traffic.planning.futures import futures_of

ALPHA = 10.0
"""Shift of a step at strength 1, in units of √Σ."""
HORIZON_STEPS, NEAR_STEPS = 8, 6
"""Model steps of a future that an attack of a certain kind looks at, and one of any kind."""
_REWARD_RUNGS, _ATTACK_RUNGS = 3, 1
_TURNS = 4
KEPT = 0.8
"""Share of an attacker's shift that its next plan begins with."""
_REWARD_WEIGHT, _ATTACK_WEIGHT = 0.25, 1.0


@dataclass(frozen=True)
class Scenes:
    """One scene, alone and as often as samples are drawn.

    Attributes:
        one: the scene.
        many: the scene, repeated.
        context: of the one.
    """

    one: SceneBatch
    many: SceneBatch
    context: Context


def guidance(
    networks: Networks,
    options: DiffusionOptions,
    view: View,
    scenes: Scenes,
    before: Mapping[str, FloatArray],
) -> tuple[Guidance | None, tuple[str, ...]]:
    """Return the guide and the names of those it guides; no guide where nobody can attack.

    Args:
        networks: the trained networks.
        options: of the policy.
        view: the scene.
        scenes: the same as tensors, with its context.
        before: who attacked last, and by what shift of its latent, (Z,).
    """
    attack = options.attack_term
    natural = naturally(networks, scenes, NEAR_STEPS if attack == "any" else HORIZON_STEPS)
    futures = futures_of(view.now, natural.rollout)
    may = can_attack(futures, view.moved, options.licence)
    rows = choose(futures, may, attack, options.attackers, np.isin(view.ids, tuple(before)))
    if not len(rows):
        return None, ()
    attackers = torch.from_numpy(rows).to(networks.device)
    reward = networks.bundle.reward
    h, mean = scenes.context.h, scenes.context.prior.mean
    count = scenes.many.scenes
    with torch.no_grad():
        state = reward.prepare(
            h.expand(count, -1, -1),
            mean.expand(count, -1, -1),
            scenes.many,
            torch.zeros(count, dtype=torch.long, device=networks.device),
        )
    terms = [Term(networks.reward(state), _REWARD_WEIGHT, _REWARD_RUNGS)]
    if options.guide == "reward":
        assert isinstance(networks.codec, LatentCodec)  # noqa: S101 - networks_of refuses others where there is a guide
        scene = AttackScene(networks.decoder, networks.codec, scenes.context, scenes.one, attackers, natural)
        terms.append(Term(attack_objective(attack, scene), _ATTACK_WEIGHT, _ATTACK_RUNGS))
    mask = torch.zeros(scenes.one.agents, dtype=h.dtype, device=networks.device)
    mask[attackers] = 1.0
    names = tuple(view.ids[row] for row in rows.tolist())
    begin = torch.zeros(scenes.one.agents, mean.shape[-1], dtype=h.dtype, device=networks.device)
    for row, name in zip(rows.tolist(), names, strict=True):
        if name in before:
            begin[row] = KEPT * torch.from_numpy(before[name]).to(begin)
    return Guidance(terms, mask, ALPHA * options.strength, _TURNS, begin), names


def naturally(networks: Networks, scenes: Scenes, steps: int) -> Natural:
    """Return where everybody would go in the next *steps*: the decoder at the prior's mean."""
    rollout, trace = networks.decoder.whole(scenes.context.prior.mean, scenes.context.h, scenes.one, steps)
    return Natural(rollout, trace)
