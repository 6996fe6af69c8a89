"""A nuScenes dataset small enough to be worked out by hand."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Tables = dict[str, list[dict[str, Any]]]
START_US = 1_533_000_000_000_000


def quaternion(yaw_rad: float) -> list[float]:
    return [math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)]


def _box(n: int, instance: str, x: float, y: float, yaw: float, size: list[float]) -> dict[str, Any]:
    return {
        "token": f"{instance}-{n}",
        "sample_token": f"s{n}",
        "instance_token": instance,
        "attribute_tokens": [],
        "translation": [x, y, 0.0],
        "size": size,
        "rotation": quaternion(yaw),
    }


def tiny_tables() -> Tables:
    """Return one scene of five keyframes.

    The ego drives north at 10 m/s; "van" drives west at 4 m/s and is not annotated at keyframe 2; "still"
    is parked with 10 cm of noise; "reverse" backs off at 2 m/s; a cone stands by.
    """
    tables: Tables = {
        "log": [{"token": "l", "location": "old-town"}],
        "scene": [{"token": "sc", "log_token": "l", "nbr_samples": 5, "name": "scene-0001"}],
        "category": [
            {"token": "c-car", "name": "vehicle.car"},
            {"token": "c-bus", "name": "vehicle.bus.rigid"},
            {"token": "c-walk", "name": "human.pedestrian.adult"},
            {"token": "c-cone", "name": "movable_object.trafficcone"},
        ],
        "instance": [
            {"token": "van", "category_token": "c-bus"},
            {"token": "cone", "category_token": "c-cone"},
            {"token": "still", "category_token": "c-car"},
            {"token": "reverse", "category_token": "c-car"},
        ],
        "attribute": [],
        "sample": [],
        "sample_data": [],
        "ego_pose": [],
        "sample_annotation": [],
    }
    for n in range(5):
        time_us = START_US + 500_000 * n
        tables["sample"].append({"token": f"s{n}", "timestamp": time_us, "scene_token": "sc"})
        pose = {"translation": [100.0, 5.0 * n, 0.0], "rotation": quaternion(math.pi / 2)}
        tables["ego_pose"].append({"token": f"e{n}", "timestamp": time_us, **pose})
        late = {"translation": [100.0, 5.0 * n + 0.4, 0.0], "rotation": quaternion(math.pi / 2)}
        tables["ego_pose"].append({"token": f"camera{n}", "timestamp": time_us + 40_000, **late})
        for token, key, delay in ((f"camera{n}", True, 40_000), (f"e{n}", True, 0), (f"e{n}", False, 0)):
            tables["sample_data"].append(
                {
                    "token": f"d{token}{key}",
                    "sample_token": f"s{n}",
                    "ego_pose_token": token,
                    "timestamp": time_us + delay,
                    "is_key_frame": key,
                }
            )
        boxes = [
            _box(n, "cone", 1.0, 1.0, 0.0, [0.3, 0.3, 0.9]),
            _box(n, "still", 90.0 + (0.1 if n == 2 else 0.0), 4.0, 0.0, [1.8, 4.5, 1.6]),
            _box(n, "reverse", 80.0 - 1.0 * n, 0.0, 0.0, [1.9, 4.6, 1.6]),
        ]
        if n != 2:
            boxes.append(_box(n, "van", 50.0 - 2.0 * n, 7.0, math.pi, [2.5, 11.0, 3.0]))
        tables["sample_annotation"] += boxes
    return tables


@pytest.fixture
def tables() -> Tables:
    return tiny_tables()


@pytest.fixture
def write_dataset(tmp_path: Path) -> Callable[[Tables], Path]:
    """Return a function that writes tables as a dataset root and returns it."""

    def write(tables: Tables) -> Path:
        folder = tmp_path / "v1.0-mini"
        folder.mkdir(exist_ok=True)
        for name, rows in tables.items():
            (folder / f"{name}.json").write_text(json.dumps(rows, indent=0), encoding="utf-8")
        return tmp_path

    return write
