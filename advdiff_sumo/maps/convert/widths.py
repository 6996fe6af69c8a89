"""How wide a lane is along its centre line, measured on its polygon."""

from __future__ import annotations

import numpy as np
import shapely
from shapely.geometry import Polygon

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert import polyline

REACH_M = 8.0  # a lane edge farther from the centre line than this is no lane edge
DEFAULT_WIDTH_M = 3.5
SPACING_M = 4.0  # between the places where a lane is measured, or less
NARROWEST_M, WIDEST_M = 1.0, 12.0  # what is narrower is no width; what is wider counts as that


def width_profile(centre_m: FloatArray, polygon: Polygon | None) -> FloatArray:
    """Return rows (K, 2) of arc length and width in m; the width is that of the normal's part inside the polygon.

    The last metre at both ends is left out where the lane is long enough, since end edges may be oblique.
    Without a usable polygon there are no rows.
    """
    if polygon is None or polygon.is_empty:
        return np.empty((0, 2))
    total = line_length_m(centre_m)
    rim = min(1.0, 0.2 * total)
    s = np.linspace(rim, total - rim, max(3, int(total / SPACING_M) + 1))
    points, yaw = polyline.at(centre_m, s), polyline.heading(centre_m, s)
    normal = REACH_M * np.stack((-np.sin(yaw), np.cos(yaw)), axis=-1)
    rays = shapely.linestrings(np.stack((points - normal, points + normal), axis=1))
    inside = np.asarray(shapely.intersection(rays, polygon), dtype=object)
    widths = np.array([_through(part, point) for part, point in zip(inside, points, strict=True)])
    good = widths >= NARROWEST_M
    return np.stack((s[good], np.minimum(widths[good], WIDEST_M)), axis=-1)


def _through(chords: shapely.Geometry, point: FloatArray) -> float:
    """Return the length of the chord nearest to *point* (the normal may cut a bent lane twice), 0 if there is none."""
    parts = [part for part in shapely.get_parts(chords) if part.length > 0]
    place = shapely.Point(point)
    best = min(parts, key=lambda part: part.distance(place), default=None)
    return float(best.length) if best is not None and best.distance(place) < 0.5 else 0.0


def width_between(
    profile: FloatArray, from_m: float, to_m: float, default_m: float = DEFAULT_WIDTH_M
) -> float:
    """Return the median width between two arc lengths; *default_m* where the profile is empty."""
    if not len(profile):
        return default_m
    inside = profile[(profile[:, 0] >= from_m) & (profile[:, 0] <= to_m), 1]
    if len(inside):
        return float(np.median(inside))
    return float(np.interp(0.5 * (from_m + to_m), profile[:, 0], profile[:, 1]))
