"""Rows of the closed-loop tables: background policies by the names that ``--policies`` takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from advdiff_sumo.planners.planner_registry import make_target
from advdiff_sumo.traffic.policy_registry import make_policy


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


NATURAL, UNGUIDED, OURS = "sumo", "unguided", "diffusion"
PAPERS_LICENCE: Mapping[str, Any] = {"licence": "reckless"}
"""What attackers may do in the paper's tables: anything that moves like a vehicle."""
POLICY_ROWS: Mapping[str, PolicyRow] = {
    NATURAL: PolicyRow("SUMO (natural)", "sumo", {}, True),
    "replay": PolicyRow("Replay", "replay", {}, True),
    UNGUIDED: PolicyRow("diffusion, unguided", "diffusion", {"guide": "none"}, True),
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
    """Return the row *name*; a background of the user's own is one as it is."""
    return POLICY_ROWS.get(name, PolicyRow(name, name))


def made_policy(name: str) -> object:
    """Return the policy of the row *name*.

    Raises:
        InputError: it cannot be made, for example as its weights are missing.
    """
    row = policy_row(name)
    return make_policy(row.background, row.options)


def made_target(name: str) -> object:
    """Return the target *name* with its defaults; errors as in :func:`made_policy`."""
    return make_target(name, {})
