"""Adds verdicts to the folder of a finished run or sweep."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from advdiff_sumo.core.errors import ConfigError, FileError, InputError, is_disk_full, os_reason
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.whole_file import arrow_path, whole_file
from advdiff_sumo.core.worker_pool import futures_of
from advdiff_sumo.data.run_tables import RUN_SETTINGS, SWEEP_SETTINGS, RunTables
from advdiff_sumo.experiments.folder_rows import put_together
from advdiff_sumo.experiments.solvable import solvable
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.arrow_tables import schema_of, table_of
from advdiff_sumo.metrics.breaches import BreachKind
from advdiff_sumo.metrics.breaches.junction_rules import ON_RED
from advdiff_sumo.metrics.columns import (
    COLLISION_COLUMNS,
    CRITICAL_COLUMNS,
    EPISODE_COLUMNS,
    OFFENCE_COLUMNS,
    VERDICT_COLUMNS,
    Column,
)
from advdiff_sumo.metrics.metric_rows import collision_rows, episode_row
from advdiff_sumo.metrics.summary import summarise
from advdiff_sumo.planners.lane_graph import LaneGraphPlanner
from advdiff_sumo.report.nets import net_path
from advdiff_sumo.report.stored_record import stored_record
from advdiff_sumo.sweep.consolidate import consolidate
from advdiff_sumo.sweep.job_plan import SweepPlan, run_key
from advdiff_sumo.sweep.rounds import stored_plan
from advdiff_sumo.sweep.run_engine import stored_run
from advdiff_sumo.sweep.run_folder import RunFolder
from advdiff_sumo.sweep.situation import SITUATION_COLUMNS
from advdiff_sumo.sweep.stored_episode import StoredEpisode
from advdiff_sumo.sweep.sweep_columns import SWEEP_TABLES
from advdiff_sumo.sweep.sweep_store import Store

#: Up to this many episodes are judged in this process, unless the clairvoyant search is asked for.
_IN_PROCESS_EPISODES = 16
#: Columns of an episode's row that are replaced; the others stay, as they were measured within the simulation.
_EPISODE_VERDICTS = (
    *("collision_type", "at_fault", "fault_reason"),
    *VERDICT_COLUMNS,
    *CRITICAL_COLUMNS,
)
_COLLISION_VERDICTS = ("type", "at_fault", "fault_reason", *VERDICT_COLUMNS)


@dataclass(frozen=True)
class EpisodeTables:
    """The stored tables of one episode.

    Attributes:
        net: file of the net.
        row: of ``episodes``.
        states: rows of ``states``.
        collisions: rows of ``collisions``.
        signals: rows of ``signals``; None in a folder of an earlier version.
    """

    net: Path
    row: Mapping[str, Any]
    states: pa.Table
    collisions: Sequence[Mapping[str, Any]]
    signals: pa.Table | None

    def record(self) -> EpisodeRecord | None:
        """Return the record of the episode; None without a target."""
        return stored_record(self.states, self.row, self.signals)

    def road(self) -> RoadMap:
        """Return the net, from a cache if possible.

        Raises:
            NetError: it cannot be read.
        """
        return _road(self.net)


@dataclass(frozen=True)
class JudgedRows:
    """The rows of one episode with their verdicts.

    Attributes:
        episode: of ``episodes``.
        collisions: of ``collisions``.
    """

    episode: dict[str, Any]
    collisions: list[dict[str, Any]]


@dataclass(frozen=True)
class Judging:
    """A folder whose episodes are to be judged.

    Attributes:
        count: number of its episodes.
        episodes: yields them, each with its key.
        keep: stores the judged rows of the episode with this key.
        finish: writes the tables, at the end.
        doubt: why the present nets may differ from those of the episodes; "": they are the same.
    """

    count: int
    episodes: Callable[[], Iterator[tuple[str, EpisodeTables]]]
    keep: Callable[[str, JudgedRows], None]
    finish: Callable[[], object]
    doubt: str = ""

    def judge(
        self, workers: int, on_progress: Callable[[], None], search: bool = False
    ) -> list[dict[str, Any]]:
        """Judge all episodes and return their rows.

        Args:
            workers: number of processes; a few episodes are judged in this process.
            on_progress: called after each episode.
            search: run the clairvoyant search for each collision of the target; False: its stored result is kept.

        Raises:
            InputError: a table or net cannot be read, or the results cannot be written.
        """
        rows: list[tuple[str, dict[str, Any]]] = []
        is_small = self.count <= _IN_PROCESS_EPISODES and not search
        for key, judged in _judged_episodes(self.episodes(), 1 if is_small else workers, search):
            self.keep(key, judged)
            rows.append((key, judged.episode))
            on_progress()
        self.finish()
        return [row for _, row in sorted(rows, key=lambda pair: int(pair[1]["episode"]))]


def open_judging(folder: Path) -> Judging:
    """Open the folder of a finished or interrupted run or sweep.

    Raises:
        InputError: it is neither, or is damaged.
    """
    if not (folder / SWEEP_SETTINGS).exists():
        put_together(folder)
        return replace(_judge_tables(folder, EPISODE_COLUMNS), doubt=_doubt_about_net(folder))
    store = Store.open(folder)
    try:
        plan = stored_plan(store)
    except ConfigError as error:  # of an earlier version, or its nets have changed
        consequence = "verdicts go into its tables alone, until results puts these together again"
        return replace(_judge_tables(folder, SWEEP_TABLES["episodes"]), doubt=f"{error}; {consequence}")
    return _judge_sweep(store, plan)


def _doubt_about_net(folder: Path) -> str:
    """Return why the present net may differ from that of the run in *folder*; "": it is the same."""
    try:
        stored_run(folder, planner=LaneGraphPlanner())  # the planner is not called
    except InputError as error:  # of an earlier version, or its net has changed
        return str(error)
    return ""


def _judge_tables(folder: Path, columns: Mapping[str, Column]) -> Judging:
    """Return a judging of the tables in *folder*; ``episodes`` is written with *columns*."""
    tables = RunTables(folder)
    if not (tables.is_sweep or (folder / RUN_SETTINGS).exists()):
        raise FileError(folder, "holds no run and no sweep", "give a finished one, or --net with a scenario")
    net = str(tables.settings().get("options", {}).get("net", ""))
    rows = {int(row["episode"]): row for row in tables.rows("episodes").to_pylist()}
    collisions: dict[int, list[dict[str, Any]]] = {number: [] for number in rows}
    for row in tables.rows("collisions").to_pylist():
        collisions[int(row["episode"])].append(row)

    def episodes() -> Iterator[tuple[str, EpisodeTables]]:
        signals = _by_episode(tables.rows("signals")) if tables.path("signals").exists() else None
        states = _by_episode(tables.rows("states"))
        for number, row in rows.items():
            if number in states:
                lights = None if signals is None else signals.get(number)
                net_file = _found_net(str(row.get("net") or net), folder)
                yield str(number), EpisodeTables(net_file, row, states[number], collisions[number], lights)

    def keep(key: str, judged: JudgedRows) -> None:
        rows[int(key)], collisions[int(key)] = judged.episode, judged.collisions
        if not tables.is_sweep:  # an interrupted run is resumed from the stored episodes
            _keep_in_part(RunFolder(folder).store, run_key(int(key)), judged)

    def finish() -> None:
        _write_table(tables.path("episodes"), list(rows.values()), columns)
        all_collisions = [row for episode_rows in collisions.values() for row in episode_rows]
        _write_table(tables.path("collisions"), all_collisions, COLLISION_COLUMNS)

    return Judging(len(rows), episodes, keep, finish)


def _judge_sweep(store: Store, plan: SweepPlan) -> Judging:
    """Return a judging of the finished episodes in *store*."""
    jobs = {job.key: job for job in plan.jobs if store.has(job.key)}

    def episodes() -> Iterator[tuple[str, EpisodeTables]]:
        for key, job in jobs.items():
            stored = store.read(key)
            if stored is None or "states" not in stored.tables:
                continue
            (row,) = stored.tables["episodes"].to_pylist()
            collisions = stored.tables["collisions"].to_pylist()
            net_file = _found_net(plan.options(job).net, store.path)
            signals = stored.tables.get("signals")
            yield key, EpisodeTables(net_file, row, stored.tables["states"], collisions, signals)

    return Judging(len(jobs), episodes, partial(_keep_in_part, store), partial(consolidate, store, plan))


def _keep_in_part(store: Store, key: str, judged: JudgedRows) -> None:
    """Replace the judged rows in the stored episode *key*, if there is one."""
    stored = store.read(key)
    if stored is None:
        return
    stored_rows = stored.tables["episodes"]
    columns = {**EPISODE_COLUMNS, **SITUATION_COLUMNS}
    row = dict.fromkeys(columns) | stored_rows.to_pylist()[0] | judged.episode
    tables = {
        "episodes": table_of([row], columns),
        "collisions": table_of(judged.collisions, COLLISION_COLUMNS),
    }
    store.write(key, StoredEpisode({**stored.tables, **tables}, stored.failed).to_bytes())


def judge_episode(stored: EpisodeTables, search: bool = False) -> JudgedRows:
    """Return the rows of *stored* with verdicts; unchanged if the episode has no target or fewer than two instants.

    Args:
        stored: the episode.
        search: run the clairvoyant search.

    Raises:
        NetError: the net cannot be read.
        WeightsError: the search has no weights.
    """
    record = stored.record()
    row, collisions = dict(stored.row), [dict(collision) for collision in stored.collisions]
    if record is None or record.tracks.steps < 2:
        return JudgedRows(row, collisions)
    road = stored.road()
    metrics = summarise(record, road, solvable(record, road) if search else row.get("solvable"))
    judged = episode_row(record, road, metrics)
    if bool(judged["target_collision"]) == bool(row["target_collision"]):
        offences = () if stored.signals is None else OFFENCE_COLUMNS  # running a red light needs the signals
        verdict = {name: judged[name] for name in (*_EPISODE_VERDICTS, *offences)}
        row |= _with_red_light(row, verdict, stored.signals)
    judged_by_key = {_collision_key(judged): judged for judged in collision_rows(record, road, metrics)}
    for collision in collisions:
        key = _collision_key(collision)
        if key in judged_by_key:
            verdict = {name: judged_by_key[key][name] for name in _COLLISION_VERDICTS}
            collision |= _with_red_light(collision, verdict, stored.signals)
    return JudgedRows(row, collisions)


def _with_red_light(
    stored: Mapping[str, Any], judged: dict[str, Any], signals: pa.Table | None
) -> dict[str, Any]:
    """Return *judged*, corrected for a red light that the run noticed, if the signals were not stored."""
    reason = str(stored.get("fault_reason") or "")
    if signals is not None or not reason.endswith(f"{ON_RED}."):
        return judged
    by_target = reason.startswith("The target")
    side = "target_breaches" if by_target else "other_breaches"
    breaches = [
        breach
        for breach in str(judged[side] or "").split(", ")
        if breach and breach != BreachKind.RIGHT_OF_WAY
    ]
    corrected = {name: stored[name] for name in ("at_fault", "fault_reason")}
    corrected[side] = ", ".join([str(BreachKind.RED_LIGHT), *breaches])
    corrected["lawful"] = judged["lawful"] if by_target else False
    corrected["valid_failure"] = by_target
    return {**judged, **corrected, "verdict": f"{judged['verdict']} {reason}"}


def _judged_episodes(
    episodes: Iterator[tuple[str, EpisodeTables]], workers: int, search: bool
) -> Iterator[tuple[str, JudgedRows]]:
    """Yield the key and the judged rows of each episode, in the order of completion."""
    judge = partial(judge_episode, search=search)
    if workers <= 1:
        for key, episode in episodes:
            yield key, judge(episode)
        return
    tasks = ((key, (judge, episode)) for key, episode in episodes)
    yield from ((key, future.result()) for key, future in futures_of(tasks, workers, _one_arrow_thread))


def _one_arrow_thread() -> None:
    pa.set_cpu_count(1)


@lru_cache(maxsize=4)
def _road(net: Path) -> RoadMap:
    return RoadMap.read(net)


def _collision_key(row: Mapping[str, Any]) -> tuple[Any, ...]:
    return row["first"], row["second"], round(float(row["time_s"]), 6)


def _found_net(name: str, folder: Path) -> Path:
    path = net_path(name, folder)
    if path is None:
        raise FileError(folder, f"the net {name} is no longer there", "put it back, or beside the tables")
    return path


def _by_episode(table: pa.Table) -> dict[int, pa.Table]:
    """Return the rows of each episode; the rows of one episode are contiguous."""
    numbers = table["episode"].to_numpy()
    starts = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
    return {int(numbers[a]): table.slice(a, b - a).combine_chunks() for a, b in pairwise(starts) if b > a}


def _write_table(path: Path, rows: list[dict[str, Any]], columns: Mapping[str, Column]) -> None:
    schema = schema_of(columns)
    try:
        with whole_file(path) as temporary:
            pq.write_table(
                pa.Table.from_pylist(rows, schema=schema), arrow_path(temporary), compression="zstd"
            )
    except OSError as error:
        remedy = "free some space" if is_disk_full(error) else "make its folder one that can be written to"
        raise FileError(path, f"cannot be written ({os_reason(error)})", remedy) from None
