"""Sets up the guide of one plan: chooses attackers and the objectives that guide them."""

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
"""Shift of a denoising step at strength 1, in units of √Σ."""
HORIZON_STEPS, NEAR_STEPS = 8, 6
"""Model steps of the future in the cost of an attack of a certain kind, and of kind "any"."""
_REWARD_STEPS, _ATTACK_STEPS = 3, 1
"""Last denoising steps in which the reward model, or the cost of the attack, guides."""
_TURNS = 4
"""Parts of the last step's shift, each along a new gradient."""
SHIFT_KEPT = 0.8
"""Share of an attacker's previous shift with which the next plan begins."""
_REWARD_WEIGHT, _ATTACK_WEIGHT = 0.25, 1.0


@dataclass(frozen=True)
class Scenes:
    """A scene, once and repeated for each sample.

    Attributes:
        single: the scene.
        repeated: the scene, repeated for each sample.
        context: embeddings and prior of the single scene.
    """

    single: SceneBatch
    repeated: SceneBatch
    context: Context


def guidance(
    networks: Networks,
    options: DiffusionOptions,
    view: View,
    scenes: Scenes,
    previous_shifts: Mapping[str, FloatArray],
) -> tuple[Guidance | None, tuple[str, ...]]:
    """Return the guide and the ids of the attackers; None and () if no vehicle can attack.

    Args:
        networks: the trained networks.
        options: options of the policy.
        view: the scene.
        scenes: the scene as tensors, with its context.
        previous_shifts: id of an attacker of the previous plan → shift (Z,) of its latent.
    """
    attack = options.attack_term
    natural = natural_futures(networks, scenes, NEAR_STEPS if attack == "any" else HORIZON_STEPS)
    futures = futures_of(view.now, natural.rollout)
    candidates = can_attack(futures, view.moved, options.licence)
    rows = choose(futures, candidates, attack, options.attackers, np.isin(view.ids, tuple(previous_shifts)))
    if not len(rows):
        return None, ()
    attackers = torch.from_numpy(rows).to(networks.device)
    reward = networks.bundle.reward
    h, mean = scenes.context.h, scenes.context.prior.mean
    count = scenes.repeated.scenes
    with torch.no_grad():
        state = reward.prepare(
            h.expand(count, -1, -1),
            mean.expand(count, -1, -1),
            scenes.repeated,
            torch.zeros(count, dtype=torch.long, device=networks.device),
        )
    terms = [Term(networks.reward(state), _REWARD_WEIGHT, _REWARD_STEPS)]
    if options.guide == "reward":
        assert isinstance(networks.codec, LatentCodec)  # noqa: S101 - networks_of refuses other codecs with a guide
        scene = AttackScene(
            networks.decoder, networks.codec, scenes.context, scenes.single, attackers, natural
        )
        terms.append(Term(attack_objective(attack, scene), _ATTACK_WEIGHT, _ATTACK_STEPS))
    mask = torch.zeros(scenes.single.agents, dtype=h.dtype, device=networks.device)
    mask[attackers] = 1.0
    names = tuple(view.ids[row] for row in rows.tolist())
    begin = torch.zeros(scenes.single.agents, mean.shape[-1], dtype=h.dtype, device=networks.device)
    for row, name in zip(rows.tolist(), names, strict=True):
        if name in previous_shifts:
            begin[row] = SHIFT_KEPT * torch.from_numpy(previous_shifts[name]).to(begin)
    return Guidance(terms, mask, ALPHA * options.strength, _TURNS, begin), names


def natural_futures(networks: Networks, scenes: Scenes, steps: int) -> Natural:
    """Return the natural futures over the next *steps*: the decoder at the prior's mean."""
    rollout, trace = networks.decoder.whole(scenes.context.prior.mean, scenes.context.h, scenes.single, steps)
    return Natural(rollout, trace)
