"""Write the side-car of a net (NAME.poly.xml): polygons that sumo-gui shows and RoadMap reads."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import shapely
from shapely.coords import CoordinateSequence
from shapely.geometry import Polygon

from advdiff_sumo.maps.convert.polyline import shape_text
from advdiff_sumo.maps.convert.sources.source_map import SourceMap

HOLE = "drivable_area_hole"
GRID_M = 0.001  # grid of coordinates, so that no polygon crosses itself after its numbers are rounded
STYLE = {  # colour and layer in sumo-gui
    "drivable_area": ("120,120,120", "-10"),
    HOLE: ("255,255,255", "-9"),
    "carpark_area": ("150,140,110", "-8"),
    "walkway": ("200,190,170", "-7"),
    "ped_crossing": ("230,230,230", "-6"),
}


def sidecar_path(net: Path) -> Path:
    """Return the path of the side-car of a net: NAME.net.xml → NAME.poly.xml."""
    return net.with_name(net.name.removesuffix(".xml").removesuffix(".net") + ".poly.xml")


def write_sidecar(source: SourceMap, path: Path) -> None:
    """Write drivable area, crossings, walkways and parking areas of *source* as SUMO polygons.

    SUMO polygons have no holes. So each hole of the drivable area is a polygon of type ``drivable_area_hole``, which
    readers must subtract from the area.
    """
    root = ET.Element("additional")
    for number, (kind, ring) in enumerate(_rings(source)):
        colour, layer = STYLE[kind]
        row = ET.SubElement(
            root, "poly", id=f"{kind}_{number}", type=kind, color=colour, fill="1", layer=layer
        )
        row.set("shape", shape_text(np.asarray(ring)[:-1, :2]))
        ET.SubElement(row, "param", key="location", value=source.location)
    ET.indent(root)
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _rings(source: SourceMap) -> Iterator[tuple[str, CoordinateSequence]]:
    """Yield type and coordinates of each polygon to write."""
    areas: list[tuple[str, list[Polygon]]] = [
        ("drivable_area", list(source.drivable.geoms)),
        ("carpark_area", list(source.carparks)),
        ("walkway", list(source.walkways)),
        ("ped_crossing", list(source.crossings)),
    ]
    for kind, polygons in areas:
        rounded = (shapely.set_precision(polygon, GRID_M) for polygon in polygons)
        for polygon in (part for whole in rounded for part in shapely.get_parts(whole)):
            yield kind, polygon.exterior.coords
            for hole in polygon.interiors if kind == "drivable_area" else ():
                yield HOLE, hole.coords
