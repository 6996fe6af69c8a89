"""Computes statistics of window files: counts, classes, motion, gaps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.data.window_files import DT_S, PAST, WindowFile

QUANTILES = (0.01, 0.05, 0.5, 0.95, 0.99)
_MOVING_M = 1.0  # smallest distance from its present position that a moving agent reaches
_TURNING_M = 0.5  # shortest interval over which curvature is measured


@dataclass(frozen=True)
class WindowMotion:
    """The motion of S agent rows over the L = H + T instants of their windows.

    Attributes:
        states: (S, L, 4) x, y, yaw, speed.
        valid: (S, L) whether the agent has a state at each instant.
        step: (S, L − 1) whether both ends of an interval are valid.
    """

    states: FloatArray
    valid: BoolArray
    step: BoolArray

    @staticmethod
    def of(windows: WindowFile) -> WindowMotion:
        """Return the motion in *windows*, past and future joined."""
        states = np.concatenate((windows.past, windows.future), axis=1).astype(np.float64)
        valid = np.concatenate((windows.past_valid, windows.future_valid), axis=1)
        return WindowMotion(states, valid, valid[:, 1:] & valid[:, :-1])

    @property
    def moving(self) -> BoolArray:
        """(S,) whether the agent is at any instant a metre or more from its present position."""
        distance_m = np.linalg.norm(self.states[..., :2] - self.states[:, PAST - 1, None, :2], axis=-1)
        return np.asarray((np.where(self.valid, distance_m, 0.0) >= _MOVING_M).any(axis=1))

    @property
    def acceleration_mps2(self) -> FloatArray:
        """(K,) change of speed over each interval of moving agents."""
        is_kept = self.step & self.moving[:, None]
        return np.asarray((np.diff(self.states[..., 3], axis=1) / DT_S)[is_kept])

    @property
    def curvature_1pm(self) -> FloatArray:
        """(K,) absolute change of heading per metre over each interval of half a metre or more."""
        length_m = np.linalg.norm(np.diff(self.states[..., :2], axis=1), axis=-1)
        is_kept = self.step & (length_m >= _TURNING_M)
        return np.asarray(
            np.abs(wrap_angle(np.diff(self.states[..., 2], axis=1))[is_kept] / length_m[is_kept])
        )

    @property
    def gaps(self) -> int:
        """Number of instants without a state between instants with one."""
        has_later = np.flip(np.maximum.accumulate(np.flip(self.valid, axis=1), axis=1), axis=1)
        has_earlier = np.maximum.accumulate(self.valid, axis=1)
        return int((~self.valid & has_later & has_earlier).sum())


def window_stats(files: Iterable[WindowFile]) -> dict[str, Any]:
    """Return the statistics of *files* as nested plain values; units are part of the names.

    Raises:
        ValueError: there is no file.
    """
    files = list(files)
    if not files:
        raise ValueError("no window file")
    motions = [WindowMotion.of(file) for file in files]
    agents = np.concatenate([np.diff(file.offset) for file in files])
    parked = np.concatenate([file.parked for file in files])
    moving = np.concatenate([motion.moving for motion in motions])
    speeds = np.concatenate([m.states[:, PAST - 1, 3][m.moving] for m in motions])
    return {
        "files": len(files),
        "maps": len({(file.map_name, *file.map_origin.tolist(), len(file.map_xy)) for file in files}),
        "windows": int(sum(file.windows for file in files)),
        "scenes": int(sum(len(file.scene_names) for file in files)),
        "agents": int(agents.sum()),
        "agents_per_window": _spread(agents.astype(np.float64)),
        "classes_share": _classes(files),
        "parked_share": _mean(parked),
        "moving_share": _mean(moving),
        "waiting_share": _mean(~moving & ~parked),
        "focal_moving_share": _mean(
            np.concatenate([m.moving[f.offset[:-1]] for m, f in zip(motions, files, strict=True)])
        ),
        "moving_speed_mps": _spread(speeds),
        "moving_acceleration_mps2": _spread(np.concatenate([m.acceleration_mps2 for m in motions])),
        "curvature_1pm": _spread(np.concatenate([m.curvature_1pm for m in motions])),
        "past_missing_share": _mean(np.concatenate([~f.past_valid.ravel() for f in files])),
        "future_missing_share": _mean(np.concatenate([~f.future_valid.ravel() for f in files])),
        "whole_future_share": _mean(np.concatenate([f.future_valid.all(axis=1) for f in files])),
        "gap_instants": sum(motion.gaps for motion in motions),
        "map_pieces_per_agent": _spread(np.concatenate([(f.near >= 0).sum(axis=1) for f in files])),
        "windows_with_signals_share": _mean(
            np.concatenate([_sees_signal(file) for file in files]).astype(np.bool_)
        ),
    }


def _classes(files: list[WindowFile]) -> Mapping[str, float]:
    counts: Counter[int] = Counter()
    for file in files:
        counts.update(dict(enumerate(np.bincount(file.classes, minlength=len(AgentClass)).tolist())))
    total = max(sum(counts.values()), 1)
    return {kind.name.lower(): round(counts[int(kind)] / total, 4) for kind in AgentClass}


def _sees_signal(windows: WindowFile) -> BoolArray:
    """Return (W,) whether each window has a lit signal on a piece near one of its agents."""
    signal = np.append(windows.map_signal, -1)[windows.near]  # near = −1 selects the appended −1
    window = np.repeat(np.arange(windows.windows), np.diff(windows.offset))
    states = np.column_stack((windows.signals, np.zeros(windows.windows, dtype=np.uint8)))
    has_lit_signal = (states[window[:, None], signal] > 0).any(axis=1)
    return np.asarray(np.bincount(window, weights=has_lit_signal, minlength=windows.windows) > 0)


def _mean(values: BoolArray) -> float:
    return round(float(values.mean()), 4) if len(values) else 0.0


def _spread(values: FloatArray) -> dict[str, float]:
    if len(values) == 0:
        return {}
    quantiles = {f"p{100 * q:g}": round(float(np.quantile(values, q)), 4) for q in QUANTILES}
    return {"min": round(float(values.min()), 4), **quantiles, "max": round(float(values.max()), 4)}
