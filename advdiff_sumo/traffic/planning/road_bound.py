"""Finds plans that leave the road, continue beside it, or drive on the wrong side of it."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.boxes import corners
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.planning.futures import Futures

OFF_SHARE = 0.25
"""A vehicle leaves the road if more than this share of its box is off it …"""
_OFF_SHARE_MARGIN = 0.02
"""… and more than the present share plus this; a vehicle parked on the kerb may stay there."""
_STAYS_M = 0.5
"""A vehicle that moves farther than this must be back on the road at the end of the checked time."""
_OFF_ROAD_STEPS = (1, 2, 3, 4, 6)
"""Instants of a plan that are checked for leaving the road."""
OVER_M = 0.3
"""Farthest that a front corner may be over the line between the two directions."""
_OPPOSITE_RAD, _SAME_RAD = 2.1, 1.0
"""Heading differences: a lane is opposite beyond the first, and leads along below the second."""
_WRONG_SIDE_STEPS = (1, 2, 4)
"""Instants of a plan that are checked for driving on the wrong side."""
_REACH_M = 4.0


def leaves_road(road: RoadMap, futures: Futures, rows: BoolArray, motor: BoolArray) -> BoolArray:
    """Return (N,) which of *rows* plan to leave the drivable area farther than now, or to drive on beside it.

    Args:
        road: the map.
        futures: plans of N road users.
        rows: (N,) which plans to check.
        motor: (N,) whether it may not drive beside the road; bicycles may, as cycle paths are not drivable area.
    """
    off_road = np.zeros(futures.agents, dtype=np.bool_)
    picked = np.flatnonzero(rows)
    if not len(picked):
        return off_road
    steps = np.array([0, *(k for k in _OFF_ROAD_STEPS if k <= futures.steps)])
    size = np.repeat(futures.size_m[picked, None], len(steps), axis=1)
    boxes = corners(futures.xy_m[picked][:, steps], futures.yaw_rad[picked][:, steps], size)
    partly_off = ~road.covers(boxes).all(axis=(1, 2))
    if partly_off.any():
        share = road.off_road_share(boxes[partly_off].reshape(-1, 4, 2)).reshape(-1, len(steps))
        leaves = share[:, 1:].max(axis=1) > np.maximum(OFF_SHARE, share[:, 0] + _OFF_SHARE_MARGIN)
        checked = picked[partly_off]
        moved = np.linalg.norm(futures.xy_m[checked, steps[-1]] - futures.xy_m[checked, 0], axis=-1)
        stays_off = (share[:, -1] > OFF_SHARE) & (moved > _STAYS_M) & motor[checked]
        off_road[checked] = leaves | stays_off
    return off_road


def over_line_m(road: RoadMap, xy_m: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Return (N,) how far points (N, 2) with headings (N,) are inside opposite lanes; 0 outside.

    A point that is also in a lane along its heading does not count: on junctions, turns cross opposite lanes.
    """
    index = road.index
    near = index.candidates(xy_m, _REACH_M)
    depth = 0.5 * index.width_m[near.lane] - np.abs(near.d_m)
    turn = np.abs(wrap_angle(yaw_rad[near.point] - near.yaw_rad))
    inside = (depth > 0.0) & index.is_drivable[near.lane]
    over_line = np.zeros(len(xy_m))
    opposite = inside & (turn > _OPPOSITE_RAD)
    np.maximum.at(over_line, near.point[opposite], depth[opposite])
    over_line[near.point[inside & (turn < _SAME_RAD)]] = 0.0
    return over_line


def drives_against(road: RoadMap, futures: Futures, rows: BoolArray) -> BoolArray:
    """Return (N,) which of *rows* (N,) plan to drive on the wrong side within the next two seconds."""
    wrong_side = np.zeros(futures.agents, dtype=np.bool_)
    picked = np.flatnonzero(rows)
    steps = np.array([k for k in _WRONG_SIDE_STEPS if k <= futures.steps])
    if not len(picked) or not len(steps):
        return wrong_side
    yaw = futures.yaw_rad[picked][:, steps]
    size = np.repeat(futures.size_m[picked, None], len(steps), axis=1)
    front = corners(futures.xy_m[picked][:, steps], yaw, size)[..., :2, :]  # (V, K, 2, 2)
    heading = np.repeat(yaw[..., None], 2, axis=-1)
    depth = over_line_m(road, front.reshape(-1, 2), heading.reshape(-1))
    wrong_side[picked] = depth.reshape(len(picked), -1).max(axis=1) > OVER_M
    return wrong_side
