"""Where lanes of the two directions of a street lie beside each other, and on which side one drives by that."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.polylines import Polyline

BODY_M = 1.8
"""Width of a car: nearer centre lines cannot both be driven at once."""
_ABREAST_M = 6.0  # farthest lane of the other direction that counts as beside one
_OPPOSITE_RAD = 0.9 * np.pi
_SURE_SHARE, _FEWEST_LANES = 0.8, 4  # of the lanes that have one of the other direction beside them


def from_opposite_m(lines: Sequence[Polyline]) -> FloatArray:
    """Return how far to the left of the nearest lane of the other direction each lane lies.

    Args:
        lines: N centre lines, in driving direction.

    Returns:
        (N,) metres at the middle of each lane, right negative; NaN where none is within 6 m.
    """
    tree = shapely.STRtree([shapely.LineString(line.xy_m) for line in lines])
    return np.array([_from_nearest_m(line, lines, tree) for line in lines])


def _from_nearest_m(line: Polyline, lines: Sequence[Polyline], tree: shapely.STRtree) -> float:
    xy_m, yaw_rad = line.at(0.5 * line.length_m)
    nearest = np.nan
    for row in np.sort(tree.query(shapely.Point(xy_m), predicate="dwithin", distance=_ABREAST_M)):
        s_m, d_m = lines[row].project(xy_m)
        turned_rad = abs(wrap_angle(lines[row].at(s_m)[1] - yaw_rad))
        if turned_rad > _OPPOSITE_RAD and not abs(d_m) >= abs(nearest):
            nearest = float(d_m)
    return nearest


def keeps_left(opposite_m: FloatArray) -> bool | None:
    """Return whether traffic keeps left; None where the lanes do not tell.

    Args:
        opposite_m: (N,) what :func:`from_opposite_m` says of the lanes.
    """
    beside_m = opposite_m[np.abs(opposite_m) >= BODY_M]
    if len(beside_m) < _FEWEST_LANES:
        return None
    left_share = float((beside_m < 0.0).mean())
    return left_share > 0.5 if max(left_share, 1.0 - left_share) >= _SURE_SHARE else None
