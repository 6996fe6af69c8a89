"""Reads folders of ``advdiff-sumo run`` as driving logs, from their ``states.parquet``."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from advdiff_sumo.core.errors import LogError, UnknownNameError
from advdiff_sumo.data.episode_states import STATE_COLUMNS, EpisodeStates, states_of
from advdiff_sumo.data.log_reader import LogScene
from advdiff_sumo.data.run_tables import RUN_SETTINGS, RunTables

_REMEDY = "give the folder of a finished run"


class RunReader:
    """Reads the episodes of a run folder as scenes; the ego is the target.

    No agent counts as parked, as a SUMO vehicle that stands throughout an episode is waiting.
    """

    def __init__(self, folder: str | Path) -> None:
        """Create the reader of a folder with ``run.toml`` and ``states.parquet``."""
        self.folder = Path(folder)
        self._tables = RunTables(self.folder, LogError, _REMEDY)

    @cached_property
    def net(self) -> str:
        """The run's net as ``run.toml`` states it: a path, or the name of a shipped net.

        Raises:
            LogError: the file is missing or damaged.
        """
        try:
            return str(self._tables.settings()["options"]["net"])
        except (KeyError, TypeError) as error:
            path = self.folder / RUN_SETTINGS
            raise LogError(path, f"does not say which net the run had ({error})", _REMEDY) from None

    def names(self) -> list[str]:
        """Return the names of the episodes, in order."""
        return [f"{self.folder.resolve().name}-{number:04d}" for number in self._numbers]

    def read(self, name: str) -> LogScene:
        """Return one episode, at the simulation's time step.

        Raises:
            UnknownNameError: there is no such episode.
            LogError: the table is damaged.
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
        return LogScene(name, self.net, states.tracks, states.target, parked, path)

    def scenes(self) -> Iterator[LogScene]:
        """Yield all episodes."""
        return map(self.read, self.names())

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
