"""Measures the offset between lanes of opposite directions, and infers on which side of the road traffic drives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.polylines import Polyline

BODY_M = 1.8
"""Width of a car: vehicles cannot drive abreast on centre lines that are closer than this."""
_ABREAST_M = 6.0  # largest distance of a lane of the other direction
_OPPOSITE_RAD = 0.9 * np.pi  # smallest difference of heading between the two
_SURE_SHARE = 0.8  # share of these lanes that must agree on the side of the road
_FEWEST_LANES = 4  # fewest lanes from which the side of the road is inferred


def opposite_offsets_m(lines: Sequence[Polyline]) -> FloatArray:
    """Return the lateral offset of each lane from the nearest lane of the other direction.

    Args:
        lines: N centre lines, in driving direction.

    Returns:
        (N,) metres to the left of the other lane, in its driving direction; right negative. Measured at the middle
        of each lane. NaN if no lane of the other direction is within 6 m.
    """
    tree = shapely.STRtree([shapely.LineString(line.xy_m) for line in lines])
    return np.array([_from_nearest_m(line, lines, tree) for line in lines])


def _from_nearest_m(line: Polyline, lines: Sequence[Polyline], tree: shapely.STRtree) -> float:
    xy_m, yaw_rad = line.at(0.5 * line.length_m)
    nearest_m = np.nan
    for row in np.sort(tree.query(shapely.Point(xy_m), predicate="dwithin", distance=_ABREAST_M)):
        s_m, d_m = lines[row].project(xy_m)
        difference_rad = abs(wrap_angle(lines[row].at(s_m)[1] - yaw_rad))
        if difference_rad > _OPPOSITE_RAD and not abs(d_m) >= abs(nearest_m):
            nearest_m = float(d_m)
    return nearest_m


def keeps_left(opposite_m: FloatArray) -> bool | None:
    """Return whether traffic drives on the left; None if the lanes leave it open.

    Args:
        opposite_m: (N,) result of :func:`opposite_offsets_m`.
    """
    beside_m = opposite_m[np.abs(opposite_m) >= BODY_M]
    if len(beside_m) < _FEWEST_LANES:
        return None
    left_share = float((beside_m < 0.0).mean())
    return left_share > 0.5 if max(left_share, 1.0 - left_share) >= _SURE_SHARE else None
