"""Reads Argoverse 2 motion forecasting scenarios (Wilson et al. 2021, arXiv:2301.00493): 10 Hz, 11 s."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import BoolArray
from advdiff_sumo.core.errors import LogError
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.core.whole_file import arrow_path
from advdiff_sumo.data.log_reader import LogScene
from advdiff_sumo.data.motion import annotated_tracks, parked_agents, without_jitter
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
"""An agent whose recorded speed never exceeds this is parked; its box may still wander by metres."""
_AGAIN = "give an unchanged scenario_*.parquet"


class Argoverse2Reader(SceneFiles):
    """Reads one ``scenario_*.parquet`` or all below a folder; a scene has the name of its scenario's id.

    Riderless bicycles, static objects and background are left out. The files have no sizes, so each agent has the
    usual size of its class.
    """

    kind, remedy = "scenario", _AGAIN

    def read_file(self, name: str, path: Path) -> LogScene:
        """Return the scenario in *path*."""
        return _scene(name, path, _table(path))

    def map_file(self, name: str) -> Path:
        """Return the map beside the scenario.

        Raises:
            LogError: it does not exist.
        """
        path = self.files()[name]
        map_path = path.with_name(f"log_map_archive_{path.stem.removeprefix(PREFIX)}.json")
        if not map_path.exists():
            raise LogError(map_path, "no such map", "unpack the scenario's folder whole, or give a --net")
        return map_path

    def paths(self) -> dict[Path, str]:
        """Return file → id of every scenario; folders are searched recursively."""
        paths = [self.path] if self.path.is_file() else sorted(self.path.rglob(SCENARIOS))
        if not paths:
            raise LogError(self.path, f"no such file or folder of {SCENARIOS}", "give one of these")
        return {path: path.stem.removeprefix(PREFIX) for path in paths}


def _table(path: Path) -> dict[str, Any]:
    import pyarrow as pa  # late: training reads window files without pyarrow
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(arrow_path(path), columns=list(COLUMNS))
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
    """Return (A,) whether the recorded speeds of each agent never exceed :data:`PARKED_RECORDED_MPS`."""
    is_moving = np.hypot(table["velocity_x"], table["velocity_y"]) > PARKED_RECORDED_MPS
    moving_ids = {str(track) for track in table["track_id"][is_moving]}
    return np.array([track not in moving_ids for track in ids])


def _tracks(table: dict[str, Any], ids: list[str], kinds: list[AgentClass | None]) -> Tracks:
    row_of = {track: row for row, track in enumerate(ids)}
    steps = int(table["timestep"].max()) + 1
    rows = np.array([row_of.get(str(track), -1) for track in table["track_id"]])
    is_kept = rows >= 0
    cells = rows[is_kept], table["timestep"][is_kept].astype(np.int64)
    xy = np.full((len(ids), steps, 2), np.nan)
    yaw = np.full((len(ids), steps), np.nan)
    xy[cells] = np.stack((table["position_x"][is_kept], table["position_y"][is_kept]), axis=-1)
    yaw[cells] = table["heading"][is_kept]
    if not (np.isfinite(xy[cells]).all() and np.isfinite(yaw[cells]).all()):
        raise ValueError("a state is not finite")
    sizes = np.array([SIZES_M[AgentClass(kind)] for kind in kinds if kind is not None])
    return annotated_tracks(ids, kinds, sizes, xy, yaw, DT_S)
