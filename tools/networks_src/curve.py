"""Smooth plane curves for streets: splines by arc length, Hermite curves, arcs of circles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from shapely import LineString

from networks_src.plain import Points

STEP_M = 2.0
FLATNESS_M = 0.015


class Curve:
    """A C2 spline through points, parameterised by arc length.

    Args:
        points_m: (N, 2) points in order, N ≥ 2, without repetitions.
    """

    def __init__(self, points_m: Points) -> None:
        chord = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points_m, axis=0).T))])
        self._spline = CubicSpline(chord, points_m, bc_type="natural")
        dense = np.unique(np.concatenate([np.linspace(0.0, chord[-1], int(chord[-1] * 4) + 2), chord]))
        xy = self._spline(dense)
        travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
        self._parameter, self._travelled = dense, travelled
        self.stations_m = np.interp(chord, dense, travelled)

    @property
    def length_m(self) -> float:
        """Length of the curve."""
        return float(self._travelled[-1])

    def at(self, station_m: float | Points, offset_m: float | Points = 0.0) -> Points:
        """Return points (N, 2) at arc lengths `station_m`, moved `offset_m` to the left of the direction of travel."""
        parameter = np.interp(np.atleast_1d(station_m), self._travelled, self._parameter)
        tangent = self._spline(parameter, 1)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        return np.asarray(self._spline(parameter) + np.reshape(offset_m, (-1, 1)) * normal)

    def heading_rad(self, station_m: float) -> float:
        """Return the heading at an arc length."""
        dx, dy = self._spline(np.interp(station_m, self._travelled, self._parameter), 1)
        return float(np.arctan2(dy, dx))

    def piece(self, start_m: float, end_m: float, offset_m: float = 0.0) -> Points:
        """Return the curve between two arc lengths (backwards if `end_m` < `start_m`), moved left by `offset_m`.

        The offset is to the left of the curve itself, also if the piece runs backwards.
        """
        count = max(2, int(np.ceil(abs(end_m - start_m) / STEP_M)) + 1)
        return flatten(self.at(np.linspace(start_m, end_m, count), offset_m))


def normals(points_m: Points) -> Points:
    """Return unit vectors (N, 2) to the left of a polyline at its points."""
    tangent = np.gradient(points_m, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)


def flatten(points_m: Points) -> Points:
    """Drop points that lie within `FLATNESS_M` of the line through their neighbours."""
    return np.asarray(LineString(points_m).simplify(FLATNESS_M).coords)


def hermite(start_m: ArrayLike, heading_start_rad: float, end_m: ArrayLike, heading_end_rad: float) -> Points:
    """Return a smooth curve (N, 2) between two poses: cubic Hermite with tangents as long as the chord."""
    start, end = np.asarray(start_m, dtype=float), np.asarray(end_m, dtype=float)
    chord = float(np.hypot(*(end - start)))
    t = np.linspace(0.0, 1.0, max(8, int(chord / STEP_M)))[:, None]
    tangents = [chord * np.array([np.cos(h), np.sin(h)]) for h in (heading_start_rad, heading_end_rad)]
    blend = (2 * t**3 - 3 * t**2 + 1) * start + (t**3 - 2 * t**2 + t) * tangents[0]
    return flatten(blend + (3 * t**2 - 2 * t**3) * end + (t**3 - t**2) * tangents[1])


def arc(centre_m: Sequence[float], radius_m: float, start_rad: float, sweep_rad: float) -> Points:
    """Return points (N, 2) on a circle, from the angle `start_rad` over `sweep_rad` (positive counter-clockwise)."""
    count = max(5, int(np.ceil(abs(sweep_rad) / np.radians(4.0))) + 1)
    angle = start_rad + np.linspace(0.0, sweep_rad, count)
    return np.asarray(centre_m) + radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)
