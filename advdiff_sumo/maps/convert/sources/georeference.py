"""Where on earth a map lies that states a projected coordinate system and an offset: OpenDRIVE, CommonRoad."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass

from advdiff_sumo.maps.convert.projection import projection_from
from advdiff_sumo.maps.convert.sources.map_faults import MapFaults


@dataclass(frozen=True)
class PlanarTransform:
    """How places of a file become those of its coordinate system: turned and scaled, then moved by (x, y)."""

    x_m: float = 0.0
    y_m: float = 0.0
    turned_rad: float = 0.0
    scale: float = 1.0


def stated_projection(system: str | None, moved: PlanarTransform, faults: MapFaults) -> str | None:
    """Return the PROJ string whose plane is the frame of a map that states a *system*, or None.

    A system that cannot be used is told: the map needs none.
    """
    words = (system or "").split()
    if not words:
        return None
    try:
        if not all(map(math.isfinite, astuple(moved))):
            raise ValueError("has an offset that is no number")
        if moved.turned_rad or moved.scale != 1.0:
            raise ValueError("is turned or scaled, which a SUMO net cannot say")
        return projection_from(" ".join(words), (moved.x_m, moved.y_m))
    except ValueError as error:
        name = " ".join(words)[:60]
        faults.add(
            "place on earth unusable", f"its geoReference {name!r} {error}; the net has no place on earth"
        )
        return None
