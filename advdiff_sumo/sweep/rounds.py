"""Choose the episodes of a diverse sweep in rounds."""

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
_ROUND_COUNT, _MIN_ROUND_SIZE = 10, 8


def stored_plan(store: Store, *, drives: bool = False) -> SweepPlan:
    """Return the plan of the sweep in *store*; for a diverse sweep, with the episodes chosen so far.

    Args:
        store: folder of the sweep.
        drives: whether its episodes are to be run again, so that its planners must be available.

    Raises:
        InputError: the folder is damaged, or its nets have changed.
    """
    plan = plan_sweep(store.spec(), drives=drives)
    store.must_match(plan.keys)
    return chosen_so_far(plan, store)


def chosen_so_far(plan: SweepPlan, store: Store | None) -> SweepPlan:
    """Return *plan* with the episodes chosen so far, in that order; *plan* itself if the sweep is not diverse.

    Raises:
        FileError: ``rounds.json`` is damaged.
    """
    if not plan.spec.diverse:
        return plan
    return _with_episodes(plan, [] if store is None else _chosen_keys(store))


def rounds(plan: SweepPlan, store: Store, most: int) -> Iterator[tuple[SweepPlan, tuple[Job, ...]]]:
    """Yield, for each round, the plan with all chosen episodes, and the episodes to run, until *most* are chosen.

    All results of a round must be in *store* before the next one is requested.
    """
    keys = _chosen_keys(store)
    size = max(plan.episode_count // _ROUND_COUNT, _MIN_ROUND_SIZE)
    row_by_key: dict[str, Row | None] = {}
    while len(keys) < most:
        # an interrupted round is completed with the results that it was chosen by
        round_start = len(keys) - len(keys) % size
        row_by_key |= {key: _row(plan, store, key) for key in keys[:round_start] if key not in row_by_key}
        chosen = _next_keys(plan, row_by_key, min(size, plan.episode_count - round_start))
        new_keys = [key for key in chosen if key not in keys][: min(most, round_start + size) - len(keys)]
        if not new_keys:
            return
        keys = [*keys, *new_keys]
        write_whole(store.path / ROUNDS, json.dumps({"episodes": keys}, indent=1).encode())
        present = _with_episodes(plan, keys)
        yield present, present.jobs[-len(new_keys) :]


def _next_keys(plan: SweepPlan, row_by_key: Mapping[str, Row | None], count: int) -> list[str]:
    """Return the keys of the next *count* episodes, given the rows *row_by_key* of the earlier ones."""
    results = ((_candidate(plan, plan.by_key[key]), row) for key, row in row_by_key.items())
    remaining = [_candidate(plan, job) for job in plan.jobs if job.key not in row_by_key]
    return Steering.after(results).pick(remaining, count)


def _row(plan: SweepPlan, store: Store, key: str) -> Row | None:
    """Return the row of a finished episode; None if it has none."""
    row = store.episode_row(key)
    job = plan.by_key[key]
    return None if row is None else {**row, **job_row(job, plan.options(job))}


def _candidate(plan: SweepPlan, job: Job) -> Candidate:
    """Return *job* as a candidate for the next round."""
    row = job_row(job, plan.options(job))
    target = f"{row['target']} {row['target_options']}"
    return Candidate(job.key, target, row["net"], row["attack"], job.scene_key)


def _with_episodes(plan: SweepPlan, keys: list[str]) -> SweepPlan:
    """Return *plan* with the episodes *keys* only, in this order."""
    jobs = (plan.by_key[key] for key in keys)
    return replace(plan, jobs=tuple(replace(job, index=k) for k, job in enumerate(jobs)))


def _chosen_keys(store: Store) -> list[str]:
    """Return the keys in ``rounds.json``; [] if there is no such file."""
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
