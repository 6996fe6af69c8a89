"""Window files of a made-up road: cars at constant curvature and slowly changing speed, parked ones, a walker."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.data.window_files import FUTURE, PAST, WindowFile, write_windows

_STEPS = PAST + FUTURE
_DT_S = 0.5
_POINTS, _FEATURES, _NEAR = 6, 10, 40


def straight_road(lanes: int = 3, length_m: float = 400.0) -> tuple[np.ndarray, np.ndarray]:
    """Return pieces (M, 6, 2) and features (M, 10) of a road along x: 3.5 m lanes eastward, then both edges."""
    starts = np.arange(-length_m / 2, length_m / 2, 20.0)
    along = starts[:, None] + np.linspace(0.0, 20.0, _POINTS)
    rows, features = [], []
    for lane in range(lanes):
        rows.append(np.stack((along, np.full_like(along, 3.5 * lane)), axis=-1))
        features.append(np.tile([3.5, 14.0, 1, 0, 0, 0, 0, 0, 1, 0], (len(starts), 1)))
    for side, y in ((1, -1.75), (-1, 3.5 * lanes - 1.75)):  # the road lies on the left of its edge
        x = along[:, ::side]
        rows.append(np.stack((x, np.full_like(x, y)), axis=-1))
        features.append(np.tile([0, 0, 0, 0, 1, 0, 0, 0, 0, 0], (len(starts), 1)))
    return np.concatenate(rows), np.concatenate(features)


def _near(pieces: np.ndarray, is_edge: np.ndarray, xy: np.ndarray) -> np.ndarray:
    out = np.full((len(xy), _NEAR), -1, dtype=np.int32)
    distance = np.linalg.norm(pieces[None] - xy[:, None, None], axis=-1).min(-1)
    for kind, first, slots in ((False, 0, 28), (True, 28, 12)):
        rows = np.flatnonzero(is_edge == kind)
        for agent in range(len(xy)):
            seen = rows[distance[agent, rows] < 60.0]
            seen = seen[np.argsort(distance[agent, seen], kind="stable")][:slots]
            out[agent, first : first + len(seen)] = seen
    return out


def make_windows(count: int = 8, drives: int = 4, agents: int = 5, seed: int = 0) -> WindowFile:
    """Return *count* windows of *drives* drives with 2 … *agents* agents each."""
    rng = np.random.default_rng(seed)
    pieces, features = straight_road()
    states, sizes, classes, parked, offset = [], [], [], [], [0]
    for _ in range(count):
        number = int(rng.integers(2, agents + 1))
        for agent in range(number):
            still = agent == 1
            speed = 0.0 if still else rng.uniform(5.0, 13.0)
            accel = 0.0 if still else rng.uniform(-0.7, 0.7)
            time = (np.arange(_STEPS) - PAST + 1) * _DT_S
            x = rng.uniform(-60.0, 60.0) + speed * time + 0.5 * accel * time**2
            y = np.full(_STEPS, 3.5 * (agent % 3))
            states.append(np.stack((x, y, np.zeros(_STEPS), speed + accel * time), axis=-1))
            sizes.append((4.6, 1.9))
            classes.append(AgentClass.CAR)
            parked.append(still)
        offset.append(offset[-1] + number)
    array = np.array(states, dtype=np.float32)
    return WindowFile(
        map_origin=np.zeros(2),
        map_xy=pieces.astype(np.float32),
        map_features=features.astype(np.float32),
        map_signal=np.full(len(pieces), -1, dtype=np.int32),
        offset=np.array(offset, dtype=np.int64),
        past=array[:, :PAST],
        past_valid=np.ones((*array.shape[:1], PAST), dtype=np.bool_),
        future=array[:, PAST:],
        future_valid=np.ones((*array.shape[:1], FUTURE), dtype=np.bool_),
        size=np.array(sizes, dtype=np.float32),
        classes=np.array(classes, dtype=np.uint8),
        parked=np.array(parked, dtype=np.bool_),
        near=_near(pieces, features[:, 4] > 0.5, array[:, PAST - 1, :2]),
        signals=np.zeros((count, 0), dtype=np.uint8),
        scene=np.array([w % drives for w in range(count)], dtype=np.int32),
        scene_names=tuple(f"drive-{d}" for d in range(drives)),
        map_name="straight",
        source="test",
    )


def write(folder: Path, **options: int) -> Path:
    """Write one file into *folder* and return it."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "straight.safetensors"
    write_windows(path, make_windows(**options))
    return path
