"""Converts tracks and a table of map pieces into the arrays of a window file; needs only NumPy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data.window_files import CROP_M, FUTURE, MAX_AGENTS, PAST, WindowFile

if TYPE_CHECKING:
    from advdiff_sumo.maps.vector_map import PieceTable


@dataclass(frozen=True)
class WindowArrays:
    """One window with A agents, the focal one first. Arrays as in :class:`WindowFile`, in the map's frame.

    Attributes:
        past: (A, H, 4) x, y, yaw, speed; the last instant is the present one.
        past_valid: (A, H) whether the agent has a state at each instant.
        future: (A, T, 4) x, y, yaw, speed.
        future_valid: (A, T) whether the agent has a state at each instant.
        size: (A, 2) length and width.
        classes: (A,) classes.
        parked: (A,) whether the agent is parked.
        near: (A, K) rows of map pieces, padded with −1.
        signals: (G,) present states of the signals.
        scene: name of the drive or run.
    """

    past: FloatArray
    past_valid: BoolArray
    future: FloatArray
    future_valid: BoolArray
    size: FloatArray
    classes: IntArray
    parked: BoolArray
    near: NDArray[np.int32]
    signals: NDArray[np.uint8]
    scene: str


def crop(xy_m: FloatArray, focal: int) -> NDArray[np.int64]:
    """Return the rows of up to ``MAX_AGENTS`` agents within ``CROP_M`` of the focal agent, the nearest first.

    The focal agent comes first. Agents at the same distance are in the order of rows.

    Args:
        xy_m: (A, 2) present positions; NaN for absent agents.
        focal: row of the focal agent, which must be present.
    """
    distance_m = np.linalg.norm(xy_m - xy_m[focal], axis=-1)
    distance_m[focal] = -1.0
    order = np.argsort(np.where(np.isnan(distance_m), np.inf, distance_m), kind="stable")[:MAX_AGENTS]
    return np.asarray(order[distance_m[order] <= CROP_M], dtype=np.int64)


def crops(xy_m: FloatArray, order: IntArray, most: int, apart: int = 10) -> Iterator[NDArray[np.int64]]:
    """Yield crops around several agents at one instant, with little overlap.

    Args:
        xy_m: (A, 2) present positions; NaN for absent agents.
        order: candidates for the focal agent, in order of preference.
        most: maximum number of crops.
        apart: number of agents of a crop, the nearest with the focal one, that cannot be focal agents of later crops.
    """
    excluded: set[int] = set()
    count = 0
    for focal in order.tolist():
        if count == most:
            return
        if focal not in excluded:
            rows = crop(xy_m, focal)
            excluded.update(rows[:apart].tolist())
            count += 1
            yield rows


def window_arrays(
    tracks: Tracks,
    now: int,
    rows: IntArray,
    parked: BoolArray,
    table: PieceTable,
    signals: Mapping[str, str],
    scene: str,
) -> WindowArrays:
    """Return the window of the agents *rows* at instant *now* of *tracks*, which have a spacing of 0.5 s.

    Instants before the beginning or after the end of the tracks are not valid.

    Args:
        tracks: (A, L) states in the map's frame.
        now: the present instant, at which all of *rows* must be present.
        rows: (A',) agents, the focal one first.
        parked: (A,) whether each agent is parked.
        table: pieces of the map.
        signals: traffic light id → its present state string.
        scene: name of the drive or run.

    Raises:
        ValueError: one of *rows* is absent at the present instant.
    """
    if not tracks.valid[rows, now].all():
        raise ValueError(f"an agent of the window at instant {now} of {scene} is not there")
    states = np.concatenate(
        (tracks.xy_m[rows], tracks.yaw_rad[rows, :, None], tracks.speed_mps[rows, :, None]), axis=-1
    )
    valid = tracks.valid[rows]
    past, past_valid = _cut(states, valid, now - PAST + 1, PAST)
    future, future_valid = _cut(states, valid, now + 1, FUTURE)
    present = past[:, -1]
    return WindowArrays(
        past=past,
        past_valid=past_valid,
        future=future,
        future_valid=future_valid,
        size=tracks.size_m[rows],
        classes=tracks.classes[rows],
        parked=parked[rows],
        near=table.rows_near(present[:, :2], present[:, 2], present[:, 3]),
        signals=table.signal_states(signals),
        scene=scene,
    )


def _cut(states: FloatArray, valid: BoolArray, start: int, length: int) -> tuple[FloatArray, BoolArray]:
    """Return the states and masks of *length* instants from *start* on; invalid states are zero."""
    instant = start + np.arange(length)
    is_inside = (instant >= 0) & (instant < valid.shape[1])
    instant = np.clip(instant, 0, valid.shape[1] - 1)
    is_valid = valid[:, instant] & is_inside
    return np.where(is_valid[..., None], states[:, instant], 0.0), is_valid


@dataclass
class WindowFileBuilder:
    """Collects windows of one map into a :class:`WindowFile`.

    Attributes:
        table: pieces of the map.
        map_name: name of the net.
        source: origin of the windows.
        extra: further entries of the file's header.
        windows: the windows collected so far.
    """

    table: PieceTable
    map_name: str
    source: str
    extra: Mapping[str, str] = field(default_factory=dict)
    windows: list[WindowArrays] = field(default_factory=list)

    def build(self) -> WindowFile:
        """Return all windows in the order in which they were added; the origin is the middle of the map."""
        table, windows = self.table, self.windows
        points = table.xy_m.reshape(-1, 2)
        origin = np.round(0.5 * (points.min(axis=0) + points.max(axis=0))) if len(points) else np.zeros(2)
        names = tuple(dict.fromkeys(window.scene for window in windows))
        scene_row = {name: row for row, name in enumerate(names)}
        return WindowFile(
            map_origin=origin,
            map_xy=(table.xy_m - origin).astype(np.float32),
            map_features=table.features.astype(np.float32),
            map_signal=table.signal.astype(np.int32),
            offset=np.cumsum([0, *(len(window.size) for window in windows)], dtype=np.int64),
            past=_states([w.past for w in windows], [w.past_valid for w in windows], origin, PAST),
            past_valid=_joined([w.past_valid for w in windows], (0, PAST)).astype(np.bool_),
            future=_states([w.future for w in windows], [w.future_valid for w in windows], origin, FUTURE),
            future_valid=_joined([w.future_valid for w in windows], (0, FUTURE)).astype(np.bool_),
            size=_joined([w.size for w in windows], (0, 2)).astype(np.float32),
            classes=_joined([w.classes for w in windows], (0,)).astype(np.uint8),
            parked=_joined([w.parked for w in windows], (0,)).astype(np.bool_),
            near=_joined([w.near for w in windows], (0, 0)).astype(np.int32),
            signals=np.array([w.signals for w in windows], dtype=np.uint8).reshape(
                len(windows), len(table.signal_links)
            ),
            scene=np.array([scene_row[w.scene] for w in windows], dtype=np.int32),
            scene_names=names,
            map_name=self.map_name,
            source=self.source,
            extra=self.extra,
        )


def _states(
    parts: Sequence[FloatArray], masks: Sequence[BoolArray], origin: FloatArray, steps: int
) -> NDArray[np.float32]:
    states = _joined(parts, (0, steps, 4))
    valid = _joined(masks, (0, steps)).astype(np.bool_)
    shifted = states - np.concatenate((origin, np.zeros(2)))
    return np.where(valid[..., None], shifted, 0.0).astype(np.float32)


def _joined(parts: Sequence[NDArray[np.generic]], empty: tuple[int, ...]) -> FloatArray:
    return np.concatenate(parts).astype(np.float64) if parts else np.zeros(empty)
