"""What the checks of planners and of policies tell: parts of a contract, drives, planning times."""

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
_KEPT = 4
_REMEMBERS = "what it planned in other scenes changes its plan in the first; keep state in the memory alone"
_Item = TypeVar("_Item")


@dataclass(frozen=True)
class CheckResult:
    """One check.

    Attributes:
        name: what is checked.
        ok: whether it holds; None: it could not be looked at, for what an earlier one found, or is told and not judged.
        detail: what was seen; where it fails, the first problem.
    """

    name: str
    ok: bool | None
    detail: str


def checked_in_worker(
    check: Callable[[], list[CheckResult]], limits: WorkerLimits, hear: Callable[[str], None]
) -> list[CheckResult]:
    """Return what *check* returns, or one verdict on a plug-in that ends the process or never comes back.

    Args:
        check: is called in a process of its own.
        limits: of the worker.
        hear: called with what the plug-in printed.

    Raises:
        InputError: *check* raised it.
    """
    outcome = call_in_worker("check", partial(_as_bytes, check), limits, hear)
    failed = outcome.failed
    if failed is None:
        return [CheckResult(**content) for content in json.loads(outcome.product[0])]
    return [CheckResult(LASTS, False, f"{failed.message}{crashed_at(failed.log_tail)}")]


def _as_bytes(check: Callable[[], list[CheckResult]]) -> bytes:
    return json.dumps([asdict(verdict) for verdict in check()]).encode()


def evenly(items: Sequence[_Item]) -> list[_Item]:
    """Return some of *items*, evenly taken, the first and the last among them."""
    places = np.linspace(0, len(items) - 1, min(_KEPT, len(items))).round().astype(np.int64)
    return [items[k] for k in np.unique(places).tolist()]


def contract_results(
    parts: type[StrEnum], problems: Sequence[tuple[str, Problem]], scenes: Collection[str], remembers: bool
) -> list[CheckResult]:
    """Return the verdict on each of *parts* of a contract.

    Args:
        parts: its first are METHODS, RAISES and FORM, and some later ones NUMBERS, MOTION and REPEATS.
        problems: of all parts, each with the name of its scene.
        scenes: names of all that were looked at.
        remembers: whether the plan in one scene changes with those made in others.
    """
    if remembers:
        problems = [*problems, ("", Problem(parts["REPEATS"], _REMEMBERS))]
    every = tuple(parts)
    not_reached = {
        parts["METHODS"]: every[1:],
        parts["RAISES"]: every[2:],
        parts["FORM"]: every[3:],
        parts["NUMBERS"]: (parts["MOTION"],),
    }
    return [part_result(part, problems, scenes, not_reached) for part in every]


def part_result(
    part: StrEnum,
    problems: Sequence[tuple[str, Problem]],
    scenes: Collection[str],
    not_reached: Mapping[StrEnum, Collection[StrEnum]],
) -> CheckResult:
    """Return the verdict on *part*; a scene counts where nothing before kept it from being looked at.

    Args:
        part: of the contract.
        problems: of all parts, each with the name of its scene.
        scenes: names of all that were looked at.
        not_reached: part → those that cannot be looked at in a scene in which it does not hold.
    """
    mine = [(where, problem) for where, problem in problems if problem.part is part]
    if not mine:
        stopped = {where for where, problem in problems if part in not_reached.get(problem.part, ())}
        looked_at = len(scenes) - len(stopped.intersection(scenes))
        said = counted(looked_at, "scene") if looked_at else "not looked at, see above"
        return CheckResult(part.value, True if looked_at else None, said)
    where, first = min(mine, key=lambda one: one[1].harmless)
    place = f" ({where})" if where else ""
    remedy = f"; {first.remedy}" if first.remedy else ""
    more = f"; {len(mine) - 1} more" if len(mine) > 1 else ""
    return CheckResult(part.value, first.harmless, f"{first.text}{place}{remedy}{more}")


def drives_results(records: Sequence[EpisodeRecord], again: EpisodeRecord) -> list[CheckResult]:
    """Return whether the drives came to their ends, and whether the first one came out the same *again*."""
    failed = [record.failure.message for record in records if record.failure is not None]
    span = sum(record.tracks.dt_s * (record.tracks.steps - 1) for record in records)
    ends = ", ".join(sorted({str(record.end) for record in records}))
    words = failed[0] if failed else f"{counted(len(records), 'episode')}, {span:.0f} s: {ends}"
    first, second = records[0].tracks, again.tracks
    same = first.ids == second.ids and all(
        getattr(first, part).tobytes() == getattr(second, part).tobytes()
        for part in ("xy_m", "yaw_rad", "speed_mps", "valid")
    )
    sentence = "the same bytes" if same else "the same scene and seed led to another drive"
    return [CheckResult(DRIVES, not failed, words), CheckResult(DRIVES_AGAIN, same, sentence)]


def in_time(plans_s: FloatArray, within_ms: float) -> CheckResult:
    """Return the verdict on how long plans took, (plans,) in seconds: the median at most *within_ms*; inf: any."""
    if not len(plans_s):
        return CheckResult(IN_TIME, False, "no plan was made")
    median, late = 1e3 * np.median(plans_s), 1e3 * np.percentile(plans_s, 99)
    allowed = f"; {within_ms:g} ms allowed" if np.isfinite(within_ms) else ""
    words = f"median {median:.1f} ms, 99 % {late:.1f} ms, of {counted(len(plans_s), 'plan')}{allowed}"
    return CheckResult(IN_TIME, bool(median <= within_ms), words)
