"""Which lanes run side by side in one direction."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert import polyline

STEP_M = 1.0
MAX_TURN_RAD = 0.35  # beyond this two lanes do not run in one direction
SIDE_SLACK_M = 0.9  # how far the distance of two centre lines may be off the mean of their widths
KNOWN_SLACK_M = 2.5  # the same for lanes that share a divider
MIN_OVERLAP_M, KNOWN_OVERLAP_M = 3.0, 1.0


@dataclass(frozen=True, eq=False)
class SideBySide:
    """Lane *left* runs along the left of lane *right*.

    Attributes:
        left, right: lane numbers.
        left_m, right_m: (K,) arc lengths of places that lie abreast, both increasing.
    """

    left: int
    right: int
    left_m: FloatArray
    right_m: FloatArray

    @property
    def overlap_m(self) -> float:
        """Length over which they run abreast in m."""
        return float(self.left_m[-1] - self.left_m[0])

    def across(self, lane: int, s_m: float) -> float:
        """Return the arc length on the other lane abreast of *s_m* on *lane*; beyond the overlap at equal pace."""
        mine, other = (self.left_m, self.right_m) if lane == self.left else (self.right_m, self.left_m)
        beyond = min(s_m - mine[0], 0.0) + max(s_m - mine[-1], 0.0)
        return float(np.interp(s_m, mine, other)) + float(beyond)

    def span(self, lane: int) -> tuple[float, float]:
        """Return the arc lengths on *lane* between which the other one runs alongside."""
        mine = self.left_m if lane == self.left else self.right_m
        return float(mine[0]), float(mine[-1])


@dataclass(frozen=True, eq=False)
class _Samples:
    xy: FloatArray
    yaw: FloatArray
    s: FloatArray
    lane: IntArray


def find_side_by_side(
    lines: Sequence[FloatArray], widths_m: Sequence[float], known: Collection[tuple[int, int]] = ()
) -> list[SideBySide]:
    """Return all pairs of neighbouring lanes of one direction, ordered by lane numbers.

    Two places are abreast when one lies across the other's heading at about half the sum of both widths and the
    headings agree; two lanes are neighbours when this holds over some metres without a large hole.

    Args:
        lines: centre lines (N_i, 2).
        widths_m: mean width of each lane.
        known: (left, right) lanes that share a divider, for which distances are judged less strictly.
    """
    if len(lines) < 2:
        return []
    samples = _sample(lines)
    pairs = cKDTree(samples.xy).query_pairs(max(widths_m) + KNOWN_SLACK_M, output_type="ndarray")
    first = np.concatenate((pairs[:, 0], pairs[:, 1]))
    second = np.concatenate((pairs[:, 1], pairs[:, 0]))
    keys = samples.lane[second] * len(lines) + samples.lane[first]
    sure = np.isin(keys, [left * len(lines) + right for left, right in sorted(known)])
    slack = np.where(sure, KNOWN_SLACK_M, SIDE_SLACK_M)
    keep = _abreast(samples, first, second, np.asarray(widths_m), slack)
    return _pairs(samples, first[keep], second[keep], lines, known)


def _sample(lines: Sequence[FloatArray]) -> _Samples:
    xy, yaw, s, lane = [], [], [], []
    for number, line in enumerate(lines):
        points, stations = polyline.resample(line, STEP_M)
        xy.append(points)
        yaw.append(polyline.heading(line, stations))
        s.append(stations)
        lane.append(np.full(len(stations), number))
    return _Samples(np.concatenate(xy), np.concatenate(yaw), np.concatenate(s), np.concatenate(lane))


def _abreast(
    samples: _Samples, first: IntArray, second: IntArray, widths_m: FloatArray, slack_m: FloatArray
) -> BoolArray:
    """Return whether place *second* lies abreast on the left of place *first*."""
    delta = samples.xy[second] - samples.xy[first]
    cos, sin = np.cos(samples.yaw[first]), np.sin(samples.yaw[first])
    along = cos * delta[:, 0] + sin * delta[:, 1]
    aside = cos * delta[:, 1] - sin * delta[:, 0]
    turn = np.abs((samples.yaw[second] - samples.yaw[first] + np.pi) % (2 * np.pi) - np.pi)
    expected = 0.5 * (widths_m[samples.lane[first]] + widths_m[samples.lane[second]])
    fits = (np.abs(along) <= 0.5 * STEP_M + 0.1) & (aside > 1.0) & (np.abs(aside - expected) <= slack_m)
    return np.asarray(fits & (turn <= MAX_TURN_RAD) & (samples.lane[first] != samples.lane[second]))


def _pairs(
    samples: _Samples,
    right: IntArray,
    left: IntArray,
    lines: Sequence[FloatArray],
    known: Collection[tuple[int, int]],
) -> list[SideBySide]:
    keys = samples.lane[left] * len(lines) + samples.lane[right]
    order = np.lexsort((samples.s[right], keys))
    keys, left, right = keys[order], left[order], right[order]
    pairs = []
    for start, stop in _runs(keys):
        lane_left, lane_right = divmod(int(keys[start]), len(lines))
        s_left, s_right = _monotone(samples.s[left[start:stop]], samples.s[right[start:stop]])
        pair = SideBySide(lane_left, lane_right, s_left, s_right)
        shorter = min(line_length_m(lines[lane_left]), line_length_m(lines[lane_right]))
        least = KNOWN_OVERLAP_M if (lane_left, lane_right) in known else min(MIN_OVERLAP_M, 0.5 * shorter)
        if len(s_left) > 1 and _is_dense(s_right) and pair.overlap_m >= least:
            pairs.append(pair)
    return pairs


def _runs(keys: IntArray) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(keys)) + 1
    bounds = [0, *edges.tolist(), len(keys)]
    return [(a, b) for a, b in itertools.pairwise(bounds) if b > a]


def _monotone(left: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return one strictly increasing pair of arc lengths for each place on the right."""
    s_right, first = np.unique(right, return_index=True)
    counts = np.diff(np.append(first, len(right)))
    s_left = np.add.reduceat(left, first) / counts
    rising = np.concatenate(([True], np.diff(np.maximum.accumulate(s_left)) > 1e-6))
    return s_left[rising], s_right[rising]


def _is_dense(s: FloatArray) -> bool:
    return bool(len(s) >= 0.6 * (s[-1] - s[0]) / STEP_M)
