"""Reads folders of ``advdiff-sumo run`` and ``sweep`` as driving logs, from their ``states.parquet``."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from advdiff_sumo.core.errors import LogError, UnknownNameError
from advdiff_sumo.data.episode_states import STATE_COLUMNS, EpisodeStates, states_of
from advdiff_sumo.data.log_reader import LogScene
from advdiff_sumo.data.run_tables import RUN_SETTINGS, RunTables

_REMEDY = "give the folder of a finished run or sweep"


class RunReader:
    """Reads the episodes of a run or sweep as scenes; the ego is the target, the location the episode's net.

    No agent counts as parked, as a SUMO vehicle that stands throughout an episode is waiting.
    """

    def __init__(self, folder: str | Path) -> None:
        """Create the reader of a folder with ``states.parquet`` and the settings of its run or sweep."""
        self.folder = Path(folder)
        self._tables = RunTables(self.folder, LogError, _REMEDY)

    def names(self) -> list[str]:
        """Return the names of the episodes, in order."""
        return [f"{self.folder.resolve().name}-{number:04d}" for number in self._numbers]

    def read(self, name: str) -> LogScene:
        """Return one episode, at the simulation's time step.

        Raises:
            UnknownNameError: there is no such episode.
            LogError: a table or ``run.toml`` is missing or damaged, or does not say which net the episode had.
        """
        names = self.names()
        if name not in names:
            raise UnknownNameError("episode", name, names)
        number, path = self._numbers[names.index(name)], self._tables.path("states")
        try:
            states = _states(self._tables.rows("states", STATE_COLUMNS, number))
        except (ValueError, KeyError) as error:
            raise LogError(path, f"episode {number} cannot be used ({error})", _REMEDY) from None
        parked = np.zeros(states.tracks.agents, dtype=np.bool_)
        return LogScene(name, self._net_of(number), states.tracks, states.target, parked, path)

    def scenes(self) -> Iterator[LogScene]:
        """Yield all episodes."""
        return map(self.read, self.names())

    def _net_of(self, number: int) -> str:
        """Return the net of an episode as its run or sweep states it: a path, or the name of a shipped net."""
        try:
            return self._nets[number] if self._tables.is_sweep else str(self._settings["options"]["net"])
        except (KeyError, TypeError) as error:
            path = self._tables.path("episodes") if self._tables.is_sweep else self.folder / RUN_SETTINGS
            raise LogError(path, f"does not say which net the run had ({error})", _REMEDY) from None

    @cached_property
    def _settings(self) -> dict[str, Any]:
        return self._tables.settings()

    @cached_property
    def _nets(self) -> dict[int, str]:
        """The nets of a sweep's episodes."""
        self._tables.columns("episodes", ("episode", "net"))
        rows = self._tables.rows("episodes", ("episode", "net")).to_pylist()
        return {row["episode"]: str(row["net"]) for row in rows}

    @cached_property
    def _numbers(self) -> list[int]:
        self._tables.columns("states", sorted(STATE_COLUMNS))
        numbers: list[int] = np.unique(
            self._tables.rows("states", ("episode",))["episode"].to_numpy()
        ).tolist()
        return numbers


def _states(table: pa.Table) -> EpisodeStates:
    """Return the states in *table*, the rows of one episode, which must have exactly one target."""
    targets = pc.unique(table.filter(table["is_target"])["agent"])
    states = states_of(table)
    if states is None or len(targets) != 1:
        raise ValueError(f"it has {len(targets)} targets")
    return states
