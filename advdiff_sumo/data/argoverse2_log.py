"""Argoverse 2 motion forecasting (Wilson et al. 2021, arXiv:2301.00493): ``scenario_*.parquet``, 10 Hz, 11 s."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import BoolArray
from advdiff_sumo.core.errors import LogError
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.data.log_reader import LogScene
from advdiff_sumo.data.motion import annotated, parked_agents, without_jitter
from advdiff_sumo.data.scene_files import SceneFiles

DT_S = 0.1
EGO = "AV"
PREFIX = "scenario_"
SCENARIOS = f"{PREFIX}*.parquet"
COLUMNS = (
    "track_id", "object_type", "timestep", "position_x", "position_y", "heading", "velocity_x", "velocity_y",
)  # fmt: skip
CLASSES = {
    "vehicle": AgentClass.CAR,
    "bus": AgentClass.BUS,
    "motorcyclist": AgentClass.MOTORCYCLE,
    "cyclist": AgentClass.BICYCLE,
    "pedestrian": AgentClass.PEDESTRIAN,
}
SIZES_M = {  # the files hold no sizes
    AgentClass.CAR: (4.6, 1.9),
    AgentClass.BUS: (12.0, 2.6),
    AgentClass.MOTORCYCLE: (2.2, 0.9),
    AgentClass.BICYCLE: (1.8, 0.7),
    AgentClass.PEDESTRIAN: (0.6, 0.6),
}
PARKED_RECORDED_MPS = 0.5
"""Who is recorded at no higher speed at any instant is parked, though its box wanders by metres as it is seen anew."""
_AGAIN = "give an unchanged scenario_*.parquet"


class Argoverse2Reader(SceneFiles):
    """Reads one ``scenario_*.parquet`` or the ones below a folder; a scene is named by its scenario's id.

    Riderless bicycles, static objects and background are left out; sizes are those usual for the class, as the
    files hold none.
    """

    kind, remedy = "scenario", _AGAIN

    def read_file(self, name: str, path: Path) -> LogScene:
        """Return the scenario in *path*."""
        return _scene(name, path, _table(path))

    def map_file(self, name: str) -> Path:
        """Return the map beside the scenario.

        Raises:
            LogError: it is not there.
        """
        path = self.files()[name]
        beside = path.with_name(f"log_map_archive_{path.stem.removeprefix(PREFIX)}.json")
        if not beside.exists():
            raise LogError(beside, "no such map", "unpack the scenario's folder whole, or give a --net")
        return beside

    def paths(self) -> dict[Path, str]:
        """Return file → id of every scenario, searched recursively."""
        paths = [self.path] if self.path.is_file() else sorted(self.path.rglob(SCENARIOS))
        if not paths:
            raise LogError(self.path, f"no such file or folder of {SCENARIOS}", "give one of these")
        return {path: path.stem.removeprefix(PREFIX) for path in paths}


def _table(path: Path) -> dict[str, Any]:
    import pyarrow as pa  # late: training reads window files without pyarrow
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path, columns=list(COLUMNS))
    except (OSError, pa.ArrowException) as error:
        raise LogError(path, f"is no readable Parquet file ({str(error).splitlines()[0]})", _AGAIN) from None
    return {name: table[name].to_numpy() for name in table.column_names}


def _scene(name: str, path: Path, table: dict[str, Any]) -> LogScene:
    kinds = {
        str(track): CLASSES.get(str(kind))
        for track, kind in zip(table["track_id"], table["object_type"], strict=True)
    }
    ids = [track for track, kind in kinds.items() if kind is not None]
    if EGO not in ids:
        raise ValueError(f"it has no track '{EGO}' of the recording vehicle")
    tracks = _tracks(table, ids, [kinds[track] for track in ids])
    ego = ids.index(EGO)
    parked = parked_agents(tracks.xy_m, tracks.valid, tracks.dt_s)
    parked |= _recorded_standing(table, ids) & (tracks.classes != AgentClass.PEDESTRIAN)
    parked[ego] = False
    tracks = without_jitter(tracks, parked, ego)
    return LogScene(name, f"log_map_archive_{name}", tracks, ego, parked, path)


def _recorded_standing(table: dict[str, Any], ids: list[str]) -> BoolArray:
    """Return which agents (A,) have no recorded speed over :data:`PARKED_RECORDED_MPS`."""
    fast = np.hypot(table["velocity_x"], table["velocity_y"]) > PARKED_RECORDED_MPS
    moving = {str(track) for track in table["track_id"][fast]}
    return np.array([track not in moving for track in ids])


def _tracks(table: dict[str, Any], ids: list[str], kinds: list[AgentClass | None]) -> Tracks:
    row_of = {track: row for row, track in enumerate(ids)}
    steps = int(table["timestep"].max()) + 1
    rows = np.array([row_of.get(str(track), -1) for track in table["track_id"]])
    kept = rows >= 0
    at = rows[kept], table["timestep"][kept].astype(np.int64)
    xy = np.full((len(ids), steps, 2), np.nan)
    yaw = np.full((len(ids), steps), np.nan)
    xy[at] = np.stack((table["position_x"][kept], table["position_y"][kept]), axis=-1)
    yaw[at] = table["heading"][kept]
    if not (np.isfinite(xy[at]).all() and np.isfinite(yaw[at]).all()):
        raise ValueError("a state is not finite")
    sizes = np.array([SIZES_M[AgentClass(kind)] for kind in kinds if kind is not None])
    return annotated(ids, kinds, sizes, xy, yaw, DT_S)
