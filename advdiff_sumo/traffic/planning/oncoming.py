"""Who plans to drive on the wrong side of the road."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.boxes import corners
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.planning.futures import Futures

OVER_M = 0.3
"""How far a front corner may be over the line between the two directions."""
_AGAINST_RAD, _ALONG_RAD = 2.1, 1.0
_STEPS = (1, 2, 4)
_REACH_M = 4.0


def over_line_m(road: RoadMap, xy_m: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Return (N,) how far points (N, 2) that head *yaw_rad* (N,) are inside lanes of the other direction, 0 or more.

    Places that a lane along the heading shares do not count: on a junction turns cross the lanes of the others.
    """
    index = road.index
    near = index.candidates(xy_m, _REACH_M)
    depth = 0.5 * index.width_m[near.lane] - np.abs(near.d_m)
    turned = np.abs(wrap_angle(yaw_rad[near.point] - near.yaw_rad))
    inside = (depth > 0.0) & index.is_drivable[near.lane]
    out = np.zeros(len(xy_m))
    against = inside & (turned > _AGAINST_RAD)
    np.maximum.at(out, near.point[against], depth[against])
    out[near.point[inside & (turned < _ALONG_RAD)]] = 0.0
    return out


def drives_against(road: RoadMap, futures: Futures, rows: BoolArray) -> BoolArray:
    """Return (N,) which of *rows* (N,) plan to be over the line within the next two seconds."""
    out = np.zeros(futures.agents, dtype=np.bool_)
    picked = np.flatnonzero(rows)
    steps = np.array([k for k in _STEPS if k <= futures.steps])
    if not len(picked) or not len(steps):
        return out
    yaw = futures.yaw_rad[picked][:, steps]
    size = np.repeat(futures.size_m[picked, None], len(steps), axis=1)
    front = corners(futures.xy_m[picked][:, steps], yaw, size)[..., :2, :]  # (V, K, 2, 2)
    heading = np.repeat(yaw[..., None], 2, axis=-1)
    depth = over_line_m(road, front.reshape(-1, 2), heading.reshape(-1))
    out[picked] = depth.reshape(len(picked), -1).max(axis=1) > OVER_M
    return out
