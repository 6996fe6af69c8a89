"""Find lanes that run side by side in one direction."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert import polyline

STEP_M = 1.0  # distance between sample points on centre lines
MAX_TURN_RAD = 0.35  # largest angle between lanes of one direction
SIDE_SLACK_M = 0.9  # largest deviation of the distance of two centre lines from the mean of the two widths
KNOWN_SLACK_M = 2.5  # the same for lanes that share a divider
MIN_OVERLAP_M = 3.0  # shortest overlap of neighbours
KNOWN_OVERLAP_M = 1.0  # the same for lanes that share a divider


@dataclass(frozen=True, eq=False)
class SideBySide:
    """Lane *left* runs along the left of lane *right*.

    Attributes:
        left, right: lane numbers.
        left_m, right_m: (K,) arc lengths on either lane of points that lie side by side, both increasing.
    """

    left: int
    right: int
    left_m: FloatArray
    right_m: FloatArray

    @property
    def overlap_m(self) -> float:
        """Length in m over which they run side by side."""
        return float(self.left_m[-1] - self.left_m[0])

    def across(self, lane: int, s_m: float) -> float:
        """Return the arc length on the other lane beside *s_m* on *lane*; beyond the overlap, both advance equally."""
        lane_m, other_m = (self.left_m, self.right_m) if lane == self.left else (self.right_m, self.left_m)
        beyond = min(s_m - lane_m[0], 0.0) + max(s_m - lane_m[-1], 0.0)
        return float(np.interp(s_m, lane_m, other_m)) + float(beyond)

    def span(self, lane: int) -> tuple[float, float]:
        """Return the arc lengths on *lane* between which the other lane runs beside it."""
        lane_m = self.left_m if lane == self.left else self.right_m
        return float(lane_m[0]), float(lane_m[-1])


@dataclass(frozen=True, eq=False)
class _Samples:
    """Sample points on all lanes: positions (N, 2), headings, arc lengths and lane numbers (N,)."""

    xy: FloatArray
    yaw: FloatArray
    s: FloatArray
    lane: IntArray


def find_side_by_side(
    lines: Sequence[FloatArray], widths_m: Sequence[float], known: Collection[tuple[int, int]] = ()
) -> list[SideBySide]:
    """Return all pairs of neighbouring lanes of one direction, ordered by lane numbers.

    Two points lie side by side if their headings agree and their distance is about half the sum of both widths, at
    right angles to the heading. Two lanes are neighbours if this holds over some metres without a large gap.

    Args:
        lines: centre lines (N_i, 2).
        widths_m: mean width of each lane.
        known: (left, right) lanes that share a divider, for which larger deviations are accepted.
    """
    if len(lines) < 2:
        return []
    samples = _sample(lines)
    pairs = cKDTree(samples.xy).query_pairs(max(widths_m) + KNOWN_SLACK_M, output_type="ndarray")
    first = np.concatenate((pairs[:, 0], pairs[:, 1]))
    second = np.concatenate((pairs[:, 1], pairs[:, 0]))
    keys = samples.lane[second] * len(lines) + samples.lane[first]
    is_known = np.isin(keys, [left * len(lines) + right for left, right in sorted(known)])
    slack = np.where(is_known, KNOWN_SLACK_M, SIDE_SLACK_M)
    is_beside = _is_left_beside(samples, first, second, np.asarray(widths_m), slack)
    return _pairs(samples, first[is_beside], second[is_beside], lines, known)


def _sample(lines: Sequence[FloatArray]) -> _Samples:
    xy, yaw, s, lane = [], [], [], []
    for number, line in enumerate(lines):
        points, stations = polyline.resample(line, STEP_M)
        xy.append(points)
        yaw.append(polyline.heading(line, stations))
        s.append(stations)
        lane.append(np.full(len(stations), number))
    return _Samples(np.concatenate(xy), np.concatenate(yaw), np.concatenate(s), np.concatenate(lane))


def _is_left_beside(
    samples: _Samples, first: IntArray, second: IntArray, widths_m: FloatArray, slack_m: FloatArray
) -> BoolArray:
    """Return (M,) whether sample *second* lies beside sample *first*, on its left."""
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
    """Return the neighbours among the lanes of samples *left* and *right* (M,), which lie side by side."""
    keys = samples.lane[left] * len(lines) + samples.lane[right]
    order = np.lexsort((samples.s[right], keys))
    keys, left, right = keys[order], left[order], right[order]
    pairs = []
    for start, stop in _runs(keys):
        lane_left, lane_right = divmod(int(keys[start]), len(lines))
        s_left, s_right = _monotone(samples.s[left[start:stop]], samples.s[right[start:stop]])
        pair = SideBySide(lane_left, lane_right, s_left, s_right)
        shorter = min(line_length_m(lines[lane_left]), line_length_m(lines[lane_right]))
        is_known = (lane_left, lane_right) in known
        min_overlap_m = KNOWN_OVERLAP_M if is_known else min(MIN_OVERLAP_M, 0.5 * shorter)
        if len(s_left) > 1 and _is_dense(s_right) and pair.overlap_m >= min_overlap_m:
            pairs.append(pair)
    return pairs


def _runs(keys: IntArray) -> list[tuple[int, int]]:
    """Return (first, last + 1) of each run of equal *keys*."""
    changes = np.flatnonzero(np.diff(keys)) + 1
    bounds = [0, *changes.tolist(), len(keys)]
    return [(a, b) for a, b in itertools.pairwise(bounds) if b > a]


def _monotone(left: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return arc lengths (left, right), one pair for each distinct one on the right, as far as both increase."""
    s_right, first = np.unique(right, return_index=True)
    counts = np.diff(np.append(first, len(right)))
    s_left = np.add.reduceat(left, first) / counts
    rising = np.concatenate(([True], np.diff(np.maximum.accumulate(s_left)) > 1e-6))
    return s_left[rising], s_right[rising]


def _is_dense(s: FloatArray) -> bool:
    """Return whether there are samples *s* (N,) at 60 % or more of the stations between the first and the last."""
    return bool(len(s) >= 0.6 * (s[-1] - s[0]) / STEP_M)
