"""Our own run folders as driving logs: the episodes of ``advdiff-sumo run`` by their ``states.parquet``."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import LogError, UnknownNameError
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.data.log_reader import LogScene

_COLUMNS = (
    *("episode", "step", "time_s", "agent", "class", "length_m", "width_m"),
    *("x_m", "y_m", "yaw_rad", "speed_mps", "is_target"),
)
_REMEDY = "give the folder of a finished run"
_FALLBACK_STEP_S = 0.1


class RunReader:
    """Reads the episodes of a run folder; the target takes the place of the recording vehicle.

    Nobody counts as parked: SUMO's vehicles that stand through an episode wait.
    """

    def __init__(self, folder: str | Path) -> None:
        """Point at a folder with ``run.toml`` and ``states.parquet``."""
        self.folder = Path(folder)

    @cached_property
    def net(self) -> str:
        """The run's net as ``run.toml`` has it: a path, or the name of a shipped one.

        Raises:
            LogError: the file is missing or damaged.
        """
        path = self.folder / "run.toml"
        try:
            settings = tomllib.loads(path.read_text(encoding="utf-8"))
            return str(settings["options"]["net"])
        except OSError as error:
            raise LogError(path, f"cannot be read ({error.strerror})", _REMEDY) from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError, KeyError, TypeError) as error:
            raise LogError(path, f"does not say which net the run had ({error})", _REMEDY) from None

    def names(self) -> list[str]:
        """Return the names of the episodes in their order."""
        return [f"{self.folder.resolve().name}-{number:04d}" for number in self._numbers]

    def read(self, name: str) -> LogScene:
        """Return one episode at the simulation's step.

        Raises:
            UnknownNameError: there is no such episode.
            LogError: the table is damaged.
        """
        names = self.names()
        if name not in names:
            raise UnknownNameError("episode", name, names)
        number = int(self._numbers[names.index(name)])
        path = self.folder / "states.parquet"
        try:
            table = pq.read_table(path, columns=list(_COLUMNS), filters=[("episode", "=", number)])
            tracks, target = _tracks(table)
        except (OSError, ValueError, KeyError, pa.ArrowException) as error:
            raise LogError(path, f"episode {number} cannot be used ({error})", _REMEDY) from None
        return LogScene(name, self.net, tracks, target, np.zeros(tracks.agents, dtype=np.bool_), path)

    def scenes(self) -> Iterator[LogScene]:
        """Yield all episodes."""
        return map(self.read, self.names())

    @cached_property
    def _numbers(self) -> list[int]:
        path = self.folder / "states.parquet"
        try:
            missing = sorted(set(_COLUMNS) - set(pq.read_schema(path).names))
            if missing:
                raise LogError(path, f"lacks the columns {', '.join(missing)}", _REMEDY)
            column = pq.read_table(path, columns=["episode"])["episode"].to_numpy()
        except FileNotFoundError:
            raise LogError(path, "no such table", _REMEDY) from None
        except (OSError, pa.ArrowException) as error:
            raise LogError(path, f"is damaged ({' '.join(str(error).split())})", _REMEDY) from None
        return [int(number) for number in np.unique(column)]


def _tracks(table: pa.Table) -> tuple[Tracks, int]:
    """Return the tracks of one episode's rows and the row of the target."""
    columns: dict[str, Any] = {name: np.array(table[name].to_pylist()) for name in _COLUMNS}
    ids, first, agent = np.unique(columns["agent"], return_index=True, return_inverse=True)
    step = columns["step"].astype(np.int64)
    shape = (len(ids), int(step.max()) + 1)

    def spread(name: str) -> FloatArray:
        filled = np.full(shape, np.nan)
        filled[agent, step] = columns[name].astype(np.float64)
        return filled

    targets = np.unique(agent[columns["is_target"].astype(np.bool_)])
    if len(targets) != 1:
        raise ValueError(f"it has {len(targets)} targets")
    late = step > 0
    step_s = columns["time_s"][late] / step[late] if late.any() else np.array([_FALLBACK_STEP_S])
    yaw = spread("yaw_rad")
    tracks = Tracks(
        ids=tuple(str(name) for name in ids),
        classes=np.array([int(AgentClass[str(k).upper()]) for k in columns["class"][first]], dtype=np.int64),
        size_m=np.column_stack((columns["length_m"][first], columns["width_m"][first])).astype(np.float64),
        xy_m=np.stack((spread("x_m"), spread("y_m")), axis=-1),
        yaw_rad=yaw,
        speed_mps=spread("speed_mps"),
        valid=np.isfinite(yaw),
        t0_s=0.0,
        dt_s=float(np.round(np.median(step_s), 6)),
    )
    return tracks, int(targets[0])
