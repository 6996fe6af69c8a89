"""A scene of four vehicles and its log, small enough to be worked out by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap


@pytest.fixture(scope="session")
def road(networks: Path) -> RoadMap:
    return RoadMap.read(networks / "motorway.net.xml")


@pytest.fixture
def log() -> Tracks:
    """Return 8 s at 2 Hz from t = −2 s: all vehicles drive east, in lanes 4 m apart.

    "ego" and "a" at 10 m/s throughout; "b" leaves after 1 s; "c" enters at 2 s; "d" stands; "flash" is
    seen once, at 1 s.
    """
    t = -2.0 + 0.5 * np.arange(17)
    ids = ("ego", "a", "b", "c", "d", "flash")
    valid = np.ones((6, 17), dtype=np.bool_)
    valid[2, t > 1.0] = False
    valid[3, t < 2.0] = False
    valid[5, t != 1.0] = False
    speed = np.array([10.0, 10.0, 5.0, 20.0, 0.0, 0.0])[:, None]
    x, y = speed * t, np.broadcast_to(4.0 * np.arange(6.0)[:, None], (6, 17))
    return Tracks(
        ids=ids,
        classes=np.zeros(6, dtype=np.int64),
        size_m=np.tile([4.5, 1.8], (6, 1)),
        xy_m=np.where(valid[..., None], np.stack((x, y), -1), np.nan),
        yaw_rad=np.where(valid, 0.0, np.nan),
        speed_mps=np.where(valid, speed, np.nan),
        valid=valid,
        t0_s=-2.0,
        dt_s=0.5,
    )


@pytest.fixture
def scene(log: Tracks) -> Scene:
    """Return the instant 0 with "ego" as the target and "d" not movable."""
    return scene_at(log, 0.0)


def scene_at(log: Tracks, now_s: float) -> Scene:
    last = round((now_s - log.t0_s) / log.dt_s)
    history = log.window(last - 4, last + 1)
    history = history.rows(history.valid[:, -1])
    movable = np.array([name not in ("ego", "d") for name in history.ids])
    return Scene(history, history.index["ego"], movable, ((),) * history.agents, {})
