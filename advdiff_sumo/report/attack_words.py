"""Episodes in which nobody could do what the background was asked for, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

_DOES: Mapping[str, str] = {
    "any": "attack",
    "cut-in": "cut in",
    "cut-out": "cut out",
    "queue": "be the end of a queue before it",
    "oncoming": "cross its way from ahead",
    "double": "stop hard before it while others are nearer",
    "slow-merge": "merge slowly before it",
    "pull-out": "pull out before it",
    "rear-end": "run into its rear",
    "head-on": "meet it head-on",
    "junction": "cross its way",
    "crossing": "cross its way",
    "brake": "brake before it",
    "hard-stop": "stop hard before it",
    "blocked-lane": "block its lane",
    "stop-and-go": "slow down before it",
}


def out_of_position(row: Mapping[str, Any]) -> str | None:
    """Return what nobody was in a position to do in the episode of *row*; None where somebody was, or none attacks."""
    if row.get("attack_kind") is None or row.get("in_position") is not False:
        return None
    return _DOES.get(str(row["attack_kind"]), f"attack as '{row['attack_kind']}'")


def position_lines(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Return (what, in how many episodes) for each kind of attack that lacked somebody in position in some *rows*."""
    lines = []
    for kind in dict.fromkeys(row.get("attack_kind") for row in rows):
        asked = [row for row in rows if row.get("attack_kind") == kind]
        lacking = [words for row in asked if (words := out_of_position(row)) is not None]
        if lacking:
            lines.append(
                (f"no one was in a position to {lacking[0]}", f"in {len(lacking)} of {len(asked)} episodes")
            )
    return lines


def plan_lines(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Return (what, in how many episodes) where targets planned what no vehicle can do in some *rows*."""
    known = [row for row in rows if row.get("implausible_plans") is not None]
    some = [row for row in known if row["implausible_plans"]]
    if not some:
        return []
    what = f"plans that no vehicle can drive ({some[0]['implausible_plan']}; see check-planner)"
    return [(what, f"in {len(some)} of {len(known)} episodes")]
