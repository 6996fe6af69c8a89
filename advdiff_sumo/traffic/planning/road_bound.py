"""Whose plans leave the drivable area, or go on beside it."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import BoolArray
from advdiff_sumo.core.boxes import corners
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.planning.futures import Futures

OFF_SHARE = 0.25
"""Share of the box off the road, within the next seconds, that sends a vehicle back to its lane …"""
_MORE = 0.02
"""… if it is more by this than it is now: who is parked on the kerb may stay there …"""
_STAYS_M = 0.5
"""… but who moves farther than this must be back on the road by then."""
_OFF_STEPS = (1, 2, 3, 4, 6)


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
