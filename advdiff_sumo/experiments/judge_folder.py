"""Adds verdicts to the folder of a finished run or sweep."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from advdiff_sumo.core.errors import ConfigError, FileError, InputError, os_reason
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.whole_file import whole_file
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

#: As many episodes are judged before other processes have started; the clairvoyant search takes longer.
_TOO_FEW = 16
#: What is taken over of an episode's row; the rest stays as it was measured with all that the simulation knew.
_JUDGED = (
    *("collision_type", "at_fault", "fault_reason"),
    *VERDICT_COLUMNS,
    *CRITICAL_COLUMNS,
)
_OF_COLLISIONS = ("type", "at_fault", "fault_reason", *VERDICT_COLUMNS)


@dataclass(frozen=True)
class EpisodeTables:
    """What is stored of one episode.

    Attributes:
        net: where the net is.
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
        """Return the net, which is read once for many episodes.

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
        count: how many episodes it has.
        episodes: gives them, each with its key.
        keep: called with a key and what was judged, as each is done.
        finish: called at the end.
        doubt: why the nets that are there now may not be those of the episodes; "" where they are.
    """

    count: int
    episodes: Callable[[], Iterator[tuple[str, EpisodeTables]]]
    keep: Callable[[str, JudgedRows], None]
    finish: Callable[[], object]
    doubt: str = ""

    def judge(self, workers: int, tell: Callable[[], None], search: bool = False) -> list[dict[str, Any]]:
        """Judge all episodes and return their rows; *tell* is called after each.

        Args:
            workers: processes; few episodes are judged in this one.
            tell: as above.
            search: ask the clairvoyant search of each collision of the target; what it said before is kept otherwise.

        Raises:
            InputError: a table or net cannot be read, or the results not be written.
        """
        rows: list[tuple[str, dict[str, Any]]] = []
        few = self.count <= _TOO_FEW and not search
        for key, judged in _judged(self.episodes(), 1 if few else workers, search):
            self.keep(key, judged)
            rows.append((key, judged.episode))
            tell()
        self.finish()
        return [row for _, row in sorted(rows, key=lambda pair: int(pair[1]["episode"]))]


def open_judging(folder: Path) -> Judging:
    """Open the folder of a finished or interrupted run or sweep.

    Raises:
        InputError: it is neither, or is damaged.
    """
    if not (folder / SWEEP_SETTINGS).exists():
        put_together(folder)
        return replace(_tables(folder, EPISODE_COLUMNS), doubt=_doubt_of_run(folder))
    store = Store.open(folder)
    try:
        plan = stored_plan(store)
    except ConfigError as error:  # of an earlier version, or its nets have changed
        kept = "verdicts go into its tables alone, until results puts these together again"
        return replace(_tables(folder, SWEEP_TABLES["episodes"]), doubt=f"{error}; {kept}")
    return _sweep(store, plan)


def _doubt_of_run(folder: Path) -> str:
    """Return why a net that is there now may not be that of the run in *folder*; "" where it is."""
    try:
        stored_run(folder, planner=LaneGraphPlanner())  # nothing is driven
    except InputError as error:  # of an earlier version, or its net has changed
        return str(error)
    return ""


def _tables(folder: Path, columns: Mapping[str, Column]) -> Judging:
    """Judge the episodes of the tables in *folder*, whose episodes have *columns*."""
    tables = RunTables(folder)
    if not (tables.is_sweep or (folder / RUN_SETTINGS).exists()):
        raise FileError(folder, "holds no run and no sweep", "give a finished one, or --net with a scenario")
    net = str(tables.settings().get("options", {}).get("net", ""))
    rows = {int(row["episode"]): row for row in tables.rows("episodes").to_pylist()}
    hits: dict[int, list[dict[str, Any]]] = {number: [] for number in rows}
    for row in tables.rows("collisions").to_pylist():
        hits[int(row["episode"])].append(row)

    def episodes() -> Iterator[tuple[str, EpisodeTables]]:
        signals = _by_episode(tables.rows("signals")) if tables.path("signals").exists() else None
        states = _by_episode(tables.rows("states"))
        for number, row in rows.items():
            if number in states:
                lights = None if signals is None else signals.get(number)
                place = _net(str(row.get("net") or net), folder)
                yield str(number), EpisodeTables(place, row, states[number], hits[number], lights)

    def keep(key: str, judged: JudgedRows) -> None:
        rows[int(key)], hits[int(key)] = judged.episode, judged.collisions
        if not tables.is_sweep:  # one that was interrupted goes on from its parts
            _keep_in_part(RunFolder(folder).store, run_key(int(key)), judged)

    def finish() -> None:
        _replace(tables.path("episodes"), list(rows.values()), columns)
        _replace(tables.path("collisions"), [x for some in hits.values() for x in some], COLLISION_COLUMNS)

    return Judging(len(rows), episodes, keep, finish)


def _sweep(store: Store, plan: SweepPlan) -> Judging:
    jobs = {job.key: job for job in plan.jobs if store.has(job.key)}

    def episodes() -> Iterator[tuple[str, EpisodeTables]]:
        for key, job in jobs.items():
            part = store.read(key)
            if part is None or "states" not in part.tables:
                continue
            (row,) = part.tables["episodes"].to_pylist()
            hits = part.tables["collisions"].to_pylist()
            net = _net(plan.options(job).net, store.path)
            yield key, EpisodeTables(net, row, part.tables["states"], hits, part.tables.get("signals"))

    return Judging(len(jobs), episodes, partial(_keep_in_part, store), partial(consolidate, store, plan))


def _keep_in_part(store: Store, key: str, judged: JudgedRows) -> None:
    """Put what was judged into the file of an episode, where there is one."""
    part = store.read(key)
    if part is None:
        return
    before = part.tables["episodes"]
    columns = {**EPISODE_COLUMNS, **SITUATION_COLUMNS}
    row = dict.fromkeys(columns) | before.to_pylist()[0] | judged.episode
    tables = {
        "episodes": table_of([row], columns),
        "collisions": table_of(judged.collisions, COLLISION_COLUMNS),
    }
    store.write(key, StoredEpisode({**part.tables, **tables}, part.failed).to_bytes())


def judge_episode(stored: EpisodeTables, search: bool = False) -> JudgedRows:
    """Return the rows of *stored* with verdicts; those of an episode that never began without.

    Args:
        stored: the episode.
        search: ask the clairvoyant search.

    Raises:
        NetError: the net cannot be read.
        WeightsError: the search has no weights.
    """
    record = stored.record()
    row, collisions = dict(stored.row), [dict(x) for x in stored.collisions]
    if record is None or record.tracks.steps < 2:
        return JudgedRows(row, collisions)
    road = stored.road()
    metrics = summarise(record, road, solvable(record, road) if search else row.get("solvable"))
    judged = episode_row(record, road, metrics)
    if bool(judged["target_collision"]) == bool(row["target_collision"]):
        seen = () if stored.signals is None else OFFENCE_COLUMNS  # red lights are unknown without signals
        row |= _with_red_light(row, {name: judged[name] for name in (*_JUDGED, *seen)}, stored.signals)
    by_pair = {_pair(x): x for x in collision_rows(record, road, metrics)}
    for one in collisions:
        if _pair(one) in by_pair:
            verdict = {name: by_pair[_pair(one)][name] for name in _OF_COLLISIONS}
            one |= _with_red_light(one, verdict, stored.signals)
    return JudgedRows(row, collisions)


def _with_red_light(
    before: Mapping[str, Any], judged: dict[str, Any], signals: pa.Table | None
) -> dict[str, Any]:
    """Return what was *judged*, with the red light that the run saw where its signals were not kept."""
    reason = str(before.get("fault_reason") or "")
    if signals is not None or not reason.endswith(f"{ON_RED}."):
        return judged
    by_target = reason.startswith("The target")
    side = "target_breaches" if by_target else "other_breaches"
    breaches = [x for x in str(judged[side] or "").split(", ") if x and x != BreachKind.RIGHT_OF_WAY]
    corrected = {name: before[name] for name in ("at_fault", "fault_reason")}
    corrected[side] = ", ".join([str(BreachKind.RED_LIGHT), *breaches])
    corrected["lawful"] = judged["lawful"] if by_target else False
    corrected["valid_failure"] = by_target
    return {**judged, **corrected, "verdict": f"{judged['verdict']} {reason}"}


def _judged(
    episodes: Iterator[tuple[str, EpisodeTables]], workers: int, search: bool
) -> Iterator[tuple[str, JudgedRows]]:
    """Yield each episode with its verdict, in whatever order they are done."""
    judge = partial(judge_episode, search=search)
    if workers <= 1:
        for key, one in episodes:
            yield key, judge(one)
        return
    tasks = ((key, (judge, one)) for key, one in episodes)
    yield from ((key, done.result()) for key, done in futures_of(tasks, workers, _one_arrow_thread))


def _one_arrow_thread() -> None:
    pa.set_cpu_count(1)


@lru_cache(maxsize=4)
def _road(net: Path) -> RoadMap:
    return RoadMap.read(net)


def _pair(row: Mapping[str, Any]) -> tuple[Any, ...]:
    return row["first"], row["second"], round(float(row["time_s"]), 6)


def _net(name: str, folder: Path) -> Path:
    path = net_path(name, folder)
    if path is None:
        raise FileError(folder, f"the net {name} is no longer there", "put it back, or beside the tables")
    return path


def _by_episode(table: pa.Table) -> dict[int, pa.Table]:
    """Return the rows of each episode, which lie together."""
    numbers = table["episode"].to_numpy()
    starts = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
    return {int(numbers[a]): table.slice(a, b - a).combine_chunks() for a, b in pairwise(starts) if b > a}


def _replace(path: Path, rows: list[dict[str, Any]], columns: Mapping[str, Column]) -> None:
    schema = schema_of(columns)
    try:
        with whole_file(path) as aside:
            pq.write_table(pa.Table.from_pylist(rows, schema=schema), aside, compression="zstd")
    except OSError as error:
        remedy = (
            "free some space" if error.errno == errno.ENOSPC else "make its folder one that can be written to"
        )
        raise FileError(path, f"cannot be written ({os_reason(error)})", remedy) from None
