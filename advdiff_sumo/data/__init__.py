"""Readers of driving logs."""

from __future__ import annotations

from pathlib import Path

from advdiff_sumo.core.errors import LogError
from advdiff_sumo.data.argoverse2_log import Argoverse2Reader
from advdiff_sumo.data.commonroad_log import CommonRoadReader
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
    "a folder with nuScenes' v1.0-*/ tables, ScenarioNet .pkl records, Argoverse 2 scenario_*.parquet, "
    "CommonRoad scenarios (.xml, .xml.gz) or a run"
)


def open_log(path: Path) -> LogReader:
    """Return the reader for the log at *path*: of whichever kind :data:`LOGS` names.

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
    if path.suffix == ".parquet" or (path.is_dir() and any(path.rglob("scenario_*.parquet"))):
        return Argoverse2Reader(path)
    if _is_commonroad(path):
        return CommonRoadReader(path)
    raise LogError(path, "holds no driving log", f"give {LOGS}")


def _is_commonroad(path: Path) -> bool:
    names = [path.name] if path.is_file() else [child.name for child in path.iterdir()]
    return any(name.endswith((".xml", ".xml.gz")) for name in names)
