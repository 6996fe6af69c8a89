"""Define the tables of a sweep: those of a run, plus columns that identify the episode."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from advdiff_sumo.metrics.columns import EPISODE_COLUMNS, Column
from advdiff_sumo.sim.run_episodes import RunOptions
from advdiff_sumo.sim.run_store import TABLES
from advdiff_sumo.sweep.fingerprint import canonical_json
from advdiff_sumo.sweep.job_plan import Job
from advdiff_sumo.sweep.situation import SITUATION_COLUMNS
from advdiff_sumo.sweep.work import WORKER_COLUMNS


def _text(description: str, *, nullable: bool = False) -> Column:
    return Column("str", "", description, nullable)


JOB_COLUMNS: Mapping[str, Column] = {
    "episode": Column("int64", "", "number of the episode in its sweep", False),
    "key": _text("of its content; advdiff-sumo replay takes it"),
    "scene_key": _text("of its seed scene; the same for all targets and backgrounds"),
    "net": _text("where: shipped nets by name, others by their path"),
    "target": _text("what drove the target"),
    "target_options": _text("its options as JSON"),
    "background": _text("what moved the background vehicles"),
    "background_options": _text("its options as JSON"),
    "attack": _text("the background's option attack, or attacks, or else its name"),
    "root_seed": Column("int64", "", "root of the random numbers", False),
    "number": Column("int64", "", "number of the seed scene on that net with that seed", False),
    "situation": _text("option scene.situation of the seed scene"),
}
FAILURE_COLUMNS: Mapping[str, Column] = {
    **{name: JOB_COLUMNS[name] for name in JOB_COLUMNS},
    "kind": _text("why, as a word; see sweeps.md"),
    "message": _text("the same as a sentence"),
    "log_tail": _text("what the worker said last, or where the planner raised"),
    "attempts": Column("int64", "", "how often it was tried", False),
    "command": _text("repeats just this episode"),
}
RUN_FAILURE_COLUMNS: Mapping[str, Column] = {
    "episode": Column("int64", "", "number of the episode in its run", False),
    **{name: FAILURE_COLUMNS[name] for name in ("kind", "message", "log_tail", "attempts", "command")},
}
SWEEP_TABLES: Mapping[str, Mapping[str, Column]] = {
    "episodes": {
        **JOB_COLUMNS,
        **{name: column for name, column in EPISODE_COLUMNS.items() if name != "episode"},
        **SITUATION_COLUMNS,
    },
    "collisions": TABLES["collisions"],
    "states": TABLES["states"],
    "plans": TABLES["plans"],
    "unattacked": TABLES["unattacked"],
    "signals": TABLES["signals"],
    "timing": {**TABLES["timing"], **WORKER_COLUMNS},
    "failures": FAILURE_COLUMNS,
}


def described_columns() -> dict[str, str]:
    """Return ``table.column`` → what it holds, for all tables of runs and sweeps."""
    return {
        f"{table}.{name}": column.description
        + "; may be empty" * (column.nullable and "empty" not in column.description)
        for table, columns in SWEEP_TABLES.items()
        for name, column in columns.items()
    }


def job_row(job: Job, options: RunOptions) -> dict[str, Any]:
    """Return the values of ``JOB_COLUMNS`` for *job*, whose run has *options*."""
    background_options = options.background_options
    return {
        "episode": job.index,
        "key": job.key,
        "scene_key": job.scene_key,
        "net": options.net,
        "target": options.target,
        "target_options": canonical_json(options.target_options),
        "background": options.background,
        "background_options": canonical_json(background_options),
        "attack": _word(
            background_options.get("attack", background_options.get("attacks", options.background))
        ),
        "root_seed": options.seed,
        "number": job.number,
        "situation": options.scene.situation,
    }


def _word(value: Any) -> str:
    """Return a value of an option as one word."""
    return "+".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
