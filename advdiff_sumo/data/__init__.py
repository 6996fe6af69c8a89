"""Reads driving logs; one reader for each format."""

from __future__ import annotations

from pathlib import Path

from advdiff_sumo.core.errors import LogError
from advdiff_sumo.data.argoverse2_log import Argoverse2Reader
from advdiff_sumo.data.commonroad_log import CommonRoadReader, is_scenario
from advdiff_sumo.data.log_reader import LogReader, LogScene
from advdiff_sumo.data.nuscenes import NuScenesReader
from advdiff_sumo.data.scenarionet_log import ScenarioNetReader

__all__ = [
    "Argoverse2Reader",
    "CommonRoadReader",
    "LogReader",
    "LogScene",
    "NuScenesReader",
    "ScenarioNetReader",
    "open_log",
]
LOGS = (
    "nuScenes (v1.0-*/scene.json in its root), ScenarioNet (sd_*.pkl; Waymo, nuPlan and others by its converters), "
    "Argoverse 2 (scenario_*.parquet), CommonRoad (.xml or .xml.gz that begins with <commonRoad>) and runs "
    "(states.parquet)"
)
_ADVICE = {
    ".pkl.gz": "unpack ScenarioNet's records first, with gunzip",
    ".tfrecord": "convert Waymo's .tfrecord to records with ScenarioNet first",
    ".db": "convert nuPlan's .db to records with ScenarioNet first",
    ".json": "a map is no log: give it to advdiff-sumo convert, and the log of its drives here",
}


def open_log(path: Path) -> LogReader:
    """Return the reader for the log at *path*, which is of one of the kinds that :data:`LOGS` lists.

    Raises:
        LogError: *path* does not exist or is of no known kind.
    """
    if not path.exists():
        raise LogError(path, "no such log", f"logs that are known are those of {LOGS}")
    if (path / "states.parquet").is_file():
        from advdiff_sumo.data.runs import RunReader  # late: training reads window files without pyarrow

        return RunReader(path)
    if any(child.is_dir() for child in path.glob("v1.0-*")) or (path / "scene.json").is_file():
        return NuScenesReader(path)
    if path.suffix == ".pkl" or any(path.rglob("sd_*.pkl")):
        return ScenarioNetReader(path)
    if path.suffix == ".parquet" or any(path.rglob("scenario_*.parquet")):
        return Argoverse2Reader(path)
    if is_scenario(path) or (path.is_dir() and any(map(is_scenario, path.iterdir()))):
        return CommonRoadReader(path)
    raise _unknown(path)


def _unknown(path: Path) -> LogError:
    """Return the error for a file or folder of no known kind, with the known kinds and advice."""
    files = [path] if path.is_file() else list(path.iterdir())
    marks = (mark for mark in _ADVICE for file in files if mark in file.name)
    problem = (
        "is no driving log of a known kind" if path.is_file() else "holds no driving log of a known kind"
    )
    looked_for = f"those of {LOGS} are looked for"
    return LogError(path, f"{problem}: {looked_for}", _ADVICE.get(next(marks, ""), "give one of these"))
