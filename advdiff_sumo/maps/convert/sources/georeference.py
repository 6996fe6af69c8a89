"""Derive a map's projection from the coordinate system and offset that it states (OpenDRIVE, CommonRoad)."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass

from advdiff_sumo.maps.convert.projection import projection_from
from advdiff_sumo.maps.convert.sources.map_faults import MapFaults


@dataclass(frozen=True)
class PlanarTransform:
    """Transform from coordinates of a file to its coordinate system: rotation and scaling, then translation (x, y)."""

    x_m: float = 0.0
    y_m: float = 0.0
    turned_rad: float = 0.0
    scale: float = 1.0


def stated_projection(system: str | None, transform: PlanarTransform, faults: MapFaults) -> str | None:
    """Return the PROJ string whose plane is the frame of a map that states a coordinate *system*, or None.

    A system that cannot be used is noted in *faults*, but the map can be converted without it.
    """
    words = (system or "").split()
    if not words:
        return None
    try:
        if not all(map(math.isfinite, astuple(transform))):
            raise ValueError("has an offset that is no number")
        if transform.turned_rad or transform.scale != 1.0:
            raise ValueError("is turned or scaled, which a SUMO net cannot say")
        return projection_from(" ".join(words), (transform.x_m, transform.y_m))
    except ValueError as error:
        name = " ".join(words)[:60]
        faults.add(
            "place on earth unusable", f"its geoReference {name!r} {error}; the net has no place on earth"
        )
        return None
