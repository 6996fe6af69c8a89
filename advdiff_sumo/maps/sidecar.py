"""Reads the drivable area of a net from the file NAME.poly.xml beside it (its side-car)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import shapely
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.core.errors import NetError
from advdiff_sumo.maps.read_net import base_name, read_root, shape_of

AREA_TYPE = "drivable_area"
HOLE_TYPE = "drivable_area_hole"
_SAME_M2 = 1e-3
"""Areas that differ by less are equal."""


def sidecar_of(net_path: Path) -> Path | None:
    """Return the side-car beside *net_path*, gzipped or not; None if there is none."""
    for suffix in (".poly.xml", ".poly.xml.gz"):
        path = net_path.with_name(base_name(net_path) + suffix)
        if path.is_file():
            return path
    return None


def read_sidecar(path: Path) -> BaseGeometry | None:
    """Return the union of the drivable areas in *path* without their holes; None if the file has no drivable area.

    A hole does not remove an area that lies within it, such as a car park inside a ring of streets.

    Raises:
        NetError: the file cannot be read, is no SUMO additional file, or holds a malformed shape.
    """
    root = read_root(path, "additional", "a SUMO file of polygons")
    areas: list[BaseGeometry] = []
    holes: list[BaseGeometry] = []
    for element in root.iterfind("poly"):
        kind = element.get("type")
        if kind in (AREA_TYPE, HOLE_TYPE):
            try:
                outline = shape_of(element)
                polygon = Polygon(outline) if np.isfinite(outline).all() else Polygon()
            except ValueError as error:
                problem = f"polygon '{element.get('id')}' has a malformed shape ({error})"
                raise NetError(path, problem, "write the side-car anew or move it away") from None
            (areas if kind == AREA_TYPE else holes).append(shapely.make_valid(polygon))
    if not areas:
        return None
    return shapely.union_all([_less_holes(area, holes) for area in areas])


def _less_holes(area: BaseGeometry, holes: Sequence[BaseGeometry]) -> BaseGeometry:
    """Return *area* without the *holes* that overlap it but do not contain it."""
    shared_m2 = shapely.area(shapely.intersection(area, holes)) if holes else np.zeros(0)
    cut = [
        hole for hole, m2 in zip(holes, shared_m2.tolist(), strict=True) if 0.0 < m2 < area.area - _SAME_M2
    ]
    return shapely.difference(area, shapely.union_all(cut)) if cut else area
