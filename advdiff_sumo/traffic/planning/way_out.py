"""Finds a lane for a vehicle that stands on a junction where no lane leads along its heading."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import local_from_world, wrap_angle
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Lane
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead, lane_ahead

_ON_LANE_M = 3.0
_AHEAD_RAD = 1.4
"""Largest bearing at which the beginning of a lane counts as ahead."""
_TURN_M_PER_RAD = 5.0
"""Distance that counts as much as a turn of one radian."""


def way_out(road: RoadMap, xy_m: FloatArray, yaw_rad: float) -> LaneAhead | None:
    """Return the exit lane of the junction that is easiest to reach; the vehicle is before its beginning.

    Args:
        road: the map.
        xy_m: (2,) centre of the box.
        yaw_rad: its heading.

    Returns:
        None if the vehicle is on no junction, or no exit lane begins ahead of it.
    """
    near = [road.lanes[pose.lane_id] for pose in road.near(xy_m, _ON_LANE_M)]
    junctions = {road.edges[lane.edge_id].from_junction for lane in near if lane.is_internal}
    if not junctions:
        return None
    exits = [
        road.lanes[name]
        for edge in road.edges.values()
        if not edge.is_internal and edge.from_junction in junctions
        for name in edge.lane_ids
        if road.lanes[name].is_drivable
    ]
    efforts = [(_effort_m(lane, xy_m, yaw_rad), lane.id) for lane in exits]
    effort, lane_id = min(efforts, default=(np.inf, ""))
    if not np.isfinite(effort):
        return None
    lane = road.lanes[lane_id]
    s, left = lane.line.project(xy_m, extrapolate=True)
    return lane_ahead(road.lanes, lane, min(float(s), 0.0), float(left))


def _effort_m(lane: Lane, xy_m: FloatArray, yaw_rad: float) -> float:
    """Return the distance to the beginning of *lane* plus a cost of the turn; inf if it is not ahead."""
    begin, lane_yaw = lane.line.at(0.0)
    offset = local_from_world(begin, xy_m, np.asarray(yaw_rad))
    if abs(np.arctan2(offset[1], offset[0])) > _AHEAD_RAD:
        return float(np.inf)
    return float(np.hypot(*offset) + _TURN_M_PER_RAD * abs(wrap_angle(float(lane_yaw) - yaw_rad)))
