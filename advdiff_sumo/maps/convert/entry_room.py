"""Find entries of a clipped map that lie on other lanes, where an entering vehicle would block traffic."""

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
    """Return those of the edges *names*, which have no predecessor, where an entering car would block another lane.

    The body of an entering car still lies behind the beginning of the edge. There it may be less than 2.2 m away from
    other lanes or connections. Their junction has no connection for this car, so no vehicle yields to it.
    """
    lanes = [({edge.id}, lane.shape_m) for edge in plan.edges for lane in edge.lanes]
    connections = [({c.origin[0], c.target[0]}, c.shape_m) for c in plan.connections]
    owners = [owner for owner, _ in (*lanes, *connections)]
    tree = shapely.STRtree([LineString(line) for _, line in (*lanes, *connections)])

    def is_blocked(name: str) -> bool:
        bodies = [_entering_body(lane.shape_m) for lane in plan.edge_of[name].lanes]
        near = np.unique(tree.query(bodies, predicate="dwithin", distance=BODIES_M)[1])
        return any(name not in owners[number] for number in near.tolist())

    return [name for name in names if is_blocked(name)]


def _entering_body(lane_m: FloatArray) -> LineString:
    """Return the line that a car and its standing gap occupy when its front enters a lane (N, 2)."""
    start, after = lane_m[:2]
    return LineString([start, start - ROOM_M * (after - start) / np.hypot(*(after - start))])
