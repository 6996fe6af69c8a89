"""Find the pairs of lanes with a dashed divider between them, from the source map alone."""

from __future__ import annotations

from collections import Counter

import numpy as np
from scipy.spatial import cKDTree

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.sources.source_map import SourceMap

STEP_M = 0.5  # distance between sample points on centre lines
REACH_M = 4.0  # largest distance of a lane's centre line from its divider
SHARED_M = 4.0  # smallest length over which a divider must run between two lanes
PARALLEL = 0.9  # cosine of the largest angle between a lane and its divider


def dashed_pairs(source: SourceMap) -> set[tuple[int, int]]:
    """Return (left, right) lane numbers of all pairs of one direction with a dashed divider between them.

    The divider nodes that lane records name decide. If no pair follows from them, the divider lines decide.
    """
    named = _pairs_by_node(source)
    return named if named else _pairs_by_line(source)


def _pairs_by_node(source: SourceMap) -> set[tuple[int, int]]:
    """Return the pairs in which the left lane's right divider and the right lane's left divider share two nodes."""
    right_of: dict[str, list[int]] = {}
    for number, lane in enumerate(source.lanes):
        for node in sorted(lane.left_dashed):
            right_of.setdefault(node, []).append(number)
    shared: Counter[tuple[int, int]] = Counter()
    for number, lane in enumerate(source.lanes):
        for node in sorted(lane.right_dashed):
            shared.update((number, other) for other in right_of.get(node, ()) if other != number)
    return {pair for pair, nodes in shared.items() if nodes >= 2}


def _pairs_by_line(source: SourceMap) -> set[tuple[int, int]]:
    """Return the pairs that are the nearest lanes on either side of a divider, both along it in one direction."""
    road_lanes = [number for number, lane in enumerate(source.lanes) if not lane.is_connector]
    if not road_lanes or not source.dashed_dividers:
        return set()
    samples = [polyline.resample(source.lanes[n].centre_m, STEP_M) for n in road_lanes]
    xy = np.concatenate([points for points, _ in samples])
    yaw = np.concatenate(
        [polyline.heading(source.lanes[n].centre_m, s) for n, (_, s) in zip(road_lanes, samples, strict=True)]
    )
    lane = np.repeat(road_lanes, [len(s) for _, s in samples])
    tree = cKDTree(xy)
    metres: Counter[tuple[int, int]] = Counter()
    for divider in source.dashed_dividers:
        line = np.asarray(divider.coords)[:, :2]
        points, s = polyline.resample(line, 1.0)
        near = cKDTree(points).sparse_distance_matrix(tree, REACH_M, output_type="ndarray")
        station, sample = near["i"], near["j"]
        delta, along = xy[sample] - points[station], polyline.heading(line, s)[station]
        metres.update(_lanes_beside(station, delta, yaw[sample], lane[sample], along))
    return {pair for pair, length in metres.items() if length >= SHARED_M}


def _lanes_beside(
    station: IntArray, delta: FloatArray, yaw: FloatArray, lane: IntArray, along: FloatArray
) -> list[tuple[int, int]]:
    """Return the nearest lanes (left, right) at each station of a divider with lanes of one direction on both sides.

    Each of the N rows is a pair of a station on the divider and a sample point on a lane near it.

    Args:
        station: (N,) numbers of the stations.
        delta: (N, 2) vectors from station to sample point in m.
        yaw: (N,) headings of the lane at the sample point in rad.
        lane: (N,) lane numbers.
        along: (N,) headings of the divider at the station in rad.
    """
    ahead = np.cos(along) * delta[:, 0] + np.sin(along) * delta[:, 1]
    aside = np.cos(along) * delta[:, 1] - np.sin(along) * delta[:, 0]
    cosine = np.cos(yaw - along)
    is_abreast = (np.abs(ahead) <= STEP_M) & (np.abs(cosine) >= PARALLEL)
    sides = []
    for side in (1.0, -1.0):
        rows = np.flatnonzero(is_abreast & (side * aside > 0))
        rows = rows[np.lexsort((lane[rows], np.abs(aside[rows]), station[rows]))]
        stations, first = np.unique(station[rows], return_index=True)
        sides.append((stations, rows[first]))
    (left_stations, left), (right_stations, right) = sides
    _, of_left, of_right = np.intersect1d(left_stations, right_stations, return_indices=True)
    left, right = left[of_left], right[of_right]
    is_pair = (lane[left] != lane[right]) & (cosine[left] * cosine[right] >= 0)
    forward = cosine[left] > 0  # else both lanes run against the divider, and left and right are exchanged
    left_lane = np.where(forward, lane[left], lane[right])
    right_lane = np.where(forward, lane[right], lane[left])
    return list(zip(left_lane[is_pair].tolist(), right_lane[is_pair].tolist(), strict=True))
