"""Whose plans leave the drivable area, go on beside it, or drive on the wrong side of the road."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.boxes import corners
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.planning.futures import Futures

OFF_SHARE = 0.25
"""Share of the box off the road, within the next seconds, that sends a vehicle back to its lane …"""
_MORE = 0.02
"""… if it is more by this than it is now: who is parked on the kerb may stay there …"""
_STAYS_M = 0.5
"""… but who moves farther than this must be back on the road by then."""
_OFF_STEPS = (1, 2, 3, 4, 6)
OVER_M = 0.3
"""How far a front corner may be over the line between the two directions."""
_AGAINST_RAD, _ALONG_RAD = 2.1, 1.0
_OVER_STEPS = (1, 2, 4)
_REACH_M = 4.0


def leaves_road(road: RoadMap, futures: Futures, rows: BoolArray, motor: BoolArray) -> BoolArray:
    """Return (N,) which of *rows* plan to leave the drivable area, to go on leaving it, or to drive beside it.

    Args:
        road: the map.
        futures: plans of N road users.
        rows: (N,) who is asked about.
        motor: (N,) who may not drive beside the road; a path for bicycles is no drivable area.
    """
    out = np.zeros(futures.agents, dtype=np.bool_)
    picked = np.flatnonzero(rows)
    if not len(picked):
        return out
    steps = np.array([0, *(k for k in _OFF_STEPS if k <= futures.steps)])
    size = np.repeat(futures.size_m[picked, None], len(steps), axis=1)
    boxes = corners(futures.xy_m[picked][:, steps], futures.yaw_rad[picked][:, steps], size)
    rest = ~road.covers(boxes).all(axis=(1, 2))
    if rest.any():
        share = road.off_road_share(boxes[rest].reshape(-1, 4, 2)).reshape(-1, len(steps))
        leaves = share[:, 1:].max(axis=1) > np.maximum(OFF_SHARE, share[:, 0] + _MORE)
        far = np.linalg.norm(futures.xy_m[picked[rest], steps[-1]] - futures.xy_m[picked[rest], 0], axis=-1)
        beside = (share[:, -1] > OFF_SHARE) & (far > _STAYS_M) & motor[picked[rest]]
        out[picked[rest]] = leaves | beside
    return out


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
    steps = np.array([k for k in _OVER_STEPS if k <= futures.steps])
    if not len(picked) or not len(steps):
        return out
    yaw = futures.yaw_rad[picked][:, steps]
    size = np.repeat(futures.size_m[picked, None], len(steps), axis=1)
    front = corners(futures.xy_m[picked][:, steps], yaw, size)[..., :2, :]  # (V, K, 2, 2)
    heading = np.repeat(yaw[..., None], 2, axis=-1)
    depth = over_line_m(road, front.reshape(-1, 2), heading.reshape(-1))
    out[picked] = depth.reshape(len(picked), -1).max(axis=1) > OVER_M
    return out
