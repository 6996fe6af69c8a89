"""ScenarioNet records of nuScenes and Waymo drives (Li et al. 2023, arXiv:2306.12241): pickles, 10 Hz."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.errors import LogError
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.data.log_reader import LogScene
from advdiff_sumo.data.motion import annotated, parked_agents, signed_speeds, without_jitter
from advdiff_sumo.data.nuscenes import ZOE_CENTRE_AHEAD_M, ZOE_LENGTH_M, ZOE_WIDTH_M
from advdiff_sumo.data.nuscenes_index import agent_class
from advdiff_sumo.data.pickles import load_plain
from advdiff_sumo.data.scene_files import SceneFiles

LORRY_LENGTH_M = 7.0
SIMULATED = "advdiff-sumo"
"""The dataset of episodes that are exported here: places are exact, and who creeps does creep."""
_AT_ORIGIN_M = 0.01
_KINDS = {"PEDESTRIAN": AgentClass.PEDESTRIAN, "CYCLIST": AgentClass.BICYCLE}
_AGAIN = "convert the record again"


def read_record(path: str | Path) -> dict[str, Any]:
    """Return a record as ScenarioNet wrote it: metadata, tracks, map_features, dynamic_map_states.

    Positions are in the record's own frame (see :func:`map_offset_m`).

    Raises:
        LogError: the file is missing, damaged, holds anything but plain data, or is no record.
    """
    path = Path(path)
    record = load_plain(path)
    if not isinstance(record, dict):
        raise LogError(path, "holds no record", "give a ScenarioNet scenario, not its summary")
    for key in ("id", "length", "metadata", "tracks", "map_features"):
        if key not in record:
            raise LogError(path, f"has no '{key}'", "give a ScenarioNet scenario, not its summary")
    return record


def map_offset_m(record: Mapping[str, Any]) -> FloatArray | None:
    """Return what to add to positions (2,) of *record* to be in its map's frame; None where it is lost.

    MetaDrive writes down where the map's origin is in a record that it moved (``old_origin_in_current_coordinate``).
    ScenarioNet moves nuScenes records, tracks and map alike, so that the first ego pose is the origin, and does not
    write it down; but it moves the zeros of absent states too, which give it away. A record of nuScenes that does not
    begin at the origin was not moved; others are in their dataset's frame.

    Raises:
        ValueError: what the record tells of its frame is no place.
    """
    old_origin = record["metadata"].get("old_origin_in_current_coordinate")
    if old_origin is not None:
        origin = np.asarray(old_origin, dtype=np.float64).reshape(-1)[:2]
        if origin.shape != (2,) or not np.isfinite(origin).all():
            raise ValueError("its old_origin_in_current_coordinate is no place")
        return -origin
    if record["metadata"].get("dataset") != "nuscenes":
        return np.zeros(2)
    absent = [_xy(track)[~_valid(track)] for _, track in sorted(record["tracks"].items())]
    moved = np.concatenate([np.zeros((0, 2)), *absent])
    if len(moved) and np.ptp(moved, axis=0).max() <= 1e-6:
        return np.asarray(-moved[0], dtype=np.float64)
    return None if len(moved) or _begins_at_origin(record) else np.zeros(2)


def _begins_at_origin(record: Mapping[str, Any]) -> bool:
    ego = record["tracks"].get(record["metadata"].get("sdc_id"))
    there = np.zeros((0, 2)) if ego is None else _xy(ego)[_valid(ego)]
    return len(there) == 0 or bool(np.abs(there[0]).max() < _AT_ORIGIN_M)


def _xy(track: Mapping[str, Any]) -> FloatArray:
    return np.asarray(track["state"]["position"], dtype=np.float64)[:, :2]


class ScenarioNetReader(SceneFiles):
    """Reads the records (``sd_*.pkl``) of a folder, or one record.

    A scene is named by its file: ScenarioNet's ids repeat between datasets.
    """

    kind, remedy = "record", _AGAIN

    def read_file(self, name: str, path: Path) -> LogScene:
        """Return the scene of a record; agents in its order, obstacles left out."""
        return _scene(name, path, read_record(path))

    def paths(self) -> dict[Path, str]:
        """Return file → name of every record, searched recursively."""
        paths = [self.path] if self.path.is_file() else sorted(self.path.rglob("sd_*.pkl"))
        if not paths:
            raise LogError(self.path, "no such record or folder of sd_*.pkl records", "give one of these")
        return {path: path.stem for path in paths}


def _scene(name: str, path: Path, record: Mapping[str, Any]) -> LogScene:
    meta = record["metadata"]
    nuscenes = meta.get("dataset") == "nuscenes"
    kinds = {key: _class_of(track) for key, track in record["tracks"].items()}
    ids = [key for key, kind in kinds.items() if kind is not None]
    if meta["sdc_id"] not in ids:
        raise ValueError(f"the recording vehicle '{meta['sdc_id']}' has no track")
    ego = ids.index(meta["sdc_id"])
    offset = map_offset_m(record)
    tracks = _tracks(record, ids, np.zeros(2) if offset is None else offset)
    if nuscenes:
        tracks = _with_zoe(tracks, ego)
    parked = parked_agents(tracks.xy_m, tracks.valid, tracks.dt_s)
    parked[ego] = False
    if meta.get("dataset") != SIMULATED:
        tracks = without_jitter(tracks, parked, ego)
    location = str(meta.get("map", "")) if nuscenes and offset is not None else ""
    return LogScene(name, location, tracks, ego, parked, path)


def _tracks(record: Mapping[str, Any], ids: list[str], offset_m: FloatArray) -> Tracks:
    rows = [record["tracks"][key] for key in ids]
    valid = np.array([_valid(row) for row in rows])
    xy = np.array([np.asarray(row["state"]["position"], dtype=np.float64)[:, :2] for row in rows]) + offset_m
    yaw = np.array([np.asarray(row["state"]["heading"], dtype=np.float64).reshape(-1) for row in rows])
    dt_s = _spacing_s(record)
    xy[~valid], yaw[~valid] = np.nan, np.nan
    if not (np.isfinite(xy).all(-1) & np.isfinite(yaw))[valid].all():
        raise ValueError("a valid state is not finite")
    sizes = np.array([_size(row) for row in rows])
    return annotated(ids, [_class_of(row) for row in rows], sizes, xy, yaw, dt_s)


def _with_zoe(tracks: Tracks, ego: int) -> Tracks:
    """Move the ego of a nuScenes record from its rear axle to its box centre, and set its true size.

    ScenarioNet takes the ego pose as it is, and writes length and width the wrong way round
    (metadriverse/scenarionet issue 68).
    """
    tracks.xy_m[ego] += ZOE_CENTRE_AHEAD_M * unit(tracks.yaw_rad[ego])
    tracks.size_m[ego] = ZOE_LENGTH_M, ZOE_WIDTH_M
    tracks.speed_mps[ego] = signed_speeds(
        tracks.xy_m[[ego]], tracks.yaw_rad[[ego]], tracks.valid[[ego]], tracks.dt_s
    )[0]
    return tracks


def _valid(track: Mapping[str, Any]) -> BoolArray:
    return np.asarray(track["state"]["valid"]).astype(np.bool_).reshape(-1)


def _size(track: Mapping[str, Any]) -> tuple[float, float]:
    """Return median length and width over the valid states."""
    there = _valid(track)
    if not there.any():
        raise ValueError(f"track '{track['metadata'].get('object_id')}' is never valid")
    length, width = (
        float(np.median(np.asarray(track["state"][key]).reshape(-1)[there])) for key in ("length", "width")
    )
    return length, width


def _class_of(track: Mapping[str, Any]) -> AgentClass | None:
    """Return the class: of the nuScenes category where it is kept, else of ScenarioNet's type and length."""
    kind = str(track["type"])
    if not _valid(track).any():
        return None
    category = str(track["metadata"].get("type", ""))
    if "." in category:
        return agent_class(category)
    if kind == "VEHICLE":
        return AgentClass.TRUCK if _size(track)[0] > LORRY_LENGTH_M else AgentClass.CAR
    return _KINDS.get(kind)


def _spacing_s(record: Mapping[str, Any]) -> float:
    times = np.asarray(record["metadata"]["ts"], dtype=np.float64).reshape(-1)
    if len(times) < 2:
        raise ValueError("it has fewer than two instants")
    spacing = float(np.median(np.diff(times)))
    if not spacing > 0.0 or np.abs(np.diff(times) / spacing - 1.0).max() > 0.1:
        raise ValueError("its instants are not evenly spaced")
    return round(spacing, 3)
