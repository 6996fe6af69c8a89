"""Where a clipped map begins on lanes of its own: whoever came in there would stand in others' way."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import shapely
from shapely.geometry import LineString

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.layout.clear_stretches import BODIES_M
from advdiff_sumo.maps.convert.layout.lane_segments import ROOM_M
from advdiff_sumo.maps.convert.netplan import NetPlan


def blocked_entries(plan: NetPlan, names: Iterable[str]) -> list[str]:
    """Return those of the edges *names*, which nothing leads to, behind whose beginnings others drive.

    A car that enters such an edge has its body on lanes or ways from which it is not 2.2 m away, in a junction that
    does not know of it, so that nobody yields.
    """
    edges = {edge.id: edge for edge in plan.edges}
    lanes = [({edge.id}, lane.shape_m) for edge in plan.edges for lane in edge.lanes]
    ways = [({way.origin[0], way.target[0]}, way.shape_m) for way in plan.connections]
    owners = [owner for owner, _ in (*lanes, *ways)]
    tree = shapely.STRtree([LineString(line) for _, line in (*lanes, *ways)])

    def blocked(name: str) -> bool:
        bodies = [_body(lane.shape_m) for lane in edges[name].lanes]
        near = np.unique(tree.query(bodies, predicate="dwithin", distance=BODIES_M)[1])
        return any(name not in owners[number] for number in near.tolist())

    return [name for name in names if blocked(name)]


def _body(lane_m: FloatArray) -> LineString:
    """Return where a car and its gap are when it begins to drive on a lane (N, 2)."""
    start, after = lane_m[:2]
    return LineString([start, start - ROOM_M * (after - start) / np.hypot(*(after - start))])
