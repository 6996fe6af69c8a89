"""How far the geometry of SUMO's lanes can move a vehicle in one step, in addition to its speed.

SUMO stores a vehicle's position as an arc length on a lane and an offset from its centre line, and computes x and y
from them. This moves vehicles in three cases:

1. All lanes of an edge have the same nominal length, although their shapes differ in length. A lane change then also
   moves a vehicle along the lane.
2. A vehicle beside the centre line is moved by offset × angle at a bend.
3. Between two edges it is moved by the gap between the ends of their shapes.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Lane

_BESIDE_M = 0.3


def carried_m(road: RoadMap, bumper_xy_m: FloatArray, way_m: float) -> tuple[float, float]:
    """Return the least and the largest additional movement of a vehicle driven by SUMO in one step.

    They are taken over all lanes on which it may be before and after the step. The least is 0 or negative (for a lane
    whose shape is shorter than its nominal length). Both are 0 beside all lanes.

    Args:
        road: the map.
        bumper_xy_m: (2,) front bumper before the step.
        way_m: distance travelled by its speed.
    """
    poses = road.near(bumper_xy_m, 0.5 * float(road.index.width_m.max()) + _BESIDE_M)
    least, most = 0.0, 0.0
    for pose in poses:
        lane = road.lanes[pose.lane_id]
        if abs(pose.d_m) > 0.5 * lane.width_m + _BESIDE_M:
            continue
        for xy_m in _positions_after(road, lane, pose.s_m, pose.d_m, way_m):
            excess_m = float(np.hypot(*(xy_m - bumper_xy_m))) - way_m
            least, most = min(least, excess_m), max(most, excess_m)
    return least, most


def _positions_after(road: RoadMap, lane: Lane, s_m: float, d_m: float, way_m: float) -> Iterator[FloatArray]:
    """Yield possible positions (2,) after *way_m*, from the arc length *s_m* and the offset *d_m* on *lane*."""
    yield from _positions_at(road, lane, s_m + way_m, d_m)
    for name, side in ((lane.left_id, -1.0), (lane.right_id, 1.0)):
        if name is not None:
            neighbour = road.lanes[name]
            along = (s_m + way_m) / lane.length_m * neighbour.length_m
            yield from _positions_at(
                road, neighbour, along, d_m + side * 0.5 * (lane.width_m + neighbour.width_m)
            )


def _positions_at(road: RoadMap, lane: Lane, s_m: float, d_m: float) -> Iterator[FloatArray]:
    """Yield the positions (2,) at *s_m* and *d_m* on *lane*; beyond its end, also those on the lanes that follow."""
    yield road.to_world(lane.id, s_m, d_m)[0]
    if s_m > lane.length_m:
        for link in lane.successors:
            following = link.via[0] if link.via and link.from_lane == lane.id else link.to_lane
            yield road.to_world(following, s_m - lane.length_m, d_m)[0]
