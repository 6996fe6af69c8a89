"""Reads the folder of a finished run or sweep; no other part of the report touches its files."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import pyarrow as pa
import pyarrow.parquet as pq

from advdiff_sumo.core.errors import FileError
from advdiff_sumo.data.episode_states import STATE_COLUMNS, EpisodeStates, states_of
from advdiff_sumo.metrics.arrow_tables import upgraded
from advdiff_sumo.metrics.columns import COLLISION_COLUMNS, EPISODE_COLUMNS, LATER_COLUMNS, Column
from advdiff_sumo.report.plans import PLAN_COLUMNS, Planned, plans_of

Row: TypeAlias = Mapping[str, Any]

#: What a sweep's episodes have beside a run's; a run's get the values of its options.
JOB_COLUMNS = (
    *("key", "scene_key", "net", "target", "target_options"),
    *("background", "background_options", "attack", "root_seed"),
    *("approach", "attacker_manoeuvre", "target_manoeuvre"),
)
_REMEDY = "give the folder of a finished run or sweep"


@dataclass(frozen=True)
class FinishedRun:
    """What the folder of a run or sweep holds, without the states, which are read an episode at a time.

    Attributes:
        folder: the folder.
        settings: content of ``run.toml`` or ``sweep.toml``.
        is_sweep: which of the two.
        episodes: rows of ``episodes.parquet`` by episode, with ``JOB_COLUMNS``.
        collisions: rows of ``collisions.parquet``.
    """

    folder: Path
    settings: Mapping[str, Any]
    is_sweep: bool
    episodes: tuple[Row, ...]
    collisions: tuple[Row, ...]

    @staticmethod
    def read(folder: Path) -> FinishedRun:
        """Read the folder of a finished or interrupted run or sweep.

        Raises:
            FileError: a file of it is missing, damaged or of another version.
        """
        is_sweep = (folder / "sweep.toml").exists()
        settings = _settings(folder / ("sweep.toml" if is_sweep else "run.toml"))
        episodes = _table(folder / "episodes.parquet", EPISODE_COLUMNS, JOB_COLUMNS).to_pylist()
        collisions = _table(folder / "collisions.parquet", COLLISION_COLUMNS).to_pylist()
        _require(folder / "states.parquet", STATE_COLUMNS)
        options = _options(settings)
        rows = [_with_job(row, options) for row in sorted(episodes, key=lambda row: int(row["episode"]))]
        return FinishedRun(folder, settings, is_sweep, tuple(rows), tuple(collisions))

    @property
    def options(self) -> Mapping[str, Any]:
        """The options of the run or the content of the sweep's file; empty when there are none."""
        return _options(self.settings)

    @property
    def planned(self) -> int | None:
        """How many episodes a run was to have; None where that is not known."""
        planned = self.options.get("episodes")
        return planned if isinstance(planned, int) and not self.is_sweep else None

    def row(self, episode: int) -> Row:
        """Return the row of *episode*.

        Raises:
            FileError: there is no such episode.
        """
        for row in self.episodes:
            if row["episode"] == episode:
                return row
        numbers = [int(row["episode"]) for row in self.episodes]
        has = f"it has {numbers[0]} to {numbers[-1]}" if numbers else "it has none"
        raise FileError(self.folder, f"has no episode {episode}", has)

    def collisions_of(self, episode: int) -> tuple[Row, ...]:
        """Return the collisions of *episode* in the order of time."""
        return tuple(row for row in self.collisions if row["episode"] == episode)

    def states(self, episode: int) -> EpisodeStates | None:
        """Return the states of *episode*; None when it failed before its first instant.

        Raises:
            FileError: the states are damaged.
        """
        return self._states(self.folder / "states.parquet", episode)

    def natural(self, episode: int) -> EpisodeStates | None:
        """Return what happens in the seed scene of *episode* without attack; None where it was not kept.

        Raises:
            FileError: the table is damaged.
        """
        path = self.folder / "unattacked.parquet"
        if not path.exists():
            return None
        _require(path, STATE_COLUMNS)
        return self._states(path, episode)

    def signals(self, episode: int) -> pa.Table | None:
        """Return what the traffic lights of *episode* showed; None where the folder was made without.

        Raises:
            FileError: the table is damaged.
        """
        path = self.folder / "signals.parquet"
        if not path.exists():
            return None
        try:
            return pq.read_table(path, filters=[("episode", "==", episode)])
        except (OSError, pa.ArrowException) as error:
            raise FileError(path, f"is damaged ({_first_line(error)})", _REMEDY) from None

    def _states(self, path: Path, episode: int) -> EpisodeStates | None:
        try:
            there = set(pq.read_schema(path).names)
            columns = [*STATE_COLUMNS, *({"controller"} & there)]
            table = pq.read_table(path, columns=columns, filters=[("episode", "==", episode)])
        except (OSError, pa.ArrowException) as error:
            raise FileError(path, f"is damaged ({_first_line(error)})", _REMEDY) from None
        return states_of(table)

    def plans(self, episode: int) -> tuple[Planned, ...]:
        """Return what was planned in *episode*; nothing where the folder was made without plans.

        Raises:
            FileError: the plans are damaged.
        """
        path = self.folder / "plans.parquet"
        if not path.exists():
            return ()
        _require(path, ("episode", *PLAN_COLUMNS))
        try:
            return plans_of(
                pq.read_table(path, columns=[*PLAN_COLUMNS], filters=[("episode", "==", episode)])
            )
        except (OSError, pa.ArrowException) as error:
            raise FileError(path, f"is damaged ({_first_line(error)})", _REMEDY) from None

    def logs(self) -> Iterator[tuple[str, str]]:
        """Yield (net, root of the driving log) of all places whose seed scenes came from a log."""
        options = self.options
        grid = options.get("grid") or {}
        for place in (options, *grid.get("nets", ()), *options.get("cases", ())):
            if isinstance(place, Mapping) and place.get("scenes"):
                yield str(place.get("net", "")), str(place["scenes"])


def _options(settings: Mapping[str, Any]) -> Mapping[str, Any]:
    options = settings.get("sweep", settings.get("options", {}))
    return options if isinstance(options, Mapping) else {}


def _with_job(row: Row, options: Mapping[str, Any]) -> Row:
    """Return *row* with the run's options where it lacks the columns of a sweep."""
    if "target" in row:
        return row
    own = {name: str(options.get(name, "?")) for name in ("net", "target", "background")}
    blank = {"target_options": "{}", "background_options": "{}", "attack": own["background"]}
    return {**row, **own, **blank, "key": "", "scene_key": "", "root_seed": options.get("seed")}


def _settings(path: Path) -> Mapping[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileError(path, "is missing", _REMEDY) from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise FileError(path, f"cannot be read ({_first_line(error)})", _REMEDY) from None


def _table(path: Path, columns: Mapping[str, Column], welcome: Iterable[str] = ()) -> pa.Table:
    """Return *columns* of a table, and those of *welcome* that it has.

    What older versions did not write yet is empty.
    """
    wanted = list(columns)
    present = _require(path, [name for name in wanted if name not in LATER_COLUMNS])
    there = [name for name in wanted if name in present]
    try:
        table = pq.read_table(path, columns=[*there, *(name for name in welcome if name in present)])
    except (OSError, pa.ArrowException) as error:
        raise FileError(path, f"is damaged ({_first_line(error)})", _REMEDY) from None
    return upgraded(table, columns)


def _require(path: Path, columns: Iterable[str]) -> set[str]:
    try:
        present = set(pq.read_schema(path).names)
    except FileNotFoundError:
        raise FileError(path, "is missing", _REMEDY) from None
    except (OSError, pa.ArrowException) as error:
        raise FileError(path, f"is no Parquet file ({_first_line(error)})", _REMEDY) from None
    lacking = [name for name in columns if name not in present]
    if lacking:
        problem = f"lacks the columns {', '.join(lacking)}"
        raise FileError(path, problem, "repeat the run with this version of advdiff-sumo")
    return present


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
