"""Reads a finished run folder; no other part of the report touches its files."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import pyarrow as pa
import pyarrow.parquet as pq

from advdiff_sumo.core.errors import FileError, NetError
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.shipped import SHIPPED_NETS, find_net
from advdiff_sumo.metrics.columns import COLLISION_COLUMNS, EPISODE_COLUMNS
from advdiff_sumo.report.states import EpisodeStates, states_of

Row: TypeAlias = Mapping[str, Any]

STATE_COLUMNS = (
    *("episode", "step", "time_s", "agent", "class", "length_m", "width_m"),
    *("x_m", "y_m", "yaw_rad", "speed_mps", "is_target"),
)
_REMEDY = "give the folder of a finished run"


@dataclass(frozen=True)
class FinishedRun:
    """What a run folder holds, without the states, which are read an episode at a time.

    Attributes:
        folder: the folder.
        settings: content of ``run.toml``.
        episodes: rows of ``episodes.parquet`` by episode.
        collisions: rows of ``collisions.parquet``.
        road: the net; None when it could not be read.
        road_problem: why not, as a sentence; "" when it was read.
    """

    folder: Path
    settings: Mapping[str, Any]
    episodes: tuple[Row, ...]
    collisions: tuple[Row, ...]
    road: RoadMap | None
    road_problem: str

    @staticmethod
    def read(folder: Path) -> FinishedRun:
        """Read the folder of a finished or interrupted run.

        Raises:
            FileError: a file of the run is missing, damaged or of another version.
        """
        settings = _settings(folder / "run.toml")
        episodes = _table(folder / "episodes.parquet", EPISODE_COLUMNS).to_pylist()
        collisions = _table(folder / "collisions.parquet", COLLISION_COLUMNS).to_pylist()
        _require(folder / "states.parquet", STATE_COLUMNS)
        road, problem = _road(folder, settings)
        ordered = tuple(sorted(episodes, key=lambda row: int(row["episode"])))
        return FinishedRun(folder, settings, ordered, tuple(collisions), road, problem)

    @property
    def options(self) -> Mapping[str, Any]:
        """The run's options; empty when ``run.toml`` has none."""
        found = self.settings.get("options", {})
        return found if isinstance(found, Mapping) else {}

    def row(self, episode: int) -> Row:
        """Return the row of *episode*.

        Raises:
            FileError: the run has no such episode.
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
        path = self.folder / "states.parquet"
        try:
            table = pq.read_table(path, columns=list(STATE_COLUMNS), filters=[("episode", "==", episode)])
        except (OSError, pa.ArrowException) as error:
            raise FileError(path, f"is damaged ({_first_line(error)})", _REMEDY) from None
        return states_of(table)


def _settings(path: Path) -> Mapping[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileError(path, "is missing", _REMEDY) from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise FileError(path, f"cannot be read ({_first_line(error)})", _REMEDY) from None


def _table(path: Path, columns: Iterable[str]) -> pa.Table:
    _require(path, columns)
    try:
        return pq.read_table(path, columns=list(columns))
    except (OSError, pa.ArrowException) as error:
        raise FileError(path, f"is damaged ({_first_line(error)})", _REMEDY) from None


def _require(path: Path, columns: Iterable[str]) -> None:
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


def _road(folder: Path, settings: Mapping[str, Any]) -> tuple[RoadMap | None, str]:
    """Return the run's net, or None and why it cannot be drawn."""
    options = settings.get("options", {})
    named = options.get("net") if isinstance(options, Mapping) else None
    if not isinstance(named, str) or not named:
        return None, "run.toml names no net"
    path = next((p for p in _net_candidates(folder, named) if p.is_file()), None)
    if path is None:
        return None, f"the net {named} is no longer there"
    try:
        return RoadMap.read(path), ""
    except NetError as error:
        return None, str(error)


def _net_candidates(folder: Path, named: str) -> tuple[Path, ...]:
    """Return where the net may be: as named, beside ``run.toml``, among the shipped ones."""
    shipped = (find_net(named),) if named in SHIPPED_NETS else ()
    return Path(named), folder / Path(named).name, *shipped


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
