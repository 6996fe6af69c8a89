"""ScenarioNet records of a synthetic drive along a synthetic street, in the format of ScenarioNet's converter."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np

DT_S, STEPS, SPEED_MPS = 0.1, 121, 9.0


def record(
    origin_m: tuple[float, float] = (0.0, 0.0),
    heading_rad: float = 0.0,
    *,
    place: str = "old-town",
    dataset: str = "nuscenes",
    told: bool = False,
) -> dict[str, Any]:
    """Return a drive that begins at *origin_m* in its map's frame, and is shifted so that this is (0, 0).

    Args:
        origin_m: where the ego's rear axle is at first.
        heading_rad: of the street, on which it drives for 12 s.
        place: name of the map.
        dataset: name of the data set.
        told: whether the record contains the shift, and no absent agent from which it could be computed.
    """
    along = np.array([np.cos(heading_rad), np.sin(heading_rad)])
    ego = SPEED_MPS * DT_S * np.arange(STEPS)[:, None] * along
    there = np.ones(STEPS, dtype=np.bool_)
    tracks = {"ego": _track(ego, heading_rad, there)}
    if not told:
        late = np.arange(STEPS) >= 20
        tracks["b"] = _track(
            np.where(late[:, None], ego + 30.0 * along, -np.array(origin_m)), heading_rad, late
        )
    metadata = {"dataset": dataset, "map": place, "sdc_id": "ego", "ts": DT_S * np.arange(STEPS)}
    if told:
        metadata["old_origin_in_current_coordinate"] = -np.array(origin_m)
    line = np.linspace(-60.0, 260.0, 33)[:, None] * along
    lane = {"type": "LANE_SURFACE_STREET", "polyline": line, "entry_lanes": [], "exit_lanes": []}
    further = {**lane, "polyline": line + 320.0 * along, "entry_lanes": ["1"]}
    return {
        "id": "drive",
        "version": "made",
        "length": STEPS,
        "metadata": metadata,
        "tracks": tracks,
        "dynamic_map_states": {},
        "map_features": {"1": {**lane, "exit_lanes": ["2"]}, "2": further},
    }


def write(path: Path, value: dict[str, Any]) -> Path:
    """Write a record to *path*."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(value, protocol=4))
    return path


def _track(xy_m: np.ndarray, yaw_rad: float, valid: np.ndarray) -> dict[str, Any]:
    return {
        "type": "VEHICLE",
        "state": {
            "position": np.column_stack((xy_m, np.zeros(STEPS))),
            "heading": np.full(STEPS, yaw_rad) * valid,
            "valid": valid.astype(float),
            "length": np.full((STEPS, 1), 4.5) * valid[:, None],
            "width": np.full((STEPS, 1), 1.8) * valid[:, None],
        },
        "metadata": {"type": "vehicle.car", "object_id": "x"},
    }
