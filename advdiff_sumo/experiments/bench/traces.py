"""What the tables need of an episode beyond its row: who the background vehicles were and how they drove."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.errors import AdvdiffError
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.data.episode_states import EpisodeStates, states_of
from advdiff_sumo.experiments.bench.likelihood import natural_nats
from advdiff_sumo.experiments.solvable import solvable
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.kinematics import velocities
from advdiff_sumo.metrics.offroad import background_off_road
from advdiff_sumo.metrics.pairwise import least_ttc, ttc_counts
from advdiff_sumo.models.model_options import MODEL_STEP_S
from advdiff_sumo.report.stored_record import stored_record
from advdiff_sumo.sim.run_episodes import read_road
from advdiff_sumo.sweep.stored_episode import StoredEpisode
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.training.realism import ACCEL_BINS, SPEED_BINS

NEAR_M = 60.0
"""Background vehicles nearer than this to the target count, moved or not: the default control radius."""


@dataclass(frozen=True)
class BackgroundTrace:
    """One episode's background; counts are of vehicles.

    Attributes:
        vehicles: background vehicles that the policy moved; with background sumo, those that came near.
        hit: of these, how many collided with another background vehicle.
        off_road: of these, how many came to be off the road; None where nobody was moved.
        speed: counts of their speeds near the target, at 2 Hz.
        accel: the same of accelerations, differences of speed over 0.5 s.
        ttc: the same of the least time to collision with anybody else; the last bin is none in 10 s.
        nats: sum of the bounds on log-likelihoods, see :mod:`likelihood`.
        seconds: vehicle-seconds that they are of; 0 where they were not asked for.
        solvable: where the target collided and it was asked for, whether it could have driven otherwise, see
            ``experiments.solution``.
        both: how many of the vehicles both collided with another one and came to be off the road.
    """

    vehicles: int
    hit: int
    off_road: int | None
    speed: tuple[int, ...]
    accel: tuple[int, ...]
    ttc: tuple[int, ...]
    nats: float
    seconds: float
    solvable: bool | None = None
    both: int = 0

    def to_bytes(self) -> bytes:
        """Return it as JSON."""
        return json.dumps(asdict(self)).encode()

    @staticmethod
    def from_bytes(content: bytes) -> BackgroundTrace:
        """Return what :meth:`to_bytes` wrote."""
        plain: dict[str, Any] = json.loads(content)
        for key, value in plain.items():
            plain[key] = tuple(value) if isinstance(value, list) else value
        return BackgroundTrace(**plain)


UNTRACED = BackgroundTrace(0, 0, None, (), (), (), 0.0, 0.0)
"""Nothing is known of the background."""


def trace_of(folder: Path, key: str, net: str, judged: bool = True) -> bytes:
    """Return the trace of the episode *key* of the sweep in *folder*; empty where it has no states.

    Args:
        folder: of the sweep.
        key: of the episode.
        net: that it was driven on.
        judged: say how likely it was and whether its collision could have been avoided.
    """
    part = Store(folder).read(key)
    return b"" if part is None or "states" not in part.tables else _trace(part, _road(net), judged)


def _trace(part: StoredEpisode, road: RoadMap, judged: bool) -> bytes:
    states = states_of(part.tables["states"])
    if states is None:
        return b""
    (row,) = part.tables["episodes"].to_pylist()
    coarse = at_model_step(states.tracks)
    near = near_target(coarse, states.target)
    counted = _counted(states, near)
    speed, accel, ttc = histograms(coarse, near)
    nats, seconds = natural_nats(road, coarse, states.target, _ever(near)) if judged else (0.0, 0.0)
    hit = _hit(part.tables["collisions"], states.tracks, counted)
    return BackgroundTrace(
        vehicles=int(counted.sum()),
        hit=len(hit),
        off_road=int(row["bv_offroad_vehicles"]) if states.moved else None,
        speed=speed,
        accel=accel,
        ttc=ttc,
        nats=nats,
        seconds=seconds,
        solvable=_solvable(part, road) if judged and row["target_collision"] else None,
        both=len(hit & _off_road(part, road)) if hit and row["bv_offroad_vehicles"] else 0,
    ).to_bytes()


def _off_road(part: StoredEpisode, road: RoadMap) -> frozenset[int]:
    """Return the rows of the background vehicles that came to be off the road."""
    record = stored_record(part.tables["states"])
    return frozenset() if record is None else frozenset(background_off_road(record, road).rows)


def _solvable(part: StoredEpisode, road: RoadMap) -> bool | None:
    """Return whether the target could have avoided its collision; None where it left the road or nobody can say."""
    (row,) = part.tables["episodes"].to_pylist()
    if row["collision_partner"] is None:
        return None
    record = stored_record(part.tables["states"], row)
    try:
        return None if record is None else solvable(record, road)
    except AdvdiffError:
        return None


def at_model_step(tracks: Tracks) -> Tracks:
    """Return every instant of *tracks* that is a multiple of 0.5 s."""
    return tracks.every(round(MODEL_STEP_S / tracks.dt_s))


def near_target(tracks: Tracks, target: int) -> BoolArray:
    """Return (A, T) which background vehicles are near the target."""
    with np.errstate(invalid="ignore"):
        near = np.linalg.norm(tracks.xy_m - tracks.xy_m[target], axis=-1) < NEAR_M
    near &= tracks.valid & tracks.valid[target]
    near[tracks.classes == AgentClass.PEDESTRIAN] = False
    near[target] = False
    return np.asarray(near)


def histograms(tracks: Tracks, near: BoolArray) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
    """Return counts of speeds, accelerations and times to collision, with anybody, of the vehicles *near* (A, T)."""
    later = near[:, 1:] & tracks.valid[:, :-1]
    accel = (np.diff(tracks.speed_mps, axis=1) / tracks.dt_s)[later]
    seconds = least_ttc(
        tracks.xy_m.swapaxes(0, 1),
        tracks.yaw_rad.T,
        velocities(tracks).swapaxes(0, 1),
        tracks.size_m[None],
        tracks.valid.T,
    )
    return (
        _whole(_counts(tracks.speed_mps[near], SPEED_BINS)),
        _whole(_counts(accel, ACCEL_BINS)),
        _whole(ttc_counts(seconds[near.T])),
    )


def _counted(states: EpisodeStates, near: BoolArray) -> BoolArray:
    """Return (A,) the background vehicles that rates are of."""
    if not states.moved:
        return _ever(near)
    counted = np.zeros(states.tracks.agents, dtype=np.bool_)
    counted[sorted(states.moved)] = True
    return counted


def _ever(near: BoolArray) -> BoolArray:
    """Return (A,) who of (A, T) is so at any instant."""
    return np.asarray(near.any(axis=1), dtype=np.bool_)


def _hit(collisions: pa.Table, tracks: Tracks, counted: BoolArray) -> frozenset[int]:
    """Return the rows of those who are *counted* and ran into another background vehicle."""
    names: set[str] = set()
    for row in collisions.to_pylist():
        if not row["with_target"] and not row["initial"]:
            names |= {str(row["first"]), str(row["second"])}
    return frozenset(row for name, row in tracks.index.items() if name in names and counted[row])


def _counts(values: FloatArray, bins: FloatArray) -> FloatArray:
    return np.histogram(np.clip(values, bins[0], bins[-1]), bins)[0].astype(np.float64)


def _whole(counts: FloatArray) -> tuple[int, ...]:
    return tuple(int(count) for count in counts)


@lru_cache(maxsize=4)
def _road(net: str) -> RoadMap:
    return read_road(net)
