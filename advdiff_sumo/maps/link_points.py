"""Points along the way that traffic on a link takes over its junction."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import concatenate
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.maps.roadmap import RoadMap


def points_over(
    road: RoadMap, link: Link, beyond_m: float, spacing_m: float, least_m: float = 0.0
) -> FloatArray:
    """Return points (P, 2) of the centre line over *link*, from the stop line on.

    Args:
        road: the net.
        link: a link over a junction.
        beyond_m: how far beyond the junction they reach, at most to the end of the lane there.
        spacing_m: distance between two of them.
        least_m: how far they reach at least; those beyond the end of the lane repeat that end.
    """
    lanes = [road.lanes[name] for name in (*link.via, link.to_lane)]
    line = concatenate([lane.line for lane in lanes])
    inside_m = sum(lane.length_m for lane in lanes[:-1])
    length_m = min(inside_m + beyond_m, line.length_m)
    return line.at(np.arange(0.0, max(length_m, least_m), spacing_m))[0]
