"""Measure the width of a lane along its centre line, on its polygon."""

from __future__ import annotations

import numpy as np
import shapely
from shapely.geometry import Polygon

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert import polyline

REACH_M = 8.0  # largest distance of a lane border from the centre line
DEFAULT_WIDTH_M = 3.5  # width of lanes that have no measured one
SPACING_M = 4.0  # largest distance between the stations where a lane is measured
NARROWEST_M = 1.0  # smaller widths are ignored
WIDEST_M = 12.0  # larger widths are limited to this


def width_profile(centre_m: FloatArray, polygon: Polygon | None) -> FloatArray:
    """Return rows (K, 2) of arc length and width in m along a centre line (N, 2); no rows without a usable polygon.

    The width is the length of the line's normal inside the polygon. The last metre at both ends (less on short lanes)
    is not measured, since the ends of the polygon may be oblique.
    """
    if polygon is None or polygon.is_empty:
        return np.empty((0, 2))
    total = line_length_m(centre_m)
    margin = min(1.0, 0.2 * total)
    s = np.linspace(margin, total - margin, max(3, int(total / SPACING_M) + 1))
    points, yaw = polyline.at(centre_m, s), polyline.heading(centre_m, s)
    normal = REACH_M * np.stack((-np.sin(yaw), np.cos(yaw)), axis=-1)
    rays = shapely.linestrings(np.stack((points - normal, points + normal), axis=1))
    inside = np.asarray(shapely.intersection(rays, polygon), dtype=object)
    widths = np.array([_width_at(part, xy) for part, xy in zip(inside, points, strict=True)])
    is_valid = widths >= NARROWEST_M
    return np.stack((s[is_valid], np.minimum(widths[is_valid], WIDEST_M)), axis=-1)


def _width_at(normal_inside: shapely.Geometry, xy: FloatArray) -> float:
    """Return the length of the part of the normal nearest to *xy* (a bent lane may have several), 0 if none is near."""
    parts = [part for part in shapely.get_parts(normal_inside) if part.length > 0]
    point = shapely.Point(xy)
    nearest = min(parts, key=lambda part: part.distance(point), default=None)
    return float(nearest.length) if nearest is not None and nearest.distance(point) < 0.5 else 0.0


def width_between(profile: FloatArray, from_m: float, to_m: float) -> float:
    """Return the median width in m between two arc lengths of *profile* (K, 2); ``DEFAULT_WIDTH_M`` if it is empty.

    If no row lies between them, the width is interpolated at their middle.
    """
    if not len(profile):
        return DEFAULT_WIDTH_M
    inside = profile[(profile[:, 0] >= from_m) & (profile[:, 0] <= to_m), 1]
    if len(inside):
        return float(np.median(inside))
    return float(np.interp(0.5 * (from_m + to_m), profile[:, 0], profile[:, 1]))
