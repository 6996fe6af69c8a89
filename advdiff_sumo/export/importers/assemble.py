"""Assembles tracks from the parts read from a file, and converts errors in the file into FileErrors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.errors import FileError, os_reason
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.data.motion import signed_speeds
from advdiff_sumo.export.export_scene import ImportedScene

AGAIN = "export the episode again"
_FAULTS = (KeyError, ValueError, TypeError, IndexError, AttributeError, OverflowError)
_MAX_STEP = 10_000_000


@dataclass(frozen=True)
class AgentPart:
    """A part of an agent's track with N instants.

    Attributes:
        name: name of the agent; several parts may have the same name.
        kind: its class.
        size_m: length and width of its box.
        step: (N,) instants.
        xy_m: (N, 2) box centres.
        yaw_rad: (N,) headings.
        speed_mps: (N,) speeds along the heading; None if the format has none.
        is_target: whether it is the target.
    """

    name: str
    kind: AgentClass
    size_m: tuple[float, float]
    step: IntArray
    xy_m: FloatArray
    yaw_rad: FloatArray
    speed_mps: FloatArray | None
    is_target: bool


@contextmanager
def reading(path: Path, what: str) -> Iterator[None]:
    """Convert errors due to missing or malformed values in *path* into a FileError; *what* names the kind of file."""
    try:
        yield
    except OSError as error:
        raise FileError(path, f"cannot be read ({os_reason(error)})", f"give {what}") from None
    except _FAULTS as error:
        problem = f"is not {what} as exported here ({type(error).__name__}: {error})"
        raise FileError(path, problem, AGAIN) from None


def assemble(parts: Sequence[AgentPart], dt_s: float) -> ImportedScene:
    """Return the scene of *parts* with time step *dt_s*; agents are in the order of their first parts.

    Raises:
        ValueError: there is not exactly one target, or a value is not finite or out of range.
    """
    ids = tuple(dict.fromkeys(part.name for part in parts))
    first = {part.name: part for part in reversed(parts)}
    targets = [row for row, name in enumerate(ids) if first[name].is_target]
    if len(targets) != 1:
        raise ValueError(f"it has {len(targets)} targets")
    last = max(int(part.step.max()) for part in parts)
    if min(int(part.step.min()) for part in parts) < 0 or last > _MAX_STEP:
        raise ValueError("an instant is out of range")
    shape = (len(ids), last + 1)
    xy, yaw, speed = np.full((*shape, 2), np.nan), np.full(shape, np.nan), np.full(shape, np.nan)
    for part in parts:
        row = ids.index(part.name)
        xy[row, part.step], yaw[row, part.step] = part.xy_m, wrap_angle(part.yaw_rad)
        if part.speed_mps is not None:
            speed[row, part.step] = part.speed_mps
    valid = np.isfinite(yaw) & np.isfinite(xy).all(-1)
    if int(valid.sum()) != sum(len(part.step) for part in parts):
        raise ValueError("a value is not finite, or an instant is there twice")
    if not np.isfinite(speed[valid]).all():
        speed = signed_speeds(xy, yaw, valid, dt_s)
    classes = np.array([int(first[name].kind) for name in ids], dtype=np.int64)
    size = np.array([first[name].size_m for name in ids], dtype=np.float64)
    tracks = Tracks(ids, classes, size, xy, yaw, speed, valid, 0.0, dt_s)
    return ImportedScene(tracks, targets[0])


def spacing_s(times_s: FloatArray) -> float:
    """Return the time step of *times_s* (N,), the least difference, to the microsecond; 0.1 for a single time.

    Raises:
        ValueError: the times are not multiples of it, or not finite.
    """
    distinct = np.unique(times_s)
    if not np.isfinite(distinct).all() or not len(distinct):
        raise ValueError("a time is not finite")
    if len(distinct) == 1:
        return 0.1
    spacing = round(float(np.diff(distinct).min()), 6)
    if not spacing > 0.0 or np.abs(distinct / spacing - np.round(distinct / spacing)).max() > 1e-3:
        raise ValueError("its instants are not evenly spaced")
    return spacing


def steps_of(times_s: FloatArray, dt_s: float) -> IntArray:
    """Return the steps (N,) of *times_s*."""
    return np.asarray(np.round(times_s / dt_s), dtype=np.int64)
