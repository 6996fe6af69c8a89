"""The rounds of a diverse sweep: what was chosen so far, and what comes next."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace

from advdiff_sumo.core.errors import FileError
from advdiff_sumo.sweep.job_plan import Job, SweepPlan, plan_sweep
from advdiff_sumo.sweep.steering import Candidate, Row, Steering
from advdiff_sumo.sweep.sweep_columns import job_row
from advdiff_sumo.sweep.sweep_files import write_whole
from advdiff_sumo.sweep.sweep_store import Store

ROUNDS = "rounds.json"
_ROUNDS, _LEAST = 10, 8


def stored_plan(store: Store, *, drives: bool = False) -> SweepPlan:
    """Return the plan of the sweep in *store*; of a diverse one, the episodes that have been chosen.

    Args:
        store: its folder.
        drives: its episodes are to be run again, so that its planners must be at hand.

    Raises:
        InputError: it is damaged, or its nets are no longer what they were.
    """
    plan = plan_sweep(store.spec(), drives=drives)
    store.must_match(plan.keys)
    return chosen_so_far(plan, store)


def chosen_so_far(plan: SweepPlan, store: Store | None) -> SweepPlan:
    """Return *plan* with those of its episodes that have been chosen, in that order; itself where it is not diverse.

    Raises:
        FileError: ``rounds.json`` is damaged.
    """
    if not plan.spec.diverse:
        return plan
    return _with(plan, [] if store is None else _read(store))


def rounds(plan: SweepPlan, store: Store, most: int) -> Iterator[tuple[SweepPlan, tuple[Job, ...]]]:
    """Yield what has been chosen and what of it is to be run, a round at a time, until *most* episodes are chosen.

    What a round is chosen by must be in *store* when the next one is asked for.
    """
    keys = _read(store)
    size = max(plan.wanted // _ROUNDS, _LEAST)
    known: dict[str, Row | None] = {}
    while len(keys) < most:
        begun = len(keys) - len(keys) % size  # a round that was cut short is filled by what it began with
        known |= {key: _row(plan, store, key) for key in keys[:begun] if key not in known}
        chosen = _next(plan, known, min(size, plan.wanted - begun))
        fresh = [key for key in chosen if key not in keys][: min(most, begun + size) - len(keys)]
        if not fresh:
            return
        keys = [*keys, *fresh]
        write_whole(store.path / ROUNDS, json.dumps({"episodes": keys}, indent=1).encode())
        present = _with(plan, keys)
        yield present, present.jobs[-len(fresh) :]


def _next(plan: SweepPlan, known: Mapping[str, Row | None], count: int) -> list[str]:
    """Return the *count* episodes that come after those with the rows *known*."""
    results = ((_candidate(plan, plan.by_key[key]), row) for key, row in known.items())
    left = [_candidate(plan, job) for job in plan.jobs if job.key not in known]
    return Steering.after(results).pick(left, count)


def _row(plan: SweepPlan, store: Store, key: str) -> Row | None:
    """Return the row of a finished episode; None where it has none."""
    row = store.glance(key)
    job = plan.by_key[key]
    return None if row is None else {**row, **job_row(job, plan.options(job))}


def _candidate(plan: SweepPlan, job: Job) -> Candidate:
    row = job_row(job, plan.options(job))
    target = f"{row['target']} {row['target_options']}"
    return Candidate(job.key, target, row["net"], row["attack"], job.scene_key)


def _with(plan: SweepPlan, keys: list[str]) -> SweepPlan:
    jobs = (plan.by_key[key] for key in keys)
    return replace(plan, jobs=tuple(replace(job, index=k) for k, job in enumerate(jobs)))


def _read(store: Store) -> list[str]:
    path = store.path / ROUNDS
    try:
        keys = json.loads(path.read_text(encoding="utf-8"))["episodes"]
    except FileNotFoundError:
        return []
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FileError(
            path, f"is damaged ({error})", "delete it; --resume makes it again from the results"
        ) from None
    return [str(key) for key in keys]
