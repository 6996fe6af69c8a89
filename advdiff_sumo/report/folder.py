"""Reads the folder of a finished run or sweep; no other part of the report touches its files."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import pyarrow as pa

from advdiff_sumo.core.errors import FileError
from advdiff_sumo.core.wording import in_ranges
from advdiff_sumo.data.episode_states import STATE_COLUMNS, EpisodeStates, states_of
from advdiff_sumo.data.run_tables import RUN_PARTS, RunTables
from advdiff_sumo.metrics.arrow_tables import upgraded_table
from advdiff_sumo.metrics.columns import COLLISION_COLUMNS, EPISODE_COLUMNS, LATER_COLUMNS, Column
from advdiff_sumo.metrics.severity import worst_first
from advdiff_sumo.report.plans import PLAN_COLUMNS, Planned, plans_of

Row: TypeAlias = Mapping[str, Any]

_OPTION_TABLES = ("target_options", "background_options")

#: Columns that only a sweep's episodes have; in a run they get the values of its options.
JOB_COLUMNS = (
    *("key", "scene_key", "net", "target", "target_options"),
    *("background", "background_options", "attack", "root_seed", "situation"),
    *("approach", "attacker_manoeuvre", "target_manoeuvre"),
)


@dataclass(frozen=True)
class FinishedRun:
    """The content of the folder of a run or sweep, without the states, which are read for one episode at a time.

    Attributes:
        folder: the folder.
        settings: content of ``run.toml`` or ``sweep.toml``.
        is_sweep: whether it is a sweep.
        episodes: rows of ``episodes.parquet`` by episode, with ``JOB_COLUMNS``.
        collisions: rows of ``collisions.parquet``.
        is_part: whether it is restricted to one episode.
    """

    folder: Path
    settings: Mapping[str, Any]
    is_sweep: bool
    episodes: tuple[Row, ...]
    collisions: tuple[Row, ...]
    is_part: bool = False

    @staticmethod
    def read(folder: Path) -> FinishedRun:
        """Read the folder of a finished or interrupted run or sweep.

        Raises:
            FileError: one of its files is missing, damaged or of another version.
        """
        tables = RunTables(folder)
        settings = tables.settings()
        episodes = _table_rows(tables, "episodes", EPISODE_COLUMNS, JOB_COLUMNS)
        collisions = _table_rows(tables, "collisions", COLLISION_COLUMNS)
        tables.columns("states", STATE_COLUMNS)
        options = _options(settings)
        episodes.sort(key=lambda row: int(row["episode"]))
        rows = [_with_job_columns(row, options) for row in episodes]
        return FinishedRun(folder, settings, tables.is_sweep, tuple(rows), tuple(collisions))

    @property
    def _tables(self) -> RunTables:
        return RunTables(self.folder)

    @property
    def options(self) -> Mapping[str, Any]:
        """The options of the run or sweep; empty if there are none."""
        return _options(self.settings)

    @property
    def planned(self) -> int | None:
        """Number of episodes asked for; None for a sweep, a single or repeated episode, or if it is unknown."""
        planned = self.options.get("episodes")
        is_single_episode = self.is_part or self.repeated is not None
        is_known = isinstance(planned, int) and not self.is_sweep and not is_single_episode
        return planned if is_known else None

    @property
    def repeated(self) -> int | None:
        """Number of the episode that this folder repeats; None for a run or sweep."""
        number = self.settings.get("run", {}).get("repeats")
        return number if isinstance(number, int) else None

    @property
    def interrupted(self) -> bool:
        """Whether a run was interrupted: the files of its single episodes still exist."""
        return not self.is_sweep and (self.folder / RUN_PARTS).is_dir()

    @cached_property
    def log_tails(self) -> Mapping[int, str]:
        """Episode → last lines of its log if it failed, or where the planner raised an error."""
        if not self._tables.path("failures").exists():
            return {}
        rows = self._tables.rows("failures", ("episode", "log_tail")).to_pylist()
        return {int(row["episode"]): row["log_tail"].strip() for row in rows if row["log_tail"]}

    @cached_property
    def unstarted(self) -> int:
        """Number of episodes that failed before they had a row; 0 for a single episode."""
        return 0 if self.is_part else len(self._tables.unstarted(self.episodes))

    def only(self, episode: int) -> FinishedRun:
        """Return the run restricted to *episode*.

        Raises:
            FileError: there is no such episode.
        """
        rows, collisions = (self.row(episode),), self.collisions_of(episode)
        return replace(self, episodes=rows, collisions=collisions, is_part=True)

    def row(self, episode: int) -> Row:
        """Return the row of *episode*.

        Raises:
            FileError: there is no such episode.
        """
        for row in self.episodes:
            if row["episode"] == episode:
                return row
        raise FileError(self.folder, f"has no episode {episode}", f"it has {self.numbers_text}")

    @property
    def numbers_text(self) -> str:
        """Numbers of the episodes for a sentence: "none", "0" or "0 to 3"."""
        return in_ranges([int(row["episode"]) for row in self.episodes]) if self.episodes else "none"

    def worst_row(self) -> Row:
        """Return the row of the episode that comes first in a report.

        Raises:
            FileError: there is no episode.
        """
        if not self.episodes:
            raise FileError(
                self.folder,
                "has no episode",
                "give the folder of a finished run, or go on with this one by --resume",
            )
        return worst_first(self.episodes)[0]

    def collisions_of(self, episode: int) -> tuple[Row, ...]:
        """Return the collisions of *episode* in order of time."""
        return tuple(row for row in self.collisions if row["episode"] == episode)

    def states(self, episode: int) -> EpisodeStates | None:
        """Return the states of *episode*; None if it failed before its first instant.

        Raises:
            FileError: the states are damaged.
        """
        return self._states("states", self._tables.columns("states"), episode)

    def natural(self, episode: int) -> EpisodeStates | None:
        """Return the states in the seed scene of *episode* without attack; None if they were not recorded.

        Raises:
            FileError: the table is damaged.
        """
        if not self._tables.path("unattacked").exists():
            return None
        return self._states("unattacked", self._tables.columns("unattacked", STATE_COLUMNS), episode)

    def signals(self, episode: int) -> pa.Table | None:
        """Return the states of the traffic lights in *episode*; None if the folder has no such table.

        Raises:
            FileError: the table is damaged.
        """
        if not self._tables.path("signals").exists():
            return None
        return self._tables.rows("signals", episode=episode)

    def _states(self, table: str, present: set[str], episode: int) -> EpisodeStates | None:
        columns = [*STATE_COLUMNS, *({"controller"} & present)]
        return states_of(self._tables.rows(table, columns, episode))

    def plans(self, episode: int) -> tuple[Planned, ...]:
        """Return the plans of *episode*; none if the folder has no such table.

        Raises:
            FileError: the plans are damaged.
        """
        if not self._tables.path("plans").exists():
            return ()
        self._tables.columns("plans", ("episode", *PLAN_COLUMNS))
        return plans_of(self._tables.rows("plans", PLAN_COLUMNS, episode))

    def logs(self) -> Iterator[tuple[str, str]]:
        """Yield (net, root of the driving log) of all nets whose seed scenes came from a log."""
        options = self.options
        grid = options.get("grid") or {}
        for entry in (options, *grid.get("nets", ()), *options.get("cases", ())):
            if isinstance(entry, Mapping) and entry.get("scenes"):
                yield str(entry.get("net", "")), str(entry["scenes"])


def _options(settings: Mapping[str, Any]) -> Mapping[str, Any]:
    options = settings.get("sweep", settings.get("options", {}))
    return options if isinstance(options, Mapping) else {}


def _with_job_columns(row: Row, options: Mapping[str, Any]) -> Row:
    """Return *row*, with the run's options if it lacks the columns of a sweep."""
    if "target" in row:
        return row
    job_columns = {name: str(options.get(name, "?")) for name in ("net", "target", "background")}
    job_columns |= {name: json.dumps(options.get(name) or {}, default=str) for name in _OPTION_TABLES}
    keys = {"key": "", "scene_key": "", "root_seed": options.get("seed")}
    return {**row, **job_columns, "attack": job_columns["background"], **keys}


def _table_rows(
    tables: RunTables, name: str, columns: Mapping[str, Column], optional: Iterable[str] = ()
) -> list[dict[str, Any]]:
    """Return *columns* of a table and those of *optional* that it has.

    Columns that older versions did not write are empty.
    """
    present = tables.columns(name, [column for column in columns if column not in LATER_COLUMNS])
    read_columns = [column for column in (*columns, *optional) if column in present]
    rows: list[dict[str, Any]] = upgraded_table(tables.rows(name, read_columns), columns).to_pylist()
    return rows
