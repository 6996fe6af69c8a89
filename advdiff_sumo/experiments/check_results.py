"""Results of checking a planner or policy: the parts of its contract, its episodes and its planning times."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from functools import partial
from typing import TypeVar

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.contract import Problem
from advdiff_sumo.core.plug_in_source import crashed_at
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.wording import counted
from advdiff_sumo.sweep.executors import call_in_worker
from advdiff_sumo.sweep.tasks import WorkerLimits

DRIVES, DRIVES_AGAIN, IN_TIME = "drives", "drives it again", "in time"
LASTS = "comes to its end"
_SAMPLE_SIZE = 4
_LEAKS_STATE = "what it planned in other scenes changes its plan in the first; keep state in the memory alone"
_Item = TypeVar("_Item")


@dataclass(frozen=True)
class CheckResult:
    """One check.

    Attributes:
        name: what is checked.
        ok: whether it holds. None: an earlier problem prevented the check, or the result is for information only.
        detail: what was found; if it fails, the first problem.
    """

    name: str
    ok: bool | None
    detail: str


def checked_in_worker(
    check: Callable[[], list[CheckResult]], limits: WorkerLimits, on_output: Callable[[str], None]
) -> list[CheckResult]:
    """Run *check* in a process of its own and return its results.

    If the plug-in ends the process or does not return in time, the only result says so.

    Args:
        check: runs the checks.
        limits: of the worker process.
        on_output: called with what the plug-in printed.

    Raises:
        InputError: *check* raised it.
    """
    outcome = call_in_worker("check", partial(_as_bytes, check), limits, on_output)
    failed = outcome.failed
    if failed is None:
        return [CheckResult(**content) for content in json.loads(outcome.product[0])]
    return [CheckResult(LASTS, False, f"{failed.message}{crashed_at(failed.log_tail)}")]


def _as_bytes(check: Callable[[], list[CheckResult]]) -> bytes:
    return json.dumps([asdict(verdict) for verdict in check()]).encode()


def evenly_spaced(items: Sequence[_Item]) -> list[_Item]:
    """Return at most ``_SAMPLE_SIZE`` evenly spaced *items*, including the first and the last."""
    indices = np.linspace(0, len(items) - 1, min(_SAMPLE_SIZE, len(items))).round().astype(np.int64)
    return [items[k] for k in np.unique(indices).tolist()]


def contract_results(
    parts: type[StrEnum], problems: Sequence[tuple[str, Problem]], scenes: Collection[str], remembers: bool
) -> list[CheckResult]:
    """Return the result of each of the *parts* of a contract.

    Args:
        parts: METHODS, RAISES and FORM come first; NUMBERS, MOTION and REPEATS are among the later ones.
        problems: of all parts, each with the name of its scene.
        scenes: names of all checked scenes.
        remembers: whether plans made in other scenes change the plan in the first scene.
    """
    if remembers:
        problems = [*problems, ("", Problem(parts["REPEATS"], _LEAKS_STATE))]
    all_parts = tuple(parts)
    not_reached = {
        parts["METHODS"]: all_parts[1:],
        parts["RAISES"]: all_parts[2:],
        parts["FORM"]: all_parts[3:],
        parts["NUMBERS"]: (parts["MOTION"],),
    }
    return [part_result(part, problems, scenes, not_reached) for part in all_parts]


def part_result(
    part: StrEnum,
    problems: Sequence[tuple[str, Problem]],
    scenes: Collection[str],
    not_reached: Mapping[StrEnum, Collection[StrEnum]],
) -> CheckResult:
    """Return the result of *part*. Scenes in which an earlier problem prevented its check do not count.

    Args:
        part: of the contract.
        problems: of all parts, each with the name of its scene.
        scenes: names of all checked scenes.
        not_reached: part → parts that cannot be checked in a scene in which it fails.
    """
    part_problems = [(where, problem) for where, problem in problems if problem.part is part]
    if not part_problems:
        stopped = {where for where, problem in problems if part in not_reached.get(problem.part, ())}
        looked_at = len(scenes) - len(stopped.intersection(scenes))
        detail = counted(looked_at, "scene") if looked_at else "not looked at, see above"
        return CheckResult(part.value, True if looked_at else None, detail)
    where, first = min(part_problems, key=lambda named: named[1].harmless)
    scene_text = f" ({where})" if where else ""
    remedy = f"; {first.remedy}" if first.remedy else ""
    more_text = f"; {len(part_problems) - 1} more" if len(part_problems) > 1 else ""
    return CheckResult(part.value, first.harmless, f"{first.text}{scene_text}{remedy}{more_text}")


def drives_results(records: Sequence[EpisodeRecord], repeated: EpisodeRecord) -> list[CheckResult]:
    """Return whether all episodes finished, and whether the *repeated* first one gave the same bytes."""
    messages = [record.failure.message for record in records if record.failure is not None]
    duration_s = sum(record.tracks.dt_s * (record.tracks.steps - 1) for record in records)
    ends = ", ".join(sorted({str(record.end) for record in records}))
    detail = messages[0] if messages else f"{counted(len(records), 'episode')}, {duration_s:.0f} s: {ends}"
    first, second = records[0].tracks, repeated.tracks
    is_same = first.ids == second.ids and all(
        getattr(first, part).tobytes() == getattr(second, part).tobytes()
        for part in ("xy_m", "yaw_rad", "speed_mps", "valid")
    )
    until = " until the failure" if records[0].failure is not None else ""
    comparison = f"the same bytes{until}" if is_same else "the same scene and seed led to another drive"
    return [CheckResult(DRIVES, not messages, detail), CheckResult(DRIVES_AGAIN, is_same, comparison)]


def in_time(plans_s: FloatArray, within_ms: float) -> CheckResult:
    """Return whether the median of the planning times (plans,) in s is at most *within_ms*; inf: no limit."""
    if not len(plans_s):
        return CheckResult(IN_TIME, False, "no plan was made")
    median, percentile_99 = 1e3 * np.median(plans_s), 1e3 * np.percentile(plans_s, 99)
    limit = f"; {within_ms:g} ms allowed" if np.isfinite(within_ms) else ""
    detail = f"median {median:.1f} ms, 99 % {percentile_99:.1f} ms, of {counted(len(plans_s), 'plan')}{limit}"
    return CheckResult(IN_TIME, bool(median <= within_ms), detail)
