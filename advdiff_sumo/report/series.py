"""Computes the values of the charts of an episode at each instant."""

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
    """Values (T,) at the instants of an episode; NaN where a value is undefined.

    Attributes:
        times_s: since the episode's start.
        speed_mps: of the target.
        attacker_mps: speed of the attacker; NaN without one.
        accel_mps2: change of the target's speed over the step that ends at the instant, per second.
        jerk_mps3: change of ``accel_mps2`` over that step, per second.
        attacker_accel_mps2: the same as ``accel_mps2`` of the attacker; NaN without one.
        reference_mps: speed of the careful driver in the target's place; NaN before its takeover, or without one.
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
    """Return the series of one episode; *attacker* is an id or None, *drive* the motion of the careful driver."""
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
        ttc_s=_nan_minimum(time_to_collision(tracks, target)),
    )


def _from_takeover(tracks: Tracks, drive: ReferenceDrive | None, values: FloatArray | None) -> FloatArray:
    """Return *values* of *drive* at the episode's instants (T,); NaN before its takeover."""
    aligned = np.full(tracks.steps, np.nan)
    if drive is not None and values is not None:
        count = min(len(values), tracks.steps - drive.takeover_step)
        aligned[drive.takeover_step : drive.takeover_step + count] = values[:count]
    return aligned


def difference_quotient(values: FloatArray, dt_s: float) -> FloatArray:
    """Return the changes (T,) of *values* (T,) per second over the step that ends at each instant.

    NaN at the first instant, and where the instant or the one before it has no value.
    """
    return np.diff(values, prepend=np.nan) / dt_s


def nearest_gap(tracks: Tracks, target: int) -> FloatArray:
    """Return the distances (T,) between the target's box and the nearest other one; 0 if they overlap.

    NaN where the target or all others are absent.
    """
    return _nan_minimum(clearances(tracks, target))


def gap_to(tracks: Tracks, target: int, other: int) -> FloatArray:
    """Return the distances (T,) between the boxes of *target* and *other*; NaN where one of them is absent."""
    return nearest_gap(tracks.rows(np.array([target, other])), 0)


def _nan_minimum(values: FloatArray) -> FloatArray:
    minimum = np.where(np.isfinite(values), values, np.inf).min(axis=0)
    return np.where(np.isfinite(minimum), minimum, np.nan)
