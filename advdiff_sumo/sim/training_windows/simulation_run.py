"""One simulation run of natural traffic, cut into windows."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.bicycle import Limits
from advdiff_sumo.core.boxes import corners, overlap
from advdiff_sumo.core.frames import unit, wrap_angle
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.data.window_arrays import WindowArrays, crops, window_arrays
from advdiff_sumo.data.window_files import DT_S, FUTURE, PAST
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.vector_map import PieceTable
from advdiff_sumo.sim.session import Session, SessionOptions
from advdiff_sumo.sim.training_windows.mixed_demand import PARKED, write_mixed_demand
from advdiff_sumo.sim.world import Frame, World, read, register, stack

WARMUP_S, RECORD_S = 16.0, 28.0
_EVERY_S = 1.5
_MOST_FOCAL = 24
_MOVING_M = 1.0
_STILL_KEPT = 0.1
_MIN_MOVING, _MIN_MOVING_SHARE = 2, 0.12
_LIMITS, _GRIP = Limits(), 1.7
_TIGHTEST_1PM, _SHORT_WAY_M = 0.3, 0.3
_MOST_ASIDE_M, _MOST_ASTRAY_M = 0.9, 1.2  # in half a second


@dataclass(frozen=True)
class Recording:
    """Natural traffic at 2 Hz; A agents, L instants.

    Attributes:
        tracks: (A, L) states.
        parked: (A,) whether the vehicle stands at the kerb throughout.
        signals: L mappings, traffic light → state string.
        instants: at which windows may be cut.
        focal: (A, L) which vehicles may be focal.
        expert: (A, L) whose states SUMO's drivers led to; what others did is no future to learn.
    """

    tracks: Tracks
    parked: BoolArray
    signals: tuple[Mapping[str, str], ...]
    instants: tuple[int, ...]
    focal: BoolArray
    expert: BoolArray


def record(road: RoadMap, seed: SeedTree) -> Recording:
    """Return 28 s of natural traffic on *road* after 16 s of warm-up; *seed* decides all.

    Raises:
        SimulationError: SUMO refused the net or stopped.
        NetError: the net has no route.
    """
    with tempfile.TemporaryDirectory(prefix="advdiff-") as folder:
        demand = write_mixed_demand(
            road, WARMUP_S + RECORD_S, seed.child("demand"), Path(folder) / "demand.rou.xml"
        )
        options = SessionOptions(net=road.path, seed=seed.child("sumo").integer(), routes=(demand,))
        with Session(options) as session:
            return _recorded(session)


def _recorded(session: Session) -> Recording:
    world = World(512)
    frames: list[Frame] = []
    signals: list[Mapping[str, str]] = []
    lights = sorted(session.api.trafficlight.getIDList())
    session.step(WARMUP_S)
    for number in range(round(RECORD_S / DT_S) + 1):
        session.step(WARMUP_S + DT_S * (number + 1))
        register(world, session.api, sorted(set(session.api.vehicle.getIDList()) - world.index.keys()))
        world.remove(read(world, session.api, ()))
        frames.append(world.frame())
        signals.append({name: session.api.trafficlight.getRedYellowGreenState(name) for name in lights})
    rows = np.arange(len(world))
    tracks, _ = stack(world, frames, rows, 0.0, DT_S)
    named = np.array([name.startswith(PARKED) for name in tracks.ids], dtype=np.bool_)
    parked = named & (_extent_m(tracks.xy_m) < 0.5)
    instants = tuple(range(PAST - 1, tracks.steps - FUTURE, round(_EVERY_S / DT_S)))
    focal = tracks.valid & ~parked[:, None]
    return Recording(tracks, parked, tuple(signals), instants, focal, tracks.valid)


def _extent_m(xy_m: FloatArray) -> FloatArray:
    """Return how far apart (A,) the positions (A, L, 2) of each agent lie, at most, along x or y."""
    low = np.where(np.isnan(xy_m), np.inf, xy_m).min(axis=1, initial=np.inf)
    high = np.where(np.isnan(xy_m), -np.inf, xy_m).max(axis=1, initial=-np.inf)
    return np.asarray(np.maximum(high - low, 0.0).max(axis=1))


def cut(recording: Recording, table: PieceTable, seed: SeedTree, name: str) -> Iterator[WindowArrays]:
    """Yield windows of *recording*: at its instants some focal vehicles whose crops overlap little.

    Focal vehicles are drawn, moving ones first. Windows in which hardly anybody moves are thinned. Left out
    are those in which boxes overlap, as SUMO's lane model allows where a driver would not, and those in which
    a vehicle does what none can: SUMO turns and shifts vehicles sideways while they stand.
    """
    rng = seed.child("windows").generator()
    tracks = recording.tracks
    for now in recording.instants:
        moving = _moving(tracks, now)
        order = _focal_order(recording, now, moving, rng)
        for rows in crops(tracks.xy_m[:, now], order, _MOST_FOCAL):
            busy = moving[rows]
            still = busy.sum() < _MIN_MOVING or busy.mean() < _MIN_MOVING_SHARE
            if (still and rng.random() >= _STILL_KEPT) or _touching(tracks, rows, now):
                continue
            if not _drivable(tracks, rows, now):
                continue
            window = window_arrays(tracks, now, rows, recording.parked, table, recording.signals[now], name)
            yield _learnable(window, recording.expert[rows, now + 1 : now + 1 + FUTURE])


def _learnable(window: WindowArrays, expert: BoolArray) -> WindowArrays:
    """Return *window* with futures that end where they are no longer an *expert*'s (A, T)."""
    known = window.future_valid & np.logical_and.accumulate(expert, axis=1)
    return replace(window, future=np.where(known[..., None], window.future, 0.0), future_valid=known)


def _moving(tracks: Tracks, now: int) -> BoolArray:
    """Return which agents (A,) move by a metre or more in the 6 s that follow, or are fast now."""
    span = tracks.xy_m[:, now : now + FUTURE + 1]
    with np.errstate(invalid="ignore"):
        return np.asarray((_extent_m(span) > _MOVING_M) | (tracks.speed_mps[:, now] > _MOVING_M))


def _focal_order(recording: Recording, now: int, moving: BoolArray, rng: np.random.Generator) -> IntArray:
    """Return the vehicles that may be focal at instant *now* in a random order, moving ones mostly first."""
    tracks = recording.tracks
    there = recording.focal[:, now] & tracks.valid[:, now + 1]
    order = rng.permutation(np.flatnonzero(there))
    return np.asarray(order[np.argsort(~moving[order] & (rng.random(len(order)) < 0.9), kind="stable")])


def _touching(tracks: Tracks, rows: IntArray, now: int) -> bool:
    """Return whether two boxes of the window share area at any of its instants."""
    span = slice(now - PAST + 1, now + FUTURE + 1)
    a, b = np.triu_indices(len(rows), k=1)
    xy, size = tracks.xy_m[rows, span], tracks.size_m[rows]
    reach = 0.5 * np.linalg.norm(size, axis=-1)
    with np.errstate(invalid="ignore"):
        near = (np.linalg.norm(xy[a] - xy[b], axis=-1) < (reach[a] + reach[b])[:, None]).any(axis=1)
    if not near.any():
        return False
    a, b = a[near], b[near]
    boxes = corners(xy, tracks.yaw_rad[rows, span], size[:, None] - 0.2)
    return bool(overlap(boxes[a], boxes[b]).any())


def _drivable(tracks: Tracks, rows: IntArray, now: int) -> bool:
    """Return whether every vehicle of the window moves as a vehicle can."""
    span = slice(now - PAST + 1, now + FUTURE + 1)
    xy, yaw, speed = tracks.xy_m[rows, span], tracks.yaw_rad[rows, span], tracks.speed_mps[rows, span]
    step = np.diff(xy, axis=1)
    way, turn = np.linalg.norm(step, axis=-1), wrap_angle(np.diff(yaw, axis=1))
    along = unit(yaw[:, :-1] + 0.5 * turn)
    ahead = (step * along).sum(-1)
    aside = np.abs(step[..., 1] * along[..., 0] - step[..., 0] * along[..., 1])
    bend = np.abs(turn) / np.maximum(way, _SHORT_WAY_M)
    with np.errstate(invalid="ignore"):  # NaN compares as False
        bad = (np.abs(np.diff(speed, axis=1)) > _LIMITS.brake_mps2 * DT_S) | (aside > _MOST_ASIDE_M)
        bad |= np.abs(ahead - 0.5 * DT_S * (speed[:, 1:] + speed[:, :-1])) > _MOST_ASTRAY_M
        bad |= (bend > _TIGHTEST_1PM) | (bend * (way / DT_S) ** 2 > _LIMITS.lateral_mps2 * _GRIP)
    return not bad.any()
