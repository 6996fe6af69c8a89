"""Check that poses of logged drives lie on the net's lanes as they lie on the lanes of the HD map."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import LogError
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.convert import ConversionResult
from advdiff_sumo.maps.convert.fidelity import statistics_of
from advdiff_sumo.maps.convert.written_net import read_net

NEAR_M = 15.0  # lanes farther from a pose are not considered
MAX_TURN_RAD = 1.0  # largest angle between a pose and the lane that it drives on
TABLES = ("ego_pose", "sample_data", "sample", "scene", "log")


def ego_poses(dataroot: Path, location: str) -> dict[str, FloatArray]:
    """Return the key-frame poses (N, 3; x, y in m, yaw in rad) of all logs at *location*, by scene name.

    Raises:
        LogError: the folder holds no nuScenes tables.
    """
    tables = _tables(dataroot)
    logs = {row["token"] for row in tables["log"] if row["location"] == location}
    scenes = {row["token"]: row["name"] for row in tables["scene"] if row["log_token"] in logs}
    scene_of = {row["token"]: scenes.get(row["scene_token"]) for row in tables["sample"]}
    poses = {row["token"]: row for row in tables["ego_pose"]}
    by_scene: dict[str, dict[str, tuple[float, float, float]]] = {}
    for row in tables["sample_data"]:
        name = scene_of.get(row["sample_token"])
        if name and row["is_key_frame"]:
            by_scene.setdefault(name, {})[row["sample_token"]] = _pose(poses[row["ego_pose_token"]])
    return {name: np.array(list(by_scene[name].values())) for name in sorted(by_scene)}


def _tables(dataroot: Path) -> dict[str, list[dict[str, Any]]]:
    folder = next((path.parent for path in sorted(dataroot.glob("v1.0-*/ego_pose.json"))), None)
    if folder is None:
        raise LogError(
            dataroot, "holds no v1.0-*/ego_pose.json", "give the root folder of a nuScenes data set"
        )
    try:
        return {name: json.loads((folder / f"{name}.json").read_text(encoding="utf-8")) for name in TABLES}
    except (OSError, ValueError) as error:
        raise LogError(folder, f"a table cannot be read ({error})", "unpack the data set again") from None


def _pose(row: dict[str, Any]) -> tuple[float, float, float]:
    w, x, y, z = row["rotation"]
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return float(row["translation"][0]), float(row["translation"][1]), float(yaw)


def compare_poses(result: ConversionResult, poses: FloatArray) -> dict[str, Any]:
    """Return how many poses (N, 3) lie on a lane of the net, and how lateral offsets in net and HD map differ."""
    if not len(poses):
        return {"poses": 0}
    net = read_net(result.net)
    written = [*net.lanes.values(), *net.connections.values()]
    source = [(track.centre_m, track.width_m) for track in result.tracks]
    on_net, net_offset = nearest_offsets(written, poses)
    on_map, map_offset = nearest_offsets(source, poses)
    difference = np.abs(net_offset - map_offset)
    off_lane = np.isnan(net_offset) & np.isnan(map_offset)  # near no lane of either: they agree
    return {
        "poses": len(poses),
        "on_a_lane_of_the_net": int(on_net.sum()),
        "on_a_lane_of_the_map": int(on_map.sum()),
        "lateral_offset_in_the_net_m": statistics_of([net_offset]),
        "lateral_offset_in_the_map_m": statistics_of([map_offset]),
        "difference_m": statistics_of([difference]),
        "differences_above_0.05_m": int((~(difference <= 0.05) & ~off_lane).sum()),
    }


def nearest_offsets(
    lanes: Sequence[tuple[FloatArray, float]], poses: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return whether each pose (N, 3) is on a lane (N,), and its distance (N,) in m from the nearest centre line.

    *lanes* are centre lines and widths in m. Only lanes that run about in the direction of the pose count. A pose is on
    a lane if its centre lies within half the lane's width of the centre line. NaN: no lane is near.
    """
    tree = shapely.STRtree([shapely.LineString(line) for line, _ in lanes])
    on_lane = np.zeros(len(poses), dtype=bool)
    offset = np.full(len(poses), np.nan)
    for index, (x, y, yaw) in enumerate(poses):
        for number in tree.query(shapely.Point(x, y), predicate="dwithin", distance=NEAR_M):
            line, width = lanes[number]
            s, aside = polyline.project(line, np.array([[x, y]]))
            turn = abs((float(polyline.heading(line, s)[0]) - yaw + np.pi) % (2 * np.pi) - np.pi)
            if turn <= MAX_TURN_RAD:
                on_lane[index] |= abs(aside[0]) <= 0.5 * width
                offset[index] = np.nanmin((offset[index], abs(aside[0])))
    return on_lane, offset
