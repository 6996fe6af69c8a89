"""Rows of the closed-loop tables: background policies by the names that ``--policies`` takes, and who meets them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from advdiff_sumo.experiments.bench.asked_scenes import asked_scenes
from advdiff_sumo.experiments.bench.bench_config import Request, chosen
from advdiff_sumo.experiments.bench.reporter import ProgressReporter
from advdiff_sumo.experiments.bench.scene_list import TABLE_LIST, SceneList
from advdiff_sumo.planners.planner_registry import TARGETS, make_target
from advdiff_sumo.traffic.policy_registry import POLICIES, make_policy


@dataclass(frozen=True)
class PolicyRow:
    """A background as a row.

    Attributes:
        title: what is printed.
        background: as registered.
        options: of it.
        reference: it does not attack, and is looked at beside those that do.
    """

    title: str
    background: str
    options: Mapping[str, Any] = field(default_factory=dict)
    reference: bool = False


NATURAL, UNGUIDED, OURS, SCRIPTED = "sumo", "unguided", "diffusion", "scripted"
PAPERS_LICENCE: Mapping[str, Any] = {"licence": "reckless"}
"""What attackers may do in the paper's tables: anything that moves like a vehicle; with its kind of decoder."""
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
    """Return the row *name*; scripted attackers have the licence of the others, a user's own background is as it is."""
    return POLICY_ROWS.get(name, PolicyRow(name, name, PAPERS_LICENCE if name == SCRIPTED else {}))


def licensed(options: Mapping[str, Any], request: Request) -> dict[str, Any]:
    """Return *options* of a row with the licence that is asked for, if any, where it has one."""
    if request.licence is None or "licence" not in options:
        return dict(options)
    return {**options, "licence": request.licence}


def refits_q(request: Request) -> bool:
    """Return whether warm-ups refit Q, as in the paper; under other licences they learn which encounters to go for."""
    return licensed(PAPERS_LICENCE, request) == PAPERS_LICENCE


def made_policy(name: str) -> object:
    """Return the policy of the row *name*.

    Raises:
        InputError: it cannot be made, for example as its weights are missing.
    """
    row = policy_row(name)
    return make_policy(row.background, row.options)


def made_target(name: str, options: Mapping[str, Any] = MappingProxyType({})) -> object:
    """Return the target *name* with *options*; errors as in :func:`made_policy`."""
    return make_target(name, options)


def asked_of(
    request: Request,
    teller: ProgressReporter,
    usual_targets: Mapping[str, str],
    usual_rows: Mapping[str, str] = REGISTERED,
    scene_list: str = TABLE_LIST,
    folder: Path | None = None,
) -> tuple[SceneList, tuple[str, ...], tuple[str, ...]]:
    """Return the seed scenes, targets and rows that the request asks for; say which usual ones are left out.

    Args:
        request: what is asked.
        teller: is told what is left out.
        usual_targets: targets where none are named, by their names in the table.
        usual_rows: rows where none are named, with their backgrounds.
        scene_list: shipped list of seed scenes.
        folder: of the bench; None: nothing is begun yet.

    Raises:
        InputError: a name is unknown, or the list of scenes cannot be used.
    """
    scenes = asked_scenes(request, scene_list, folder)
    made = partial(made_target, options=request.episode.target_options)
    targets, absent = chosen(request.targets, usual_targets, TARGETS, "--targets", made)
    names, lacking = chosen(request.policies, usual_rows, POLICIES, "--policies", made_policy)
    for what, missing in (("row", lacking), ("target", absent)):
        for name in missing:
            teller.say(f"{what} {name} is left out: this installation lacks it or its weights")
    return scenes, targets, names
