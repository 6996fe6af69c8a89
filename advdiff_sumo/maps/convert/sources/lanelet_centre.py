"""The centre line of a lanelet, as Lanelet2 itself draws it (``Lanelet.cpp`` of lanelet2_core)."""

from __future__ import annotations

import numpy as np
import shapely
from shapely.geometry import LineString

from advdiff_sumo.core.arrays import FloatArray

TOUCH_M = 1e-6  # how much of a line at a point of a boundary does not count as crossing it


def lanelet_centre(left_m: FloatArray, right_m: FloatArray) -> FloatArray:
    """Return the line (K, 2) midway between two boundaries (N, 2), which run the same way.

    It is drawn like closing a zip. From the first points of both, the step is taken to the point on either side that
    lies nearest to the present point of the other side, further on, without the step or the line between the two
    points crossing a boundary. Each step adds the place midway between the two points.
    """
    sides = (np.asarray(left_m, dtype=np.float64), np.asarray(right_m, dtype=np.float64))
    lane = _Lane(*sides)
    at = [0, 0]
    if np.array_equal(sides[0][0], sides[1][0]) and len(sides[0]) > 1:  # it begins in a point
        at[0] = 1
    centre = [0.5 * (sides[0][0] + sides[1][0])]
    while True:
        steps = [lane.nearest(side, at, centre[-1]) for side in (0, 1)]
        options = [(step[0], side, step[1]) for side, step in enumerate(steps) if step is not None]
        if not options:
            break
        _, side, point = min(options)
        at[side] = point
        centre.append(0.5 * (sides[0][at[0]] + sides[1][at[1]]))
    if at != [len(line) - 1 for line in sides]:
        centre.append(0.5 * (sides[0][-1] + sides[1][-1]))
    return np.array(centre)


class _Lane:
    """Boundaries, and which steps between them do not cross them."""

    def __init__(self, left_m: FloatArray, right_m: FloatArray) -> None:
        self._sides = (left_m, right_m)
        self._bounds = shapely.union_all([LineString(left_m), LineString(right_m)])
        shapely.prepare(self._bounds)
        self._entry, self._exit = (right_m[0], left_m[0]), (left_m[-1], right_m[-1])

    def nearest(self, side: int, at: list[int], last_m: FloatArray) -> tuple[float, int] | None:
        """Return distance and number of the point to go to on *side* (0: left), None where there is none."""
        line, here = self._sides[side], self._sides[1 - side][at[1 - side]]
        away = np.hypot(*(line[at[side] + 1 :] - here).T)
        for number in np.argsort(away, kind="stable").tolist():
            point = line[at[side] + 1 + number]
            middle = 0.5 * (point + here)
            if self._inside(last_m, middle) and self._clear(last_m, middle) and self._clear(here, point):
                return float(away[number]), at[side] + 1 + number
        return None

    def _clear(self, start_m: FloatArray, end_m: FloatArray) -> bool:
        """Return whether the line between two places meets no boundary but at its own ends."""
        step = end_m - start_m
        length = float(np.hypot(*step))
        if length <= 2.0 * TOUCH_M:
            return True
        inset = TOUCH_M * step / length
        return not self._bounds.intersects(LineString((start_m + inset, end_m - inset)))

    def _inside(self, start_m: FloatArray, end_m: FloatArray) -> bool:
        """Return whether the line between two places does not leave the lane over its beginning or its end."""
        line = LineString((start_m, end_m))
        return not any(
            _left_of(gate, end_m) > TOUCH_M and line.distance(LineString(gate)) < TOUCH_M
            for gate in (self._entry, self._exit)
        )


def _left_of(gate: tuple[FloatArray, FloatArray], place_m: FloatArray) -> float:
    """Return how far left of the line through *gate* a place lies, in m."""
    (x0, y0), (x1, y1) = gate
    length = float(np.hypot(x1 - x0, y1 - y0))
    if length == 0.0:
        return 0.0
    return float((x1 - x0) * (place_m[1] - y0) - (y1 - y0) * (place_m[0] - x0)) / length
