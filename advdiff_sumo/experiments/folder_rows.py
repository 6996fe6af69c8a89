"""What a run or sweep came to, as rows of one form: a run is a sweep of one cell."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa

from advdiff_sumo.core.errors import FileError, InputError
from advdiff_sumo.core.wording import counted
from advdiff_sumo.data.run_tables import RUN_PARTS, RUN_SETTINGS, RunTables
from advdiff_sumo.metrics.arrow_tables import table_of
from advdiff_sumo.planners.lane_graph import LaneGraphPlanner
from advdiff_sumo.report.margin_table import SUBJECT
from advdiff_sumo.report.stored_record import stored_record
from advdiff_sumo.sim.run_episodes import Run
from advdiff_sumo.sweep.consolidate import read_rows, tables_are_behind, tables_of
from advdiff_sumo.sweep.job_plan import SweepPlan, plan_run
from advdiff_sumo.sweep.rounds import stored_plan
from advdiff_sumo.sweep.run_engine import stored_run
from advdiff_sumo.sweep.run_folder import RunFolder
from advdiff_sumo.sweep.situation import SITUATION_COLUMNS, situation
from advdiff_sumo.sweep.stored_episode import StoredEpisode
from advdiff_sumo.sweep.sweep_columns import SWEEP_TABLES, job_row
from advdiff_sumo.sweep.sweep_store import Store

Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class FolderRows:
    """The episodes of a run or sweep, finished or not.

    Attributes:
        path: the folder.
        plan: what was asked.
        episodes: rows with the columns of a sweep's ``episodes``.
        failures: rows of those that failed, with the columns of a sweep's ``failures``.
        missing: how many have not been run; none of a run that has ended, also where its log had fewer seed scenes.
        of_run: whether it is a run's.
    """

    path: Path
    plan: SweepPlan
    episodes: Rows
    failures: Rows
    missing: int
    of_run: bool = False

    @property
    def how_to_go_on(self) -> str:
        """How many episodes are missing, and the command that runs them."""
        folder = shlex.quote(str(self.path))
        command = f"run --resume --out {folder}" if self.of_run else f"sweep --resume {folder}"
        lacking = f"{counted(self.missing, 'episode')} {'has' if self.missing == 1 else 'have'}"
        return f"{lacking} not been run; advdiff-sumo {command} runs {'it' if self.missing == 1 else 'them'}"

    @property
    def timing(self) -> Rows:
        """Rows of ``timing``; none of a run that is going on."""
        going_on = self.of_run and not RunTables(self.path).path("timing").exists()
        return [] if going_on else read_rows(self.path, "timing")

    def tables(self) -> dict[str, pa.Table]:
        """Return the tables that the folder itself does not hold in a sweep's form."""
        if not self.of_run:
            return {}
        rows = {"episodes": self.episodes, "failures": self.failures}
        return {name: table_of(some, SWEEP_TABLES[name]) for name, some in rows.items()}


def rows_of_folder(folder: Path) -> FolderRows:
    """Return the rows of the run or sweep in *folder*; a sweep's tables are mended where they are missing or behind.

    Raises:
        InputError: it holds neither, is damaged, or its nets, demand or logs are no longer what they were.
    """
    tables = RunTables(folder)
    if not tables.is_sweep and (folder / RUN_SETTINGS).is_file():
        return _of_run(folder)
    if not tables.is_sweep:
        raise FileError(
            folder, "holds no sweep and no run", "give the folder that advdiff-sumo sweep or run wrote"
        )
    store = Store.open(folder)
    plan = stored_plan(store)
    missing = tables_of(store, plan) + plan.wanted - len(plan.jobs)  # a diverse sweep has not chosen all
    return rows_of_sweep(store, plan, missing)


def put_together(folder: Path) -> None:
    """Put the tables of an interrupted run or sweep together where episodes have finished that are not in them.

    A margin's folder stays as it is: its tables are of the trials that it names.

    Raises:
        InputError: the folder is damaged, or has no tables and they cannot be put together.
    """
    tables = RunTables(folder)
    are_there = tables.path("episodes").exists()
    try:
        if tables.is_sweep:
            store = Store.open(folder)
            behind = not are_there or tables_are_behind(store)
            if behind and not (folder / SUBJECT).exists():
                tables_of(store, stored_plan(store))
        elif (folder / RUN_PARTS).is_dir():
            RunFolder(folder).catch_up()
    except InputError:  # its nets are gone, or nothing can be written there
        if not are_there:
            raise


def rows_of_sweep(store: Store, plan: SweepPlan, missing: int) -> FolderRows:
    """Return the rows of the sweep in *store*, whose tables are there and lack *missing* episodes."""
    read = partial(read_rows, store.path)
    return FolderRows(store.path, plan, read("episodes"), read("failures"), missing)


def _of_run(folder: Path) -> FolderRows:
    run = stored_run(folder, planner=LaneGraphPlanner())  # nothing is driven
    plan, begun = plan_run(run), RunFolder(folder)
    parts = begun.episodes()
    jobs = {job.number: job for job in plan.jobs}
    episodes, failures = Rows(), Rows()
    for number, part in parts.items():
        own = job_row(jobs[number], plan.cells[0])
        episodes += [own | row for row in _episode_rows(part, run)]
        if part.failed is not None:
            failures.append(own | begun.failure_row(number, part.failed))
    ended = bool(parts) and not begun.store.path.is_dir()
    missing = 0 if ended else len(jobs) - len(parts)
    return FolderRows(folder, plan, episodes, failures, missing, of_run=True)


def _episode_rows(part: StoredEpisode, run: Run) -> Iterable[dict[str, Any]]:
    """Yield the row of ``episodes`` of an episode, with where and how it became critical."""
    for row in part.tables["episodes"].to_pylist() if part.tables else ():
        record = stored_record(part.tables["states"], row)
        found = {} if record is None else situation(record, row, run.road)
        stored = {name: row[name] for name in SITUATION_COLUMNS if row.get(name) is not None}
        yield row | found | stored
