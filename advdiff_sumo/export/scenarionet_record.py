"""Writes and reads ScenarioNet records (Li et al. 2023, arXiv:2306.12241): pickles of containers and NumPy arrays.

The keys are those of MetaDrive's ``ScenarioDescription``. ``advdiff-sumo run --scenes`` reads a record as a driving
log, and ``advdiff-sumo convert`` converts its map into a net.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import LogError
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.data import ScenarioNetReader
from advdiff_sumo.data.scenarionet_log import SIMULATED as DATASET
from advdiff_sumo.data.scenarionet_log import read_record
from advdiff_sumo.export.export_scene import MARGIN_M, ExportScene, ImportedScene
from advdiff_sumo.export.importers.assemble import reading
from advdiff_sumo.export.lane_use import LaneKind, lane_kind
from advdiff_sumo.maps import Lane

VERSION = "1"
_PROTOCOL = 4  # every Python on which ScenarioNet runs can read it
#: MetaDrive's type, nuScenes' category (which distinguishes truck and bus), and a usual height in m.
TYPES = {
    AgentClass.CAR: ("VEHICLE", "vehicle.car", 1.6),
    AgentClass.TRUCK: ("VEHICLE", "vehicle.truck", 3.2),
    AgentClass.BUS: ("VEHICLE", "vehicle.bus.rigid", 3.2),
    AgentClass.MOTORCYCLE: ("CYCLIST", "vehicle.motorcycle", 1.5),
    AgentClass.BICYCLE: ("CYCLIST", "vehicle.bicycle", 1.7),
    AgentClass.PEDESTRIAN: ("PEDESTRIAN", "human.pedestrian.adult", 1.8),
}
LANES = {
    LaneKind.CAR: "LANE_SURFACE_STREET",
    LaneKind.BUS: "LANE_BUS_LANE",
    LaneKind.BICYCLE: "LANE_BIKE_LANE",
}
CONNECTOR = "LANE_SURFACE_UNSTRUCTURE"


class ScenarioNet:
    """Exporter of a record in the net's frame, with all heights zero."""

    def write(self, scene: ExportScene, folder: Path) -> tuple[Path, ...]:
        """Write ``sd_advdiff-sumo_1_NAME.pkl``; the states of absent agents are zero, as in ScenarioNet."""
        path = folder / f"sd_{DATASET}_{VERSION}_{scene.name}.pkl"
        path.write_bytes(pickle.dumps(_record(scene), protocol=_PROTOCOL))
        return (path,)

    def read(self, path: Path) -> ImportedScene:
        """Return the trajectories."""
        return read_scenarionet(path)


def _record(scene: ExportScene) -> dict[str, Any]:
    tracks = scene.tracks
    return {
        "id": scene.name,
        "version": f"{DATASET} {VERSION}",
        "length": tracks.steps,
        "metadata": {
            "ts": np.round(tracks.times_s, 6),
            "metadrive_processed": False,
            "coordinate": "right-handed",
            "sdc_id": tracks.ids[scene.target],
            "dataset": DATASET,
            "scenario_id": scene.name,
            "id": scene.name,
            "map": scene.road.name,
            "sample_rate": tracks.dt_s,
        },
        "tracks": {name: _track(scene, row) for row, name in enumerate(tracks.ids)},
        "dynamic_map_states": {},
        "map_features": dict(_features(scene)),
    }


def _track(scene: ExportScene, row: int) -> dict[str, Any]:
    tracks = scene.tracks
    valid = tracks.valid[row]
    kind, category, height = TYPES[AgentClass(int(tracks.classes[row]))]
    yaw = np.where(valid, tracks.yaw_rad[row], 0.0)
    speed = np.where(valid, tracks.speed_mps[row], 0.0)
    length, width = (np.where(valid, size, 0.0) for size in tracks.size_m[row])
    position = np.zeros((tracks.steps, 3))
    position[valid, :2] = tracks.xy_m[row, valid]
    state = {
        "position": position,
        "heading": yaw,
        "velocity": np.where(valid[:, None], speed[:, None] * unit(yaw), 0.0),
        "valid": valid.copy(),
        "length": length,
        "width": width,
        "height": np.where(valid, height, 0.0),
    }
    metadata = {
        "track_length": tracks.steps,
        "type": category,
        "object_id": tracks.ids[row],
        "dataset": DATASET,
    }
    return {"type": kind, "state": state, "metadata": metadata}


def _features(scene: ExportScene) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the name and content of each map feature: lanes and road edges."""
    lanes = {lane.id: lane for lane in scene.lanes if lane_kind(lane) in LANES}
    entries: dict[str, list[str]] = {name: [] for name in lanes}
    exits: dict[str, list[str]] = {name: [] for name in lanes}
    for predecessor, successor in scene.joints(lanes):
        exits[predecessor].append(successor)
        entries[successor].append(predecessor)
    for name, lane in lanes.items():
        yield name, _lane(lane, lanes, entries[name], exits[name])
    area = shapely.box(*_extent(lanes)).buffer(MARGIN_M)
    for number, ring in enumerate(scene.road.area.smooth_rings()):
        for part, line in enumerate(_lines(shapely.LineString(ring).intersection(area))):
            yield f"edge_{number}_{part}", {"type": "ROAD_EDGE_BOUNDARY", "polyline": line}


def _lane(lane: Lane, lanes: dict[str, Lane], entries: list[str], exits: list[str]) -> dict[str, Any]:
    centre = lane.centre_xy_m
    left, right = (lane.line.offset(d).xy_m for d in (0.5 * lane.width_m, -0.5 * lane.width_m))
    neighbours = [[{"feature_id": name}] if name in lanes else [] for name in (lane.left_id, lane.right_id)]
    return {
        "type": CONNECTOR if lane.is_internal else LANES[lane_kind(lane)],
        "polyline": np.column_stack((centre, np.zeros(len(centre)))),
        "polygon": np.vstack((left, right[::-1])),
        "width": np.full((len(centre), 2), 0.5 * lane.width_m),
        "speed_limit_kmh": 3.6 * lane.speed_mps,
        "entry_lanes": entries,
        "exit_lanes": exits,
        "left_neighbor": neighbours[0],
        "right_neighbor": neighbours[1],
    }


def _extent(lanes: dict[str, Lane]) -> tuple[float, float, float, float]:
    points = np.vstack([lane.centre_xy_m for lane in lanes.values()]) if lanes else np.zeros((1, 2))
    low, high = points.min(axis=0), points.max(axis=0)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _lines(geometry: BaseGeometry) -> list[FloatArray]:
    parts = shapely.get_parts(geometry)
    return [shapely.get_coordinates(p) for p in parts if p.geom_type == "LineString" and not p.is_empty]


def read_scenarionet(path: Path) -> ImportedScene:
    """Return the trajectories in *path*; no code in the pickle is executed (see ``data.pickles``).

    Raises:
        FileError: it is missing, damaged or no record.
    """
    if not path.is_file():
        raise LogError(path, "no such file", "give a ScenarioNet record")
    log = ScenarioNetReader(path).read(path.stem)
    with reading(path, "a ScenarioNet record"):
        record = read_record(path)
        if record["metadata"].get("dataset") != DATASET:
            return ImportedScene(log.tracks, log.ego)  # measured velocities jitter, also of standing agents
        tracks = record["tracks"]
        velocity = np.array([np.asarray(tracks[name]["state"]["velocity"], float) for name in log.tracks.ids])
        along_mps = (velocity * unit(log.tracks.yaw_rad)).sum(axis=-1)
        speed = np.where(log.tracks.valid, along_mps, np.nan)
        return ImportedScene(replace(log.tracks, speed_mps=speed), log.ego)
