"""Computes what tables need of an episode besides its row: how the background vehicles drove."""

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
"""Background vehicles nearer than this to the target count, moved by a policy or not: the default control radius."""


@dataclass(frozen=True)
class BackgroundTrace:
    """The background of one episode; counts are of vehicles.

    Attributes:
        vehicles: background vehicles that the policy moved; if it moved none, those that came near the target.
        hit: of these, how many collided with another background vehicle.
        off_road: background vehicles that left the road; None if the policy moved none.
        speed: histogram of speeds near the target, at 2 Hz.
        accel: histogram of accelerations near the target, differences of speed over 0.5 s.
        ttc: histogram of least times to collision with any road user; the last bin: none within 10 s.
        nats: sum of the bounds on log-likelihoods, see :mod:`likelihood`.
        seconds: vehicle-seconds of these bounds; 0 if they were not computed.
        solvable: whether the target could have avoided its collision, see ``experiments.solution``; None if it did not
            collide, or this was not computed.
        both: vehicles that both collided with another one and left the road.
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
"""A trace without any information."""


def trace_of(folder: Path, key: str, net: str, with_likelihood: bool = True) -> bytes:
    """Return the trace of the episode *key* of the sweep in *folder* as bytes; empty if it has no states.

    Args:
        folder: of the sweep.
        key: of the episode.
        net: of the episode.
        with_likelihood: compute likelihoods and whether a collision could have been avoided.
    """
    stored = Store(folder).read(key)
    if stored is None or "states" not in stored.tables:
        return b""
    return _trace(stored, _road(net), with_likelihood)


def _trace(stored: StoredEpisode, road: RoadMap, with_likelihood: bool) -> bytes:
    states = states_of(stored.tables["states"])
    if states is None:
        return b""
    (row,) = stored.tables["episodes"].to_pylist()
    coarse = at_model_step(states.tracks)
    is_near = near_target(coarse, states.target)
    is_counted = _counted_vehicles(states, is_near)
    speed, accel, ttc = histograms(coarse, is_near)
    nats, seconds = 0.0, 0.0
    if with_likelihood:
        nats, seconds = natural_nats(road, coarse, states.target, _at_any_time(is_near))
    collided = _collided_rows(stored.tables["collisions"], states.tracks, is_counted)
    return BackgroundTrace(
        vehicles=int(is_counted.sum()),
        hit=len(collided),
        off_road=int(row["bv_offroad_vehicles"]) if states.moved else None,
        speed=speed,
        accel=accel,
        ttc=ttc,
        nats=nats,
        seconds=seconds,
        solvable=_solvable(stored, road) if with_likelihood and row["target_collision"] else None,
        both=len(collided & _off_road(stored, road)) if collided and row["bv_offroad_vehicles"] else 0,
    ).to_bytes()


def _off_road(stored: StoredEpisode, road: RoadMap) -> frozenset[int]:
    """Return the rows of the background vehicles that left the road."""
    record = stored_record(stored.tables["states"])
    return frozenset() if record is None else frozenset(background_off_road(record, road).rows)


def _solvable(stored: StoredEpisode, road: RoadMap) -> bool | None:
    """Return whether the target could have avoided its collision; None if it left the road or this is unknown."""
    (row,) = stored.tables["episodes"].to_pylist()
    if row["collision_partner"] is None:
        return None
    record = stored_record(stored.tables["states"], row)
    try:
        return None if record is None else solvable(record, road)
    except AdvdiffError:
        return None


def at_model_step(tracks: Tracks) -> Tracks:
    """Return *tracks* at intervals of 0.5 s."""
    return tracks.every(round(MODEL_STEP_S / tracks.dt_s))


def near_target(tracks: Tracks, target: int) -> BoolArray:
    """Return which background vehicles are near the target (A, T)."""
    with np.errstate(invalid="ignore"):
        is_near = np.linalg.norm(tracks.xy_m - tracks.xy_m[target], axis=-1) < NEAR_M
    is_near &= tracks.valid & tracks.valid[target]
    is_near[tracks.classes == AgentClass.PEDESTRIAN] = False
    is_near[target] = False
    return np.asarray(is_near)


def histograms(
    tracks: Tracks, is_near: BoolArray
) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
    """Return histograms of speeds, accelerations and times to collision of vehicles while *is_near* (A, T)."""
    has_accel = is_near[:, 1:] & tracks.valid[:, :-1]
    accel = (np.diff(tracks.speed_mps, axis=1) / tracks.dt_s)[has_accel]
    ttc_s = least_ttc(
        tracks.xy_m.swapaxes(0, 1),
        tracks.yaw_rad.T,
        velocities(tracks).swapaxes(0, 1),
        tracks.size_m[None],
        tracks.valid.T,
    )
    return (
        _int_tuple(_counts(tracks.speed_mps[is_near], SPEED_BINS)),
        _int_tuple(_counts(accel, ACCEL_BINS)),
        _int_tuple(ttc_counts(ttc_s[is_near.T])),
    )


def _counted_vehicles(states: EpisodeStates, is_near: BoolArray) -> BoolArray:
    """Return which background vehicles (A,) count for rates: the moved ones, or if there are none the near ones."""
    if not states.moved:
        return _at_any_time(is_near)
    is_counted = np.zeros(states.tracks.agents, dtype=np.bool_)
    is_counted[sorted(states.moved)] = True
    return is_counted


def _at_any_time(mask: BoolArray) -> BoolArray:
    """Return for which agents (A,) *mask* (A, T) holds at any instant."""
    return np.asarray(mask.any(axis=1), dtype=np.bool_)


def _collided_rows(collisions: pa.Table, tracks: Tracks, is_counted: BoolArray) -> frozenset[int]:
    """Return the rows of counted vehicles that collided with another background vehicle."""
    ids: set[str] = set()
    for row in collisions.to_pylist():
        if not row["with_target"] and not row["initial"]:
            ids |= {str(row["first"]), str(row["second"])}
    return frozenset(row for agent_id, row in tracks.index.items() if agent_id in ids and is_counted[row])


def _counts(values: FloatArray, bins: FloatArray) -> FloatArray:
    return np.histogram(np.clip(values, bins[0], bins[-1]), bins)[0].astype(np.float64)


def _int_tuple(counts: FloatArray) -> tuple[int, ...]:
    return tuple(int(count) for count in counts)


@lru_cache(maxsize=4)
def _road(net: str) -> RoadMap:
    return read_road(net)
