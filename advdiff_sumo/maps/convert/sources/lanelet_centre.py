"""Draw the centre line of a lanelet as Lanelet2 itself does (``Lanelet.cpp`` of lanelet2_core)."""

from __future__ import annotations

import numpy as np
import shapely
from shapely.geometry import LineString

from advdiff_sumo.core.arrays import FloatArray

TOUCH_M = 1e-6  # length at the ends of a line that may touch a boundary without crossing it


def lanelet_centre(left_m: FloatArray, right_m: FloatArray) -> FloatArray:
    """Return the line (K, 2) midway between two boundaries (N, 2) and (M, 2) of the same direction.

    The method starts with the first points of both boundaries. In each step it advances on one boundary: to the point
    nearest to the current point of the other boundary. The new centre line and the line between the two points must
    not cross a boundary. Each step adds the middle between the two current points to the centre line.
    """
    sides = (np.asarray(left_m, dtype=np.float64), np.asarray(right_m, dtype=np.float64))
    boundaries = _Boundaries(*sides)
    at = [0, 0]
    if np.array_equal(sides[0][0], sides[1][0]) and len(sides[0]) > 1:  # both begin at the same point
        at[0] = 1
    centre = [0.5 * (sides[0][0] + sides[1][0])]
    while True:
        steps = [boundaries.nearest(side, at, centre[-1]) for side in (0, 1)]
        options = [(step[0], side, step[1]) for side, step in enumerate(steps) if step is not None]
        if not options:
            break
        _, side, point = min(options)
        at[side] = point
        centre.append(0.5 * (sides[0][at[0]] + sides[1][at[1]]))
    if at != [len(line) - 1 for line in sides]:
        centre.append(0.5 * (sides[0][-1] + sides[1][-1]))
    return np.array(centre)


class _Boundaries:
    """The boundaries of a lanelet, to find steps that do not cross them."""

    def __init__(self, left_m: FloatArray, right_m: FloatArray) -> None:
        self._sides = (left_m, right_m)
        self._bounds = shapely.union_all([LineString(left_m), LineString(right_m)])
        shapely.prepare(self._bounds)
        self._entry, self._exit = (right_m[0], left_m[0]), (left_m[-1], right_m[-1])

    def nearest(self, side: int, at: list[int], last_m: FloatArray) -> tuple[float, int] | None:
        """Return distance and number of the point to advance to on *side* (0: left), or None if there is none.

        The distance is measured from the current point of the other side. *at* are the numbers of the current points,
        *last_m* (2,) is the last point of the centre line.
        """
        line, opposite = self._sides[side], self._sides[1 - side][at[1 - side]]
        distance = np.hypot(*(line[at[side] + 1 :] - opposite).T)
        for number in np.argsort(distance, kind="stable").tolist():
            point = line[at[side] + 1 + number]
            middle = 0.5 * (point + opposite)
            centre_is_clear = self._stays_inside(last_m, middle) and self._is_clear(last_m, middle)
            if centre_is_clear and self._is_clear(opposite, point):
                return float(distance[number]), at[side] + 1 + number
        return None

    def _is_clear(self, start_m: FloatArray, end_m: FloatArray) -> bool:
        """Return whether the line between two points meets no boundary, except at its own ends."""
        step = end_m - start_m
        length = float(np.hypot(*step))
        if length <= 2.0 * TOUCH_M:
            return True
        inset = TOUCH_M * step / length
        return not self._bounds.intersects(LineString((start_m + inset, end_m - inset)))

    def _stays_inside(self, start_m: FloatArray, end_m: FloatArray) -> bool:
        """Return whether the line between two points does not leave the lane at its beginning or end."""
        line = LineString((start_m, end_m))
        return not any(
            _left_of(gate, end_m) > TOUCH_M and line.distance(LineString(gate)) < TOUCH_M
            for gate in (self._entry, self._exit)
        )


def _left_of(gate: tuple[FloatArray, FloatArray], point_m: FloatArray) -> float:
    """Return the lateral offset in m of a point (2,) from the line through both points of *gate*, left positive."""
    (x0, y0), (x1, y1) = gate
    length = float(np.hypot(x1 - x0, y1 - y0))
    if length == 0.0:
        return 0.0
    return float((x1 - x0) * (point_m[1] - y0) - (y1 - y0) * (point_m[0] - x0)) / length
