"""Reads ScenarioNet records of nuScenes, Waymo and other drives (Li et al. 2023, arXiv:2306.12241): pickles, 10 Hz."""

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
from advdiff_sumo.data.motion import annotated_tracks, parked_agents, signed_speeds, without_jitter
from advdiff_sumo.data.nuscenes import ZOE_CENTRE_AHEAD_M, ZOE_LENGTH_M, ZOE_WIDTH_M
from advdiff_sumo.data.nuscenes_index import agent_class
from advdiff_sumo.data.pickles import load_plain
from advdiff_sumo.data.scene_files import SceneFiles

LORRY_LENGTH_M = 7.0  # vehicles longer than this are trucks
SIMULATED = "advdiff-sumo"
"""Dataset name of episodes that this package exported; their positions have no annotation noise to remove."""
_AT_ORIGIN_M = 0.01  # a position nearer than this is at the origin
_KINDS = {"PEDESTRIAN": AgentClass.PEDESTRIAN, "CYCLIST": AgentClass.BICYCLE}
_AGAIN = "convert the record again"


def read_record(path: str | Path) -> dict[str, Any]:
    """Return a record as ScenarioNet writes it: metadata, tracks, map_features, dynamic_map_states.

    Positions are in the record's own frame (see :func:`map_offset_m`).

    Raises:
        LogError: the file is missing or damaged, contains anything other than plain data, or is no record.
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
    """Return the offset (2,) from positions of *record* to its map's frame; None if it is unknown.

    - Records that MetaDrive moved state the map's origin in them (``old_origin_in_current_coordinate``).
    - ScenarioNet moves the tracks and maps of nuScenes records, so that the first ego pose is the origin, and does not
      store the offset. As it also moves the zeros of absent states, these show it.
    - A nuScenes record without absent states that does not begin at the origin was not moved.
    - Records of other datasets are in their map's frame.

    Raises:
        ValueError: the stored origin is not a position.
    """
    old_origin = record["metadata"].get("old_origin_in_current_coordinate")
    if old_origin is not None:
        origin = np.asarray(old_origin, dtype=np.float64).reshape(-1)[:2]
        if origin.shape != (2,) or not np.isfinite(origin).all():
            raise ValueError("its old_origin_in_current_coordinate is no place")
        return -origin
    if record["metadata"].get("dataset") != "nuscenes":
        return np.zeros(2)
    absent_xy = [_xy(track)[~_valid(track)] for _, track in sorted(record["tracks"].items())]
    moved_zeros = np.concatenate([np.zeros((0, 2)), *absent_xy])
    if len(moved_zeros) and np.ptp(moved_zeros, axis=0).max() <= 1e-6:
        return np.asarray(-moved_zeros[0], dtype=np.float64)
    return None if len(moved_zeros) or _begins_at_origin(record) else np.zeros(2)


def _begins_at_origin(record: Mapping[str, Any]) -> bool:
    """Return whether the ego's first position is the origin; True without one."""
    ego = record["tracks"].get(record["metadata"].get("sdc_id"))
    ego_xy = np.zeros((0, 2)) if ego is None else _xy(ego)[_valid(ego)]
    return len(ego_xy) == 0 or bool(np.abs(ego_xy[0]).max() < _AT_ORIGIN_M)


def _xy(track: Mapping[str, Any]) -> FloatArray:
    return np.asarray(track["state"]["position"], dtype=np.float64)[:, :2]


class ScenarioNetReader(SceneFiles):
    """Reads one record (``sd_*.pkl``) or those of a folder.

    A scene has the name of its file, as ScenarioNet's ids repeat between datasets.
    """

    kind, remedy = "record", _AGAIN

    def read_file(self, name: str, path: Path) -> LogScene:
        """Return the scene of a record, with its agents in its order, without obstacles."""
        return _scene(name, path, read_record(path))

    def paths(self) -> dict[Path, str]:
        """Return file → name of every record; folders are searched recursively."""
        paths = [self.path] if self.path.is_file() else sorted(self.path.rglob("sd_*.pkl"))
        if not paths:
            raise LogError(self.path, "no such record or folder of sd_*.pkl records", "give one of these")
        return {path: path.stem for path in paths}


def _scene(name: str, path: Path, record: Mapping[str, Any]) -> LogScene:
    meta = record["metadata"]
    is_nuscenes = meta.get("dataset") == "nuscenes"
    kinds = {key: _class_of(track) for key, track in record["tracks"].items()}
    ids = [key for key, kind in kinds.items() if kind is not None]
    if meta["sdc_id"] not in ids:
        raise ValueError(f"the recording vehicle '{meta['sdc_id']}' has no track")
    ego = ids.index(meta["sdc_id"])
    offset = map_offset_m(record)
    tracks = _tracks(record, ids, np.zeros(2) if offset is None else offset)
    if is_nuscenes:
        tracks = _with_zoe(tracks, ego)
    parked = parked_agents(tracks.xy_m, tracks.valid, tracks.dt_s)
    parked[ego] = False
    if meta.get("dataset") != SIMULATED:
        tracks = without_jitter(tracks, parked, ego)
    location = str(meta.get("map", "")) if is_nuscenes and offset is not None else ""
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
    return annotated_tracks(ids, [_class_of(row) for row in rows], sizes, xy, yaw, dt_s)


def _with_zoe(tracks: Tracks, ego: int) -> Tracks:
    """Move the ego of a nuScenes record from its rear axle to its box centre, and set its true size.

    ScenarioNet takes the rear axle for the box centre, and swaps length and width (metadriverse/scenarionet issue 68).
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
    """Return the median length and width over the valid states."""
    valid = _valid(track)
    if not valid.any():
        raise ValueError(f"track '{track['metadata'].get('object_id')}' is never valid")
    length, width = (
        float(np.median(np.asarray(track["state"][key]).reshape(-1)[valid])) for key in ("length", "width")
    )
    return length, width


def _class_of(track: Mapping[str, Any]) -> AgentClass | None:
    """Return the class by the nuScenes category, else by ScenarioNet's type and the length; None: leave it out."""
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
    """Return the time step, which must be constant within 10 %."""
    times = np.asarray(record["metadata"]["ts"], dtype=np.float64).reshape(-1)
    if len(times) < 2:
        raise ValueError("it has fewer than two instants")
    spacing = float(np.median(np.diff(times)))
    if not spacing > 0.0 or np.abs(np.diff(times) / spacing - 1.0).max() > 0.1:
        raise ValueError("its instants are not evenly spaced")
    return round(spacing, 3)
