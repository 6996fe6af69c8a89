"""Window files small enough to be worked out by hand, and random ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data.window_arrays import WindowFileBuilder, crop, window_arrays
from advdiff_sumo.data.window_files import WindowFile
from advdiff_sumo.maps.vector_map import PieceTable


def straight_table() -> PieceTable:
    """Return one eastbound lane from x = 0 to 100 at y = 0 in five pieces, the last one signalled, and one edge."""
    starts = 20.0 * np.arange(5)
    lane = np.stack((starts[:, None] + np.linspace(0, 20, 6), np.zeros((5, 6))), axis=-1)
    edge = np.stack((np.linspace(0, 20, 6), np.full(6, -1.6)), axis=-1)
    features = np.zeros((6, 10))
    features[:5, [0, 1, 2, 8]] = 3.2, 14.0, 1.0, 1.0
    features[5, 4] = 1.0
    signal = np.array([-1, -1, -1, -1, 0, -1])
    return PieceTable(np.concatenate((lane, edge[None])), features, signal, (("J", 0),))


def three_cars(steps: int = 20, dt_s: float = 0.5) -> Tracks:
    """Return "a" at 10 m/s from x = 0, "b" parked at (30, 3), "c" at 5 m/s from x = 90, there from instant 3 to 9."""
    t = dt_s * np.arange(steps)
    xy = np.zeros((3, steps, 2))
    xy[0, :, 0], xy[1], xy[2, :, 0] = 10.0 * t, (30.0, 3.0), 90.0 + 5.0 * t
    valid = np.ones((3, steps), dtype=np.bool_)
    valid[2] = (np.arange(steps) >= 3) & (np.arange(steps) <= 9)
    speed = np.repeat([[10.0], [0.0], [5.0]], steps, axis=1)
    yaw = np.zeros((3, steps))
    xy[~valid], yaw[~valid], speed[~valid] = np.nan, np.nan, np.nan
    size = np.array([[4.0, 2.0], [5.0, 2.0], [12.0, 2.5]])
    return Tracks(("a", "b", "c"), np.array([0, 0, 2]), size, xy, yaw, speed, valid, 0.0, dt_s)


PARKED = np.array([False, True, False])


def small_file() -> WindowFile:
    """Return two windows of :func:`three_cars`: around "a" at instant 4 and around "c" at instant 6."""
    tracks, table = three_cars(), straight_table()
    builder = WindowFileBuilder(table, "lane", "by hand", {"note": "ä"})
    for now, focal, light, scene in ((4, 0, "r", "first"), (6, 2, "G", "second")):
        rows = crop(tracks.xy_m[:, now], focal)
        builder.windows.append(window_arrays(tracks, now, rows, PARKED, table, {"J": light}, scene))
    return builder.build()


def random_file(seed: int, windows: int) -> WindowFile:
    """Return *windows* windows of random numbers that satisfy every rule of the format."""
    rng = np.random.default_rng(seed)
    counts = rng.integers(1, 7, windows)
    agents = int(counts.sum())
    past_valid, future_valid = rng.random((agents, 5)) < 0.7, rng.random((agents, 12)) < 0.7
    past_valid[:, -1] = True
    base = small_file()

    def numbers(*shape: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
        return rng.normal(size=shape).astype(np.float32)

    return replace(
        base,
        offset=np.concatenate(([0], np.cumsum(counts))).astype(np.int64),
        past=np.where(past_valid[..., None], numbers(agents, 5, 4), np.float32(0)),
        past_valid=past_valid,
        future=np.where(future_valid[..., None], numbers(agents, 12, 4), np.float32(0)),
        future_valid=future_valid,
        size=np.abs(numbers(agents, 2)) + np.float32(1),
        classes=rng.integers(0, 6, agents).astype(np.uint8),
        parked=rng.random(agents) < 0.3,
        near=rng.integers(-1, len(base.map_xy), (agents, 40)).astype(np.int32),
        signals=rng.integers(0, 4, (windows, 1)).astype(np.uint8),
        scene=rng.integers(0, 2, windows).astype(np.int32),
    )
