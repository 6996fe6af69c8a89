"""Resample tracks to another time step, by C1 cubic Hermite interpolation without overshoot.

Between two keyframes the position is a cubic whose end velocities are speed × heading. Those velocities are
limited after Fritsch and Carlson (1980, doi:10.1137/0717021): none exceeds three times the mean velocity of
an adjoining interval, and one that points against an adjoining interval becomes zero. Therefore the position
never overshoots along the chord, and a parked vehicle stays at its keyframes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.frames import unit, wrap_angle
from advdiff_sumo.core.scene import Tracks

SAME_S = 1e-9
"""Instants closer than this are one instant."""
_MAX_SLOPE_RATIO = 3.0  # Fritsch and Carlson's bound on end slope / mean slope
_STILL_MPS = 0.2  # at lower speeds the direction of motion is noise


def resample(
    tracks: Tracks,
    dt_s: float,
    *,
    t0_s: float | None = None,
    steps: int | None = None,
    max_gap_s: float | None = None,
) -> Tracks:
    """Return *tracks* at every *dt_s* on the same clock.

    Poses at the instants of *tracks* are copied unchanged. Speeds are the derivatives of the positions along the
    heading; they equal the given speeds where these agree with the positions. The heading follows the shortest arc. If
    an agent moves sideways to its heading (as the box of a pedestrian may), its path follows the positions instead.

    Args:
        tracks: (A, T) states.
        dt_s: new spacing, positive.
        t0_s: first instant; that of *tracks* if None.
        steps: number of instants; up to the last of *tracks* if None. Beyond it nothing is valid.
        max_gap_s: longest time between two valid instants that is interpolated. If None, one old step, so that nothing
            next to an invalid instant is valid.

    Raises:
        ValueError: *dt_s* or *steps* is not positive.
    """
    start = tracks.t0_s if t0_s is None else t0_s
    end = tracks.t0_s + tracks.dt_s * (tracks.steps - 1)
    if not dt_s > 0.0 or (steps is not None and steps < 0):
        raise ValueError(f"resample to dt_s={dt_s}, steps={steps}: both must be positive")
    count = max(0, int(np.floor((end - start) / dt_s + 1e-6)) + 1) if steps is None else steps
    longest_gap = tracks.dt_s if max_gap_s is None else max(max_gap_s, tracks.dt_s)
    times = np.asarray(start + dt_s * np.arange(count), dtype=np.float64)
    xy = np.full((tracks.agents, count, 2), np.nan)
    yaw, speed = np.full((2, tracks.agents, count), np.nan)
    for row in range(tracks.agents):
        curve = _Curve.through(tracks, row, longest_gap)
        known, segment, exact = curve.locate(times)
        xy[row, known], yaw[row, known], speed[row, known] = curve.states(times[known], segment, exact)
    return replace(
        tracks,
        xy_m=xy,
        yaw_rad=yaw,
        speed_mps=speed,
        valid=np.isfinite(yaw),
        t0_s=float(start),
        dt_s=float(dt_s),
    )


@dataclass(frozen=True)
class _Curve:
    """One agent's path through its K valid keyframes.

    Attributes:
        t_s: (K,) times.
        xy_m: (K, 2) positions.
        yaw_rad: (K,) headings as given.
        velocity_mps: (K, 2) limited end velocities.
        turn_rad: (K−1,) shortest arcs between keyframes.
        rate_radps: (K,) limited yaw rates.
        bridged: (K−1,) whether an interval is short enough to be interpolated.
    """

    t_s: FloatArray
    xy_m: FloatArray
    yaw_rad: FloatArray
    velocity_mps: FloatArray
    turn_rad: FloatArray
    rate_radps: FloatArray
    bridged: BoolArray

    @staticmethod
    def through(tracks: Tracks, row: int, longest_gap_s: float) -> _Curve:
        """Return the curve of agent *row*; intervals up to *longest_gap_s* are interpolated."""
        known = np.flatnonzero(tracks.valid[row])
        t, xy, yaw = tracks.times_s[known], tracks.xy_m[row, known], tracks.yaw_rad[row, known]
        span = np.diff(t)
        bridged = np.asarray(span <= longest_gap_s + SAME_S)
        mean = np.diff(xy, axis=0) / span[:, None]
        turn = wrap_angle(np.diff(yaw))
        rate = turn / span
        return _Curve(
            t_s=t,
            xy_m=xy,
            yaw_rad=yaw,
            velocity_mps=_velocities(tracks.speed_mps[row, known], yaw, mean, bridged),
            turn_rad=turn,
            rate_radps=_limited(_central(rate[:, None], bridged), rate[:, None], bridged)[:, 0],
            bridged=bridged,
        )

    def locate(self, at_s: FloatArray) -> tuple[IntArray, IntArray, BoolArray]:
        """Return the indices of *at_s* (T,) on the curve, the interval of each, and whether it is a keyframe."""
        if len(self.t_s) == 0:
            empty = np.zeros(0, dtype=np.int64)
            return empty, empty, empty.astype(np.bool_)
        segment = np.searchsorted(self.t_s, at_s + SAME_S, side="right") - 1
        has_begun = segment >= 0
        segment = np.maximum(segment, 0)
        exact = has_begun & (np.abs(at_s - self.t_s[segment]) <= SAME_S)
        bridged_after = np.append(self.bridged, False)  # after each keyframe; nothing follows the last one
        known = np.flatnonzero(exact | (has_begun & bridged_after[segment]))
        return known, segment[known], exact[known]

    def states(
        self, at_s: FloatArray, segment: IntArray, exact: BoolArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions (N, 2), headings (N,) and speeds (N,) at *at_s* (N,) in intervals *segment*."""
        start, end = segment, np.minimum(segment + 1, len(self.t_s) - 1)
        span = np.where(exact, 1.0, self.t_s[end] - self.t_s[start])
        share = np.where(exact, 0.0, (at_s - self.t_s[start]) / span)
        move = self.xy_m[end] - self.xy_m[start]
        shift, velocity = _hermite(
            share[:, None],
            span[:, None],
            move,
            self.velocity_mps[start],
            self.velocity_mps[end],
        )
        turn = np.append(self.turn_rad, 0.0)[start]
        turned, _ = _hermite(share, span, turn, self.rate_radps[start], self.rate_radps[end])
        yaw = np.where(exact, self.yaw_rad[start], wrap_angle(self.yaw_rad[start] + turned))
        return self.xy_m[start] + shift, yaw, (velocity * unit(yaw)).sum(-1)


def _velocities(speed: FloatArray, yaw: FloatArray, mean: FloatArray, bridged: BoolArray) -> FloatArray:
    """Return the limited velocities (K, 2) at the keyframes."""
    heading = unit(yaw)
    observed = _central(mean, bridged)
    forward = (observed * heading).sum(-1)
    sideways = np.abs(observed[:, 1] * heading[:, 0] - observed[:, 0] * heading[:, 1])
    moves_sideways = (sideways > np.abs(forward)) & (np.linalg.norm(observed, axis=-1) > _STILL_MPS)
    return _limited(np.where(moves_sideways[:, None], observed, speed[:, None] * heading), mean, bridged)


def _central(mean: FloatArray, bridged: BoolArray) -> FloatArray:
    """Return the average (K, D) of the adjoining interval slopes (K−1, D); zero where there is none."""
    weight = bridged.astype(np.float64)[:, None]
    no_slope = np.zeros((1, mean.shape[1]))
    no_weight = np.zeros((1, 1))
    total = np.concatenate((no_slope, mean * weight)) + np.concatenate((mean * weight, no_slope))
    count = np.concatenate((no_weight, weight)) + np.concatenate((weight, no_weight))
    return np.asarray(total / np.maximum(count, 1.0))


def _limited(slope: FloatArray, mean: FloatArray, bridged: BoolArray) -> FloatArray:
    """Return *slope* (K, D) within Fritsch and Carlson's bound of both adjoining intervals."""
    limited = slope.copy()
    mean_norm = np.linalg.norm(mean, axis=-1)
    for keyframes in (slice(0, -1), slice(1, None)):  # those before and those after each interval
        end_slope = limited[keyframes]
        end_norm = np.linalg.norm(end_slope, axis=-1)
        scale = np.minimum(1.0, _MAX_SLOPE_RATIO * mean_norm / np.maximum(end_norm, 1e-12))
        scale = np.where((end_slope * mean).sum(-1) > 0.0, scale, 0.0)
        limited[keyframes] = end_slope * np.where(bridged, scale, 1.0)[:, None]
    return limited


def _hermite(
    share: FloatArray, span: FloatArray, move: FloatArray, v0: FloatArray, v1: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return displacement and its rate at *share* in [0, 1] of an interval of *span* seconds.

    *move* is the displacement over the interval; *v0* and *v1* are the rates at its ends. Written out because ``core``
    does not depend on scipy.
    """
    s2, s3 = share**2, share**3
    shift = move * (3 * s2 - 2 * s3) + span * (v0 * (share - 2 * s2 + s3) + v1 * (s3 - s2))
    rate = move / span * 6 * (share - s2) + v0 * (1 - 4 * share + 3 * s2) + v1 * (3 * s2 - 2 * share)
    return shift, rate


def with_middles(xy_m: FloatArray, yaw_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions (…, T, 2) and headings (…, T) with midpoints inserted: (…, 2 T − 1, 2), (…, 2 T − 1)."""
    *agents, steps = yaw_rad.shape
    xy, yaw = np.empty((*agents, 2 * steps - 1, 2)), np.empty((*agents, 2 * steps - 1))
    xy[..., ::2, :], yaw[..., ::2] = xy_m, yaw_rad
    xy[..., 1::2, :] = 0.5 * (xy_m[..., 1:, :] + xy_m[..., :-1, :])
    yaw[..., 1::2] = yaw_rad[..., :-1] + 0.5 * wrap_angle(np.diff(yaw_rad, axis=-1))
    return xy, yaw
