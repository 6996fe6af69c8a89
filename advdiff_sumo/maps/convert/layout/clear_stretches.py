"""Find the stretch of each connector with no other lane near: the place for an edge that divides a junction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import shapely
from shapely.geometry import LineString

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.layout.lane_segments import Piece

BODIES_M = 2.2  # distance of centre lines with room for two cars: 0.3 m between their bodies
STUB_M = 2.5  # length of an edge on a connector without a longer clear stretch


def clear_stretches(lines_m: Sequence[FloatArray], is_connector: Sequence[bool]) -> Mapping[int, Piece]:
    """Return the longest part of each connector from which all other lanes are more than ``BODIES_M`` away.

    If that part is shorter than ``STUB_M``, the middle of the connector is returned. Lanes that cross the connector
    elsewhere then cross an internal lane.

    Args:
        lines_m: centre line (N, 2) of each lane and connector.
        is_connector: whether each of them is a connector.
    """
    lines = [LineString(line) for line in lines_m]
    tree = shapely.STRtree(lines)
    connectors = [lane for lane, inside in enumerate(is_connector) if inside]
    return {lane: _clear_stretch(lane, lines, tree) for lane in connectors}


def _clear_stretch(lane: int, lines: Sequence[LineString], tree: shapely.STRtree) -> Piece:
    line = lines[lane]
    near = [n for n in tree.query(line, predicate="dwithin", distance=BODIES_M).tolist() if n != lane]
    clear = line.difference(shapely.union_all([lines[n].buffer(BODIES_M, quad_segs=4) for n in near]))
    parts = [part for part in shapely.get_parts(clear) if isinstance(part, LineString)]
    longest = max(parts, key=lambda part: part.length, default=None)
    if longest is None or longest.length < STUB_M:
        middle, half = 0.5 * line.length, 0.5 * STUB_M
        return Piece(lane, middle - half, middle + half)
    first, last = np.sort([line.project(shapely.Point(longest.coords[end])) for end in (0, -1)])
    return Piece(lane, float(first), float(last))
