"""How far SUMO's own drawing of lanes carries a vehicle in one step.

SUMO moves a vehicle along numbers, position on a lane and offset beside its centre line, and draws it from them.
All lanes of an edge have one length in these numbers, however long each is drawn, so that a vehicle that changes lane
is also carried along; beside the centre line of a bend it is carried aside by offset × angle; and from one edge to the
next by the gap that the net draws between their ends.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Lane

_BESIDE_M = 0.3


def carried_m(road: RoadMap, bumper_xy_m: FloatArray, way_m: float) -> tuple[float, float]:
    """Return how much farther than *way_m* a vehicle of SUMO's may come in one step from its front bumper (2,).

    The least (0 or below: lanes that are drawn shorter than they are) and the most over all lanes that it may be on,
    and all on which it may be after the step; zeros beside all lanes.
    """
    near = road.near(bumper_xy_m, 0.5 * float(road.index.width_m.max()) + _BESIDE_M)
    least, most = 0.0, 0.0
    for pose in near:
        lane = road.lanes[pose.lane_id]
        if abs(pose.d_m) > 0.5 * lane.width_m + _BESIDE_M:
            continue
        for place in _after(road, lane, pose.s_m, pose.d_m, way_m):
            excess_m = float(np.hypot(*(place - bumper_xy_m))) - way_m
            least, most = min(least, excess_m), max(most, excess_m)
    return least, most


def _after(road: RoadMap, lane: Lane, s_m: float, d_m: float, way_m: float) -> Iterator[FloatArray]:
    """Yield where SUMO may draw, after *way_m*, what it has *d_m* left of *s_m* on *lane* now."""
    yield from _onward(road, lane, s_m + way_m, d_m)
    for name, side in ((lane.left_id, -1.0), (lane.right_id, 1.0)):
        if name is not None:
            beside = road.lanes[name]
            along = (s_m + way_m) / lane.length_m * beside.length_m
            yield from _onward(road, beside, along, d_m + side * 0.5 * (lane.width_m + beside.width_m))


def _onward(road: RoadMap, lane: Lane, s_m: float, d_m: float) -> Iterator[FloatArray]:
    yield road.to_world(lane.id, s_m, d_m)[0]
    if s_m > lane.length_m:
        for link in lane.successors:
            following = link.via[0] if link.via and link.from_lane == lane.id else link.to_lane
            yield road.to_world(following, s_m - lane.length_m, d_m)[0]
