"""Longitude and latitude of a net's points, where the net carries a projection."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import pyproj

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.read_net import Location


class Projection:
    """From a net's metres to WGS84 degrees, after its ``location`` element."""

    def __init__(self, location: Location) -> None:
        self._location = location

    @property
    def proj4(self) -> str | None:
        """PROJ string whose metres are the net's own; None without a projection or where the net is moved from it."""
        return None if np.any(self._location.offset_xy_m) else self._location.proj

    @cached_property
    def _proj(self) -> pyproj.Proj | None:
        return None if self._location.proj is None else pyproj.Proj(self._location.proj)

    def lonlat(self, xy_m: FloatArray) -> FloatArray | None:
        """Return longitude and latitude (…, 2) in degrees of *xy_m* (…, 2); None without a projection."""
        if self._proj is None:
            return None
        raw = np.asarray(xy_m, dtype=np.float64) - self._location.offset_xy_m
        return np.stack(self._proj(raw[..., 0], raw[..., 1], inverse=True), axis=-1)
