"""Reads the results of a run or sweep as rows of one form; a run is treated as a sweep of one cell."""

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
        plan: all jobs.
        episodes: rows with the columns of a sweep's ``episodes``.
        failures: rows of those that failed, with the columns of a sweep's ``failures``.
        missing: number of episodes not yet run; 0 for a run that has ended, even if its log had too few seed scenes.
        of_run: whether it is the folder of a run.
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
        missing_text = f"{counted(self.missing, 'episode')} {'has' if self.missing == 1 else 'have'}"
        return f"{missing_text} not been run; {self.remedy}"

    @property
    def remedy(self) -> str:
        """The command that runs the episodes that are missing or damaged."""
        folder = shlex.quote(str(self.path))
        command = f"run --resume --out {folder}" if self.of_run else f"sweep --resume {folder}"
        return f"advdiff-sumo {command} runs {'it' if self.missing == 1 else 'them'}"

    @property
    def timing(self) -> Rows:
        """Rows of ``timing``; none of a run that is going on."""
        going_on = self.of_run and not RunTables(self.path).path("timing").exists()
        return [] if going_on else read_rows(self.path, "timing")

    def tables(self) -> dict[str, pa.Table]:
        """Return the tables of a run in the form of a sweep's; none for a sweep, whose folder holds them."""
        if not self.of_run:
            return {}
        rows = {"episodes": self.episodes, "failures": self.failures}
        return {name: table_of(table_rows, SWEEP_TABLES[name]) for name, table_rows in rows.items()}


def rows_of_folder(folder: Path) -> FolderRows:
    """Return the rows of the run or sweep in *folder*; a sweep's missing or outdated tables are written again.

    Raises:
        InputError: it holds neither, is damaged, or its nets, demand or logs have changed.
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
    missing = (
        tables_of(store, plan) + plan.episode_count - len(plan.jobs)
    )  # a diverse sweep has not chosen all yet
    return rows_of_sweep(store, plan, missing)


def put_together(folder: Path) -> None:
    """Add finished episodes to the tables of an interrupted run or sweep that lack them.

    Existing tables of a margin's folder stay as they are, since they hold only its neighbouring trials.

    Raises:
        InputError: the folder is damaged, or it has no tables and they cannot be made.
    """
    tables = RunTables(folder)
    has_tables = tables.path("episodes").exists()
    try:
        if tables.is_sweep:
            store = Store.open(folder)
            is_behind = not has_tables or tables_are_behind(store)
            if is_behind and not (folder / SUBJECT).exists():
                tables_of(store, stored_plan(store))
        elif (folder / RUN_PARTS).is_dir():
            RunFolder(folder).catch_up()
    except InputError:  # its nets are missing, or the folder is read-only
        if not has_tables:
            raise


def rows_of_sweep(store: Store, plan: SweepPlan, missing: int) -> FolderRows:
    """Return the rows of the sweep in *store* from its tables, which lack *missing* episodes."""
    rows_of = partial(read_rows, store.path)
    return FolderRows(store.path, plan, rows_of("episodes"), rows_of("failures"), missing)


def _of_run(folder: Path) -> FolderRows:
    run = stored_run(folder, planner=LaneGraphPlanner())  # the planner is not called
    plan, run_folder = plan_run(run), RunFolder(folder)
    stored_episodes = run_folder.episodes()
    jobs = {job.number: job for job in plan.jobs}
    episodes, failures = Rows(), Rows()
    for number, stored_episode in stored_episodes.items():
        job_columns = job_row(jobs[number], plan.cells[0])
        episodes += [job_columns | row for row in _episode_rows(stored_episode, run)]
        if stored_episode.failed is not None:
            failures.append(job_columns | run_folder.failure_row(number, stored_episode.failed))
    has_ended = bool(stored_episodes) and not run_folder.store.path.is_dir()
    missing = 0 if has_ended else len(jobs) - len(stored_episodes)
    return FolderRows(folder, plan, episodes, failures, missing, of_run=True)


def _episode_rows(stored_episode: StoredEpisode, run: Run) -> Iterable[dict[str, Any]]:
    """Yield the row of ``episodes`` of an episode, with the columns of its critical situation."""
    for row in stored_episode.tables["episodes"].to_pylist() if stored_episode.tables else ():
        record = stored_record(stored_episode.tables["states"], row)
        situation_columns = {} if record is None else situation(record, row, run.road)
        stored_columns = {name: row[name] for name in SITUATION_COLUMNS if row.get(name) is not None}
        yield row | situation_columns | stored_columns
