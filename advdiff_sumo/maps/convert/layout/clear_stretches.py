"""Where on a connector nobody else's way is near: the place for an edge, if its junction has to be parted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import shapely
from shapely.geometry import LineString

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.layout.lane_segments import Piece

BODIES_M = 2.2  # two cars side by side with 0.3 m between them
STUB_M = 2.5  # length of an edge on a connector that has no better place for it


def clear_stretches(lines_m: Sequence[FloatArray], is_connector: Sequence[bool]) -> Mapping[int, Piece]:
    """Return the longest part of each connector from which all other lanes are over 2.2 m away.

    Where it is shorter than an edge should be, it is the middle of the connector: ways that cross it elsewhere cross
    an internal lane.

    Args:
        lines_m: centre line (N, 2) of each lane and connector.
        is_connector: whether each of them is a connector.
    """
    lines = [LineString(line) for line in lines_m]
    tree = shapely.STRtree(lines)
    connectors = [lane for lane, inside in enumerate(is_connector) if inside]
    return {lane: _clear_stretch(lane, lines, tree) for lane in connectors}


def _clear_stretch(lane: int, lines: Sequence[LineString], tree: shapely.STRtree) -> Piece:
    own = lines[lane]
    near = [
        other for other in tree.query(own, predicate="dwithin", distance=BODIES_M).tolist() if other != lane
    ]
    rest = own.difference(shapely.union_all([lines[other].buffer(BODIES_M, quad_segs=4) for other in near]))
    parts = [part for part in shapely.get_parts(rest) if isinstance(part, LineString)]
    best = max(parts, key=lambda part: part.length, default=None)
    if best is None or best.length < STUB_M:
        middle, half = 0.5 * own.length, 0.5 * STUB_M
        return Piece(lane, middle - half, middle + half)
    first, last = np.sort([own.project(shapely.Point(best.coords[end])) for end in (0, -1)])
    return Piece(lane, float(first), float(last))
