"""Simulate natural traffic once and cut the recording into windows."""

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
_WINDOW_SPACING_S = 1.5
_MAX_FOCAL = 24  # focal agents in a window
_MOVING_M = 1.0  # an agent moves if it covers more than this, or its speed in m/s is above it
_MIN_MOVING, _MIN_MOVING_SHARE = 2, 0.12  # with fewer moving agents, a window counts as standing
_STANDING_KEPT_SHARE = 0.1  # share of the standing windows that is kept
# Windows with motion beyond these limits are left out; the factor applies to the lateral acceleration.
_LIMITS, _GRIP_FACTOR = Limits(), 1.7
_MAX_CURVATURE_1PM = 0.3
_MIN_ARC_M = 0.3  # in the curvature, a vehicle counts as moving at least so far
_MAX_SIDESLIP_M = 0.9  # in half a second
_MAX_SPEED_ERROR_M = 1.2  # difference between distance and mean speed × time, in half a second


@dataclass(frozen=True)
class Recording:
    """Natural traffic at 2 Hz; A agents, L instants.

    Attributes:
        tracks: (A, L) states.
        parked: (A,) whether the vehicle is parked throughout.
        signals: L mappings, traffic light → state string.
        instants: at which windows may be cut.
        focal: (A, L) which vehicles may be focal.
        expert: (A, L) which states result from SUMO's drivers; futures to be learnt have no others.
    """

    tracks: Tracks
    parked: BoolArray
    signals: tuple[Mapping[str, str], ...]
    instants: tuple[int, ...]
    focal: BoolArray
    expert: BoolArray


def record(road: RoadMap, seed: SeedTree) -> Recording:
    """Return 28 s of natural traffic on *road* after 16 s of warm-up; *seed* decides everything.

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
            return _record_session(session)


def _record_session(session: Session) -> Recording:
    """Record the traffic of a running simulation."""
    world = World(512)
    frames: list[Frame] = []
    signals: list[Mapping[str, str]] = []
    light_ids = sorted(session.api.trafficlight.getIDList())
    session.step(WARMUP_S)
    for number in range(round(RECORD_S / DT_S) + 1):
        session.step(WARMUP_S + DT_S * (number + 1))
        register(world, session.api, sorted(set(session.api.vehicle.getIDList()) - world.index.keys()))
        world.remove(read(world, session.api, ()))
        frames.append(world.frame())
        signals.append({name: session.api.trafficlight.getRedYellowGreenState(name) for name in light_ids})
    rows = np.arange(len(world))
    tracks, _ = stack(world, frames, rows, 0.0, DT_S)
    has_parked_name = np.array([name.startswith(PARKED) for name in tracks.ids], dtype=np.bool_)
    parked = has_parked_name & (_extent_m(tracks.xy_m) < 0.5)
    instants = tuple(range(PAST - 1, tracks.steps - FUTURE, round(_WINDOW_SPACING_S / DT_S)))
    focal = tracks.valid & ~parked[:, None]
    return Recording(tracks, parked, tuple(signals), instants, focal, tracks.valid)


def _extent_m(xy_m: FloatArray) -> FloatArray:
    """Return (A,) how far apart the positions (A, L, 2) of each agent are, at most, along x or y."""
    low = np.where(np.isnan(xy_m), np.inf, xy_m).min(axis=1, initial=np.inf)
    high = np.where(np.isnan(xy_m), -np.inf, xy_m).max(axis=1, initial=-np.inf)
    return np.asarray(np.maximum(high - low, 0.0).max(axis=1))


def cut(recording: Recording, table: PieceTable, seed: SeedTree, name: str) -> Iterator[WindowArrays]:
    """Yield windows of *recording*: at each of its instants, around focal vehicles with little overlap of their crops.

    Focal vehicles are drawn, moving ones first. Most windows in which hardly any vehicle moves are left out. Windows
    with overlapping boxes, which SUMO's lane model allows, are left out. So are windows with impossible motion: SUMO
    turns standing vehicles and shifts them sideways.
    """
    rng = seed.child("windows").generator()
    tracks = recording.tracks
    for now in recording.instants:
        moving = _moving(tracks, now)
        order = _focal_order(recording, now, moving, rng)
        for rows in crops(tracks.xy_m[:, now], order, _MAX_FOCAL):
            is_moving = moving[rows]
            is_standing = is_moving.sum() < _MIN_MOVING or is_moving.mean() < _MIN_MOVING_SHARE
            if (is_standing and rng.random() >= _STANDING_KEPT_SHARE) or _has_overlaps(tracks, rows, now):
                continue
            if not _is_drivable(tracks, rows, now):
                continue
            window = window_arrays(tracks, now, rows, recording.parked, table, recording.signals[now], name)
            yield _with_expert_future(window, recording.expert[rows, now + 1 : now + 1 + FUTURE])


def _with_expert_future(window: WindowArrays, expert: BoolArray) -> WindowArrays:
    """Return *window* with futures that end at the first state that is not an *expert*'s (A, T)."""
    is_valid = window.future_valid & np.logical_and.accumulate(expert, axis=1)
    return replace(window, future=np.where(is_valid[..., None], window.future, 0.0), future_valid=is_valid)


def _moving(tracks: Tracks, now: int) -> BoolArray:
    """Return (A,) which agents move by more than a metre in the coming 6 s, or are faster than 1 m/s now."""
    span = tracks.xy_m[:, now : now + FUTURE + 1]
    with np.errstate(invalid="ignore"):
        return np.asarray((_extent_m(span) > _MOVING_M) | (tracks.speed_mps[:, now] > _MOVING_M))


def _focal_order(recording: Recording, now: int, moving: BoolArray, rng: np.random.Generator) -> IntArray:
    """Return the vehicles that may be focal at instant *now* in a random order, mostly moving ones first."""
    tracks = recording.tracks
    is_usable = recording.focal[:, now] & tracks.valid[:, now + 1]
    order = rng.permutation(np.flatnonzero(is_usable))
    return np.asarray(order[np.argsort(~moving[order] & (rng.random(len(order)) < 0.9), kind="stable")])


def _has_overlaps(tracks: Tracks, rows: IntArray, now: int) -> bool:
    """Return whether two boxes of the window, each shortened and narrowed by 0.2 m, overlap at any of its instants."""
    span = slice(now - PAST + 1, now + FUTURE + 1)
    a, b = np.triu_indices(len(rows), k=1)
    xy, size = tracks.xy_m[rows, span], tracks.size_m[rows]
    radius = 0.5 * np.linalg.norm(size, axis=-1)
    with np.errstate(invalid="ignore"):
        is_near = (np.linalg.norm(xy[a] - xy[b], axis=-1) < (radius[a] + radius[b])[:, None]).any(axis=1)
    if not is_near.any():
        return False
    a, b = a[is_near], b[is_near]
    boxes = corners(xy, tracks.yaw_rad[rows, span], size[:, None] - 0.2)
    return bool(overlap(boxes[a], boxes[b]).any())


def _is_drivable(tracks: Tracks, rows: IntArray, now: int) -> bool:
    """Return whether every vehicle of the window moves in a physically possible way."""
    span = slice(now - PAST + 1, now + FUTURE + 1)
    xy, yaw, speed = tracks.xy_m[rows, span], tracks.yaw_rad[rows, span], tracks.speed_mps[rows, span]
    step = np.diff(xy, axis=1)
    distance, turn = np.linalg.norm(step, axis=-1), wrap_angle(np.diff(yaw, axis=1))
    direction = unit(yaw[:, :-1] + 0.5 * turn)
    forward = (step * direction).sum(-1)
    sideslip = np.abs(step[..., 1] * direction[..., 0] - step[..., 0] * direction[..., 1])
    curvature = np.abs(turn) / np.maximum(distance, _MIN_ARC_M)
    with np.errstate(invalid="ignore"):  # NaN compares as False
        invalid = (np.abs(np.diff(speed, axis=1)) > _LIMITS.brake_mps2 * DT_S) | (sideslip > _MAX_SIDESLIP_M)
        invalid |= np.abs(forward - 0.5 * DT_S * (speed[:, 1:] + speed[:, :-1])) > _MAX_SPEED_ERROR_M
        invalid |= curvature > _MAX_CURVATURE_1PM
        invalid |= curvature * (distance / DT_S) ** 2 > _LIMITS.lateral_mps2 * _GRIP_FACTOR
    return not invalid.any()
