"""Every background policy by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

from advdiff_sumo.config import Options
from advdiff_sumo.plugins import Registry, must_have, must_take

if TYPE_CHECKING:
    from advdiff_sumo.traffic.policy_protocol import TrafficPolicy

POLICIES = Registry(
    kind="background",
    group="advdiff_sumo.policies",
    builtins={
        "sumo": "advdiff_sumo.traffic.sumo_traffic:SumoTraffic",
        "replay": "advdiff_sumo.traffic.replay:Replay",
        "diffusion": "advdiff_sumo.traffic.diffusion.diffusion_policy:DiffusionTraffic",
        "traj2traj": "advdiff_sumo.traffic.diffusion.diffusion_policy:Traj2Traj",
        "advsim": "advdiff_sumo.traffic.baselines.advsim:AdvSim",
        "strive": "advdiff_sumo.traffic.baselines.strive:Strive",
        "scripted": "advdiff_sumo.traffic.scripted.scripted_policy:ScriptedTraffic",
        "adv-rl": "advdiff_sumo.traffic.rl.adv_rl_policy:AdvRl",
    },
    descriptions={
        "sumo": "natural traffic: SUMO drives everybody",
        "replay": "every logged road user follows its log",
        "diffusion": "guided latent diffusion against the target; natural with --strength 0",
        "traj2traj": "diffusion of trajectories in place of latents, the paper's ablation",
        "advsim": "search over the attackers' actions (baseline AdvSim)",
        "strive": "search over the latents of the traffic prior (baseline Strive)",
        "scripted": "lawful manoeuvres that make a careful driver brake hard; needs no networks",
        "adv-rl": "one attacker taught by reinforcement learning (baseline Adv-RL)",
    },
)
"""``sumo``, ``replay``, ``diffusion``, the baselines, and plug-ins of the group ``advdiff_sumo.policies``."""

_OF_ATTACKS = dict.fromkeys(
    ("attack", "attackers", "licence", "strength", "guide"),
    "; scripted and diffusion are backgrounds that attack",
)


def make_policy(name: str, options: Mapping[str, Any]) -> TrafficPolicy:
    """Return the policy called *name*, set up with *options*.

    A class may carry its options as a pydantic model, ``Options`` (a subclass of
    :class:`advdiff_sumo.config.Options`); they are checked against it, and the class is called with the keys
    that were given. Otherwise the signature of the class decides.

    Args:
        name: a built-in or plug-in (case, hyphen and underscore do not matter), or ``package.module:Class``.
        options: keyword arguments of the class; see ``docs/policies.md``.

    Raises:
        UnknownNameError: no such policy; with the nearest name.
        ConfigError: an option has no such name or value, or the class cannot be imported or is no policy.
    """
    canonical = POLICIES.canonical(name)
    factory = POLICIES.factory(canonical)
    where = f"options of background '{canonical}'"
    model = getattr(factory, "Options", None)
    if isinstance(model, type) and issubclass(model, Options):
        model.parse(options, where)
    else:
        must_take(factory, options, where, elsewhere=_OF_ATTACKS)
    policy = factory(**options)
    must_have(f"background '{canonical}' is no policy: {type(policy).__name__}", policy, ("start", "plan"))
    return cast("TrafficPolicy", policy)
