"""Rows of the closed-loop tables: background policies by the names of ``--policies``, and their targets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from advdiff_sumo.experiments.bench.bench_config import Request, chosen_names
from advdiff_sumo.experiments.bench.reporter import ProgressReporter
from advdiff_sumo.experiments.bench.requested_scenes import requested_scenes
from advdiff_sumo.experiments.bench.scene_list import TABLE_LIST, SceneList
from advdiff_sumo.planners.planner_protocol import Target
from advdiff_sumo.planners.planner_registry import TARGETS, make_target
from advdiff_sumo.sim.run_episodes import make_or_explain
from advdiff_sumo.traffic.policy_registry import POLICIES, make_policy


@dataclass(frozen=True)
class PolicyRow:
    """A row with a background policy.

    Attributes:
        title: printed name.
        background: as registered.
        options: of it.
        reference: it does not attack, and serves for comparison.
    """

    title: str
    background: str
    options: Mapping[str, Any] = field(default_factory=dict)
    reference: bool = False


NATURAL, UNGUIDED, OURS, SCRIPTED = "sumo", "unguided", "diffusion", "scripted"
PAPERS_LICENCE: Mapping[str, Any] = {"licence": "reckless"}
"""The licence of the paper's tables: attackers may do all that a vehicle can. It also selects the paper's decoder."""
POLICY_ROWS: Mapping[str, PolicyRow] = {
    NATURAL: PolicyRow("SUMO (natural)", "sumo", {}, True),
    "replay": PolicyRow("Replay", "replay", {}, True),
    UNGUIDED: PolicyRow("diffusion, unguided", "diffusion", {"guide": "none", **PAPERS_LICENCE}, True),
    "traj2traj": PolicyRow("traj2traj", "traj2traj", {}, True),
    "advsim": PolicyRow("AdvSim", "advsim", PAPERS_LICENCE),
    "strive": PolicyRow("Strive", "strive", PAPERS_LICENCE),
    "adv-rl": PolicyRow("Adv-RL", "adv-rl", PAPERS_LICENCE),
    OURS: PolicyRow("diffusion, guided (ours)", "diffusion", PAPERS_LICENCE),
}
REGISTERED: Mapping[str, str] = {name: row.background for name, row in POLICY_ROWS.items()}
TARGET_TITLES: Mapping[str, str] = {
    "lane_graph": "rule-based",
    "simnet": "SimNet",
    "trafficsim": "TrafficSim",
    "diffusion": "diffusion (w/o guide)",
}


def policy_row(name: str) -> PolicyRow:
    """Return the row *name*; ``scripted`` gets the paper's licence, a user's own background no options."""
    return POLICY_ROWS.get(name, PolicyRow(name, name, PAPERS_LICENCE if name == SCRIPTED else {}))


def with_licence(options: Mapping[str, Any], request: Request) -> dict[str, Any]:
    """Return the *options* of a row with the licence of the request, if both have one."""
    if request.licence is None or "licence" not in options:
        return dict(options)
    return {**options, "licence": request.licence}


def refits_q(request: Request) -> bool:
    """Return whether warm-ups refit Q, as in the paper; under other licences they fit a failure predictor."""
    return with_licence(PAPERS_LICENCE, request) == PAPERS_LICENCE


def made_policy(name: str) -> object:
    """Return the policy of the row *name*.

    Raises:
        InputError: it cannot be made, for example because its weights are missing.
    """
    row = policy_row(name)
    return made_background(row.background, row.options)


def made_background(name: str, options: Mapping[str, Any]) -> object:
    """Return the background policy *name* with *options*; errors as in :func:`made_policy`."""
    return make_or_explain(f"background '{name}'", make_policy, name, options)


def made_target(name: str, options: Mapping[str, Any] = MappingProxyType({})) -> Target:
    """Return the target *name* with *options*; errors as in :func:`made_policy`."""
    return make_or_explain(f"target '{name}'", make_target, name, options)


def resolve_request(
    request: Request,
    reporter: ProgressReporter,
    default_targets: Mapping[str, str],
    default_rows: Mapping[str, str] = REGISTERED,
    scene_list: str = TABLE_LIST,
    folder: Path | None = None,
) -> tuple[SceneList, tuple[str, ...], tuple[str, ...]]:
    """Return the seed scenes, targets and rows of the request; report the defaults that are left out.

    Args:
        request: of the bench.
        reporter: gets the messages on what is left out.
        default_targets: name in the table → registered name.
        default_rows: name of the row → registered background.
        scene_list: shipped list of seed scenes.
        folder: of the bench; None: not begun yet.

    Raises:
        InputError: a name is unknown, or the list of scenes cannot be used.
    """
    scenes = requested_scenes(request, scene_list, folder)
    make = partial(made_target, options=request.episode.target_options)
    targets, missing_targets = chosen_names(request.targets, default_targets, TARGETS, "--targets", make)
    names, missing_rows = chosen_names(request.policies, default_rows, POLICIES, "--policies", made_policy)
    for kind, missing in (("row", missing_rows), ("target", missing_targets)):
        for name in missing:
            reporter.say(f"{kind} {name} is left out: this installation lacks it or its weights")
    return scenes, targets, names
