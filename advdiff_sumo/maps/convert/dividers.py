"""Pairs of lanes that share a dashed divider, as the source says; independent of how lanes are grouped."""

from __future__ import annotations

from collections import Counter

import numpy as np
from scipy.spatial import cKDTree

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.sources.source_map import SourceMap

STEP_M = 0.5
REACH_M = 4.0  # the centre line of a lane lies at most this far from its divider
SHARED_M = 4.0  # a divider must run between two lanes for this length
PARALLEL = 0.9  # cosine of the largest angle between a lane and its divider


def dashed_pairs(source: SourceMap) -> set[tuple[int, int]]:
    """Return (left, right) lane numbers of every pair of one direction with a dashed divider between them.

    Lane records that name their divider's nodes decide; where no lane does, the divider lines do.
    """
    named = _pairs_by_node(source)
    return named if named else _pairs_by_line(source)


def _pairs_by_node(source: SourceMap) -> set[tuple[int, int]]:
    """Two lanes share a divider when at least two nodes of the one's left divider are in the other's right one."""
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
    """For every place on a divider: the nearest lane on either side, if both run along it in one direction."""
    road = [number for number, lane in enumerate(source.lanes) if not lane.is_connector]
    if not road or not source.dashed_dividers:
        return set()
    samples = [polyline.resample(source.lanes[n].centre_m, STEP_M) for n in road]
    xy = np.concatenate([points for points, _ in samples])
    yaw = np.concatenate(
        [polyline.heading(source.lanes[n].centre_m, s) for n, (_, s) in zip(road, samples, strict=True)]
    )
    lane = np.repeat(road, [len(s) for _, s in samples])
    tree = cKDTree(xy)
    metres: Counter[tuple[int, int]] = Counter()
    for divider in source.dashed_dividers:
        line = np.asarray(divider.coords)[:, :2]
        points, s = polyline.resample(line, 1.0)
        near = cKDTree(points).sparse_distance_matrix(tree, REACH_M, output_type="ndarray")
        place, which = near["i"], near["j"]
        delta, along = xy[which] - points[place], polyline.heading(line, s)[place]
        metres.update(_beside(place, delta, yaw[which], lane[which], along))
    return {pair for pair, length in metres.items() if length >= SHARED_M}


def _beside(
    place: IntArray, delta: FloatArray, yaw: FloatArray, lane: IntArray, along: FloatArray
) -> list[tuple[int, int]]:
    """Return the (left, right) lanes nearest to each place on a divider that has one of a direction on either side.

    Args:
        place: (N,) numbers of places on the divider that points on lanes are near to.
        delta: (N, 2) from the places to these points.
        yaw: (N,) headings of the lanes there.
        lane: (N,) their numbers.
        along: (N,) headings of the divider.
    """
    ahead = np.cos(along) * delta[:, 0] + np.sin(along) * delta[:, 1]
    aside = np.cos(along) * delta[:, 1] - np.sin(along) * delta[:, 0]
    agree = np.cos(yaw - along)
    abreast = (np.abs(ahead) <= STEP_M) & (np.abs(agree) >= PARALLEL)
    sides = []
    for side in (1.0, -1.0):
        mine = np.flatnonzero(abreast & (side * aside > 0))
        mine = mine[np.lexsort((lane[mine], np.abs(aside[mine]), place[mine]))]
        places, first = np.unique(place[mine], return_index=True)
        sides.append((places, mine[first]))
    (left_places, left), (right_places, right) = sides
    _, of_left, of_right = np.intersect1d(left_places, right_places, return_indices=True)
    left, right = left[of_left], right[of_right]
    agreed = (lane[left] != lane[right]) & (agree[left] * agree[right] >= 0)
    forward = agree[left] > 0
    first, second = np.where(forward, lane[left], lane[right]), np.where(forward, lane[right], lane[left])
    return list(zip(first[agreed].tolist(), second[agreed].tolist(), strict=True))
