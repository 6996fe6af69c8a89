"""Find targets by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.plug_in_source import PLANNER_CALLS, arguments_problem
from advdiff_sumo.planners.defects import parse_defects, plant
from advdiff_sumo.planners.planner_protocol import Planner, SumoDriver, Target
from advdiff_sumo.planners.remote.remote_name import check_slashes, is_remote
from advdiff_sumo.planners.sumo_models import CAR_FOLLOWING, sumo_driver
from advdiff_sumo.plugins import Registry, must_have, must_take

TARGETS = Registry(
    kind="target",
    group="advdiff_sumo.planners",
    builtins={
        **dict.fromkeys(CAR_FOLLOWING, "advdiff_sumo.planners.sumo_models:sumo_driver"),
        "lane_graph": "advdiff_sumo.planners.lane_graph:LaneGraphPlanner",
        "careful": "advdiff_sumo.planners.reference:CarefulPlanner",
        "reg157": "advdiff_sumo.planners.reference:Reg157Planner",
        "rss": "advdiff_sumo.planners.reference:RssPlanner",
        "fsm": "advdiff_sumo.planners.reference:FsmPlanner",
        "simnet": "advdiff_sumo.planners.learned:SimNetPlanner",
        "trafficsim": "advdiff_sumo.planners.learned:TrafficSimPlanner",
        "diffusion": "advdiff_sumo.planners.learned:DiffusionPlanner",
    },
    descriptions={
        **dict.fromkeys(CAR_FOLLOWING, "SUMO's car-following model"),
        "lane_graph": "rule-based planner over the lane graph",
        "careful": "careful and competent human driver of UN R157, on the way of lane_graph",
        "reg157": "reference driver Reg157 of UN R157, on the way of lane_graph",
        "rss": "reference driver RSS (responsibility-sensitive safety), on the way of lane_graph",
        "fsm": "reference driver FSM (fuzzy safety model), on the way of lane_graph",
        "simnet": "planner on futures predicted by SimNet",
        "trafficsim": "planner on futures predicted by TrafficSim",
        "diffusion": "planner on futures predicted by unguided latent diffusion",
    },
)
"""SUMO's models, ``lane_graph``, the reference drivers, the learned targets, and plug-ins.

The group of plug-ins is ``advdiff_sumo.planners``.
"""

_REMEDY = (
    "; give it among the target's options (--set target_options.NAME=VALUE of run and defects, "
    "--set NAME=VALUE of check-planner)"
)

BUILTIN_PLAN_S = 2.0
"""Least duration of the plans of built-in planners (s)."""


def plans_briefly(name: str) -> bool:
    """Return whether target *name* is a built-in planner: its plans may last only :data:`BUILTIN_PLAN_S`."""
    canonical = TARGETS.canonical(name)
    return canonical in TARGETS.builtins and canonical not in CAR_FOLLOWING


def make_target(name: str, options: Mapping[str, Any]) -> Target:
    """Return the target *name* with *options*.

    Args:
        name: a built-in or plug-in (case, hyphen and underscore do not matter), ``package.module:Class``,
            ``grpc://HOST:PORT`` or ``exec:COMMAND``.
        options: see ``docs/planners.md``; for plug-ins, keyword arguments of the class. ``defects`` is not passed
            to it: it lists the defects planted in the target (``docs/defects.md``).

    Raises:
        UnknownNameError: no such target; with the nearest name.
        ConfigError: an option has no such name or value, or the class cannot be imported or is no planner.
    """
    defects = parse_defects(options.get("defects", ()))
    sound_options = {key: value for key, value in options.items() if key != "defects"}
    return plant(_sound_target(name, sound_options), defects, name)


def _sound_target(name: str, options: Mapping[str, Any]) -> Target:
    """Return the target without defects."""
    if is_remote(name):
        from advdiff_sumo.planners.remote.remote_planner import remote_planner  # late: gRPC takes a while

        return remote_planner(name, options)
    check_slashes(name)
    canonical = TARGETS.canonical(name)
    if canonical in CAR_FOLLOWING:
        return sumo_driver(canonical, options)
    factory = TARGETS.factory(canonical)
    must_take(factory, options, f"options of target '{canonical}'", _REMEDY)
    target = factory(**options)
    if isinstance(target, SumoDriver):
        return target
    must_have(f"target '{canonical}' is no planner: {type(target).__name__}", target, PLANNER_CALLS)
    if problem := arguments_problem(target):
        raise ConfigError(f"target '{canonical}': {problem}")
    return cast("Planner", target)
