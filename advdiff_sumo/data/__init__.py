"""Readers of driving logs."""

from __future__ import annotations

from pathlib import Path

from advdiff_sumo.core.errors import LogError
from advdiff_sumo.data.log_reader import LogReader, LogScene
from advdiff_sumo.data.nuscenes import NuScenesReader
from advdiff_sumo.data.scenarionet_log import ScenarioNetReader

__all__ = ["LogReader", "LogScene", "NuScenesReader", "ScenarioNetReader", "open_log"]


def open_log(path: Path) -> LogReader:
    """Return the reader for the log at *path*: a nuScenes dataset root, ScenarioNet records, or a run folder.

    Raises:
        LogError: there is nothing, or nothing that is known.
    """
    if not path.exists():
        raise LogError(path, "no such log", "give the root of a nuScenes dataset or a ScenarioNet record")
    if (path / "states.parquet").is_file():
        from advdiff_sumo.data.runs import RunReader  # late: training reads window files without pyarrow

        return RunReader(path)
    if path.is_dir() and any(child.is_dir() for child in path.glob("v1.0-*")):
        return NuScenesReader(path)
    if path.suffix == ".pkl" or (path.is_dir() and any(path.glob("*.pkl"))):
        return ScenarioNetReader(path)
    raise LogError(
        path, "holds no driving log", "give a folder with v1.0-*/ tables, ScenarioNet .pkl records or a run"
    )
