"""Where a vehicle can go that stands askew on a junction, where no lane leads along its heading."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import local_from_world, wrap_angle
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Lane
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead, lane_ahead

_ON_LANE_M = 3.0
_AHEAD_RAD, _TURN_M_PER_RAD = 1.4, 5.0


def way_out(road: RoadMap, xy_m: FloatArray, yaw_rad: float) -> LaneAhead | None:
    """Return the lane off the junction that is easiest to reach, with the vehicle before its beginning.

    Args:
        road: the map.
        xy_m: (2,) centre of the box.
        yaw_rad: its heading.

    Returns:
        None where the place is on no junction, or no lane off it begins ahead.
    """
    inner = [road.lanes[pose.lane_id] for pose in road.near(xy_m, _ON_LANE_M)]
    junctions = {road.edges[lane.edge_id].from_junction for lane in inner if lane.is_internal}
    if not junctions:
        return None
    exits = [
        road.lanes[name]
        for edge in road.edges.values()
        if not edge.is_internal and edge.from_junction in junctions
        for name in edge.lane_ids
        if road.lanes[name].is_drivable
    ]
    effort = [(_effort_m(lane, xy_m, yaw_rad), lane.id) for lane in exits]
    least = min(effort, default=(np.inf, ""))
    if not np.isfinite(least[0]):
        return None
    lane = road.lanes[least[1]]
    s, left = lane.line.project(xy_m, extrapolate=True)
    return lane_ahead(road.lanes, lane, min(float(s), 0.0), float(left))


def _effort_m(lane: Lane, xy_m: FloatArray, yaw_rad: float) -> float:
    """Return how far and how askew the beginning of *lane* is; inf where it is not ahead."""
    begin, along = lane.line.at(0.0)
    place = local_from_world(begin, xy_m, np.asarray(yaw_rad))
    if abs(np.arctan2(place[1], place[0])) > _AHEAD_RAD:
        return float(np.inf)
    return float(np.hypot(*place) + _TURN_M_PER_RAD * abs(wrap_angle(float(along) - yaw_rad)))
