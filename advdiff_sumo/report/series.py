"""What the charts under an episode's picture show, instant by instant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.metrics.criticality import clearances, time_to_collision
from advdiff_sumo.metrics.reference import ReferenceDrive


@dataclass(frozen=True)
class Series:
    """Values (T,) at the instants of an episode; NaN where there is none.

    Attributes:
        times_s: since the episode's start.
        speed_mps: of the target.
        attacker_mps: speed of the attacker; NaN without one.
        accel_mps2: longitudinal acceleration of the target over the step before, as recorded.
        jerk_mps3: change of ``accel_mps2`` from the step before.
        attacker_accel_mps2: acceleration of the attacker, likewise; NaN without one.
        reference_mps: speed of the careful driver in the target's place; NaN before it takes over, or without one.
        reference_accel_mps2: its acceleration.
        gap_m: distance between the target's box and the nearest other one.
        ttc_s: least time to collision of boxes at constant velocity, up to 10 s.
    """

    times_s: FloatArray
    speed_mps: FloatArray
    attacker_mps: FloatArray
    accel_mps2: FloatArray
    jerk_mps3: FloatArray
    attacker_accel_mps2: FloatArray
    reference_mps: FloatArray
    reference_accel_mps2: FloatArray
    gap_m: FloatArray
    ttc_s: FloatArray


def series_of(states: EpisodeStates, attacker: str | None, drive: ReferenceDrive | None = None) -> Series:
    """Return the series of one episode; *attacker* is an id or None, *drive* that of the careful driver."""
    tracks, target = states.tracks, states.target
    row = None if attacker is None else tracks.index.get(attacker)
    attacker_mps = np.full(tracks.steps, np.nan) if row is None else tracks.speed_mps[row]
    accel = difference_quotient(tracks.speed_mps[target], tracks.dt_s)
    return Series(
        times_s=tracks.times_s,
        speed_mps=tracks.speed_mps[target],
        attacker_mps=attacker_mps,
        accel_mps2=accel,
        jerk_mps3=difference_quotient(accel, tracks.dt_s),
        attacker_accel_mps2=difference_quotient(attacker_mps, tracks.dt_s),
        reference_mps=_from_takeover(tracks, drive, None if drive is None else drive.states.speed_mps),
        reference_accel_mps2=_from_takeover(tracks, drive, None if drive is None else drive.accel_mps2),
        gap_m=nearest_gap(tracks, target),
        ttc_s=_least(time_to_collision(tracks, target)),
    )


def _from_takeover(tracks: Tracks, drive: ReferenceDrive | None, values: FloatArray | None) -> FloatArray:
    """Return (T,) *values* of *drive* at the episode's instants; NaN before it."""
    series = np.full(tracks.steps, np.nan)
    if drive is not None and values is not None:
        count = min(len(values), tracks.steps - drive.takeover_step)
        series[drive.takeover_step : drive.takeover_step + count] = values[:count]
    return series


def difference_quotient(values: FloatArray, dt_s: float) -> FloatArray:
    """Return (T,) changes of *values* (T,) per second over the step that ends at each instant.

    NaN at the first instant, and where the instant or the one before it has no value.
    """
    return np.diff(values, prepend=np.nan) / dt_s


def nearest_gap(tracks: Tracks, target: int) -> FloatArray:
    """Return (T,) distances between the target's box and the nearest other one; 0 when they overlap.

    NaN where the target or all others are absent.
    """
    return _least(clearances(tracks, target))


def gap_to(tracks: Tracks, target: int, other: int) -> FloatArray:
    """Return (T,) distances between the boxes of *target* and *other*; NaN where one of them is absent."""
    return nearest_gap(tracks.rows(np.array([target, other])), 0)


def _least(values: FloatArray) -> FloatArray:
    least = np.where(np.isfinite(values), values, np.inf).min(axis=0)
    return np.where(np.isfinite(least), least, np.nan)
