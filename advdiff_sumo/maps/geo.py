"""Converts a net's coordinates to longitude and latitude, if the net states its projection."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import pyproj

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.read_net import Location


class Projection:
    """Converts a net's metres to WGS84 degrees, by the net's ``location`` element."""

    def __init__(self, location: Location) -> None:
        self._location = location

    @property
    def proj4(self) -> str | None:
        """PROJ string whose metres are the net's own; None without a projection or if the net has an offset from it."""
        return None if np.any(self._location.offset_xy_m) else self._location.proj

    @cached_property
    def _proj(self) -> pyproj.Proj | None:
        return None if self._location.proj is None else pyproj.Proj(self._location.proj)

    def lonlat(self, xy_m: FloatArray) -> FloatArray | None:
        """Return longitude and latitude (…, 2) in degrees of *xy_m* (…, 2); None without a projection."""
        if self._proj is None:
            return None
        projected_m = np.asarray(xy_m, dtype=np.float64) - self._location.offset_xy_m
        return np.stack(self._proj(projected_m[..., 0], projected_m[..., 1], inverse=True), axis=-1)
