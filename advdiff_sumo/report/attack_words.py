"""Describes in words the episodes in which no vehicle was in a position to attack, or plans were impossible."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

_ACTIONS: Mapping[str, str] = {
    "any": "attack",
    "cut-in": "cut in",
    "cut-out": "cut out",
    "queue": "be the end of a queue before it",
    "oncoming": "cross its way from ahead",
    "double": "stop hard before it while others are nearer",
    "slow-merge": "merge slowly before it",
    "pull-out": "pull out before it",
    "close-pass": "pass it on the lane beside",
    "blind-spot": "stay in its blind spot",
    "short-gaps": "cross its way one after the other",
    "rear-end": "run into its rear",
    "head-on": "meet it head-on",
    "junction": "cross its way",
    "crossing": "cross its way",
    "brake": "brake before it",
    "hard-stop": "stop hard before it",
    "blocked-lane": "block its lane",
    "stop-and-go": "slow down before it",
}
_SUITED_SITUATIONS: Mapping[str, str] = {
    "oncoming": "oncoming",
    "crossing": "yielding",
    "short-gaps": "yielding",
    "close-pass": "merging",
    "blind-spot": "lane-change",
}
"""Attack → situation of the target in which it mostly takes place."""


def out_of_position(row: Mapping[str, Any]) -> str | None:
    """Return the attack for which no vehicle was in position in the episode of *row*; else, or without attack, None."""
    if row.get("attack_kind") is None or row.get("in_position") is not False:
        return None
    return _ACTIONS.get(str(row["attack_kind"]), f"attack as '{row['attack_kind']}'")


def position_lines(rows: Sequence[Mapping[str, Any]], situation: str = "any") -> list[tuple[str, str]]:
    """Return (text, number of episodes and remedy) for each attack for which some *rows* had no vehicle in position.

    Args:
        rows: of ``episodes.parquet``.
        situation: that of the seed scenes, for rows without the column.
    """
    lines = []
    for kind in dict.fromkeys(row.get("attack_kind") for row in rows):
        with_kind = [row for row in rows if row.get("attack_kind") == kind]
        missing = [action for row in with_kind if (action := out_of_position(row)) is not None]
        if missing:
            suited = _SUITED_SITUATIONS.get(str(kind)) if 2 * len(missing) > len(with_kind) else None
            is_new = any(row.get("situation", situation) != suited for row in with_kind)
            remedy = f"; scenes for it: scene.situation={suited}" if suited is not None and is_new else ""
            count = f"in {len(missing)} of {len(with_kind)} episodes{remedy}"
            lines.append((f"no one was in a position to {missing[0]}", count))
    return lines


def plan_lines(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Return (text, number of episodes and the first fault) if some *rows* have plans that no vehicle can drive."""
    checked = [row for row in rows if row.get("implausible_plans") is not None]
    implausible = [row for row in checked if row["implausible_plans"]]
    if not implausible:
        return []
    first = implausible[0]
    where = first.get("key", first["episode"])
    text = f"in {len(implausible)} of {len(checked)} episodes; episode {where}: {first['implausible_plan']}"
    return [("plans that no vehicle can drive", text)]
