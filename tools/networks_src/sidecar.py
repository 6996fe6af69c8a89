"""Write the drivable area and the footways of a net as a SUMO additional file (NAME.poly.xml)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import shapely
import sumolib
from shapely import LineString, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from networks_src.curve import normals
from networks_src.tapers import tapers

KERB_M = 0.35  # paved margin beside lanes
SHOULDER_M = 2.5  # the same on a motorway
RAMP_MPS, MOTORWAY_MPS = 16.0, 25.0  # least speed limits
ISLAND_M2 = 1500.0  # smaller holes are islands, without footways
FILLET_M = 1.0
HOLE_M2 = 3.0  # smaller holes are left out
TOLERANCE_M = 0.02
GRID_M = 0.01  # last decimal of the files, so that rounding cannot make a polygon cross itself
COLOURS = {
    "drivable_area": ("190,190,190", "-3"),
    "drivable_area_hole": ("225,235,220", "-2"),
    "walkway": ("235,220,200", "-1"),
}


def drivable_area(net: Any, fillet_m: float = FILLET_M) -> MultiPolygon:
    """Return the paved area: lanes and junctions with kerb margins or shoulders, and rounded concave corners.

    Args:
        net: sumolib net, read with internal lanes.
        fillet_m: radius of concave corners; gaps narrower than twice this are closed (tapers, gores).
    """
    paved = shapely.union_all([*_lane_areas(net), *_junction_areas(net), *tapers(net, _node_margin_m)])
    closed = paved.buffer(fillet_m, quad_segs=6).buffer(-fillet_m, quad_segs=6)
    return _parts(shapely.set_precision(closed.union(paved).simplify(TOLERANCE_M), GRID_M))


def walkways(net: Any, area: MultiPolygon, width_m: float) -> list[Polygon]:
    """Return footways along all kerbs except those of medians and islands, as simple polygons without holes."""
    islands = [h for part in area.geoms for h in part.interiors if Polygon(h).area < ISLAND_M2]
    closed = area.buffer(width_m).buffer(-width_m)  # medians
    area = _parts(shapely.union_all([area, closed, *(Polygon(h) for h in islands)]))
    band = area.buffer(width_m, quad_segs=3).simplify(0.1).difference(area)
    band = band.difference(shapely.union_all(_beyond_fringe(net)))
    simple = [shapely.set_precision(p, GRID_M) for ring in _parts(band).geoms for p in _without_holes(ring)]
    return [piece for polygon in simple for piece in _parts(polygon).geoms if not piece.interiors]


def write(net_file: Path, target: Path, name: str, footway_m: float) -> None:
    """Write the side-car of a net file to `target`; `footway_m` 0: without footways."""
    net = sumolib.net.readNet(str(net_file), withInternal=True)
    area = drivable_area(net)
    rows: list[tuple[str, Polygon]] = []
    for part in area.geoms:
        rows.append(("drivable_area", Polygon(part.exterior)))
        rows += [("drivable_area_hole", Polygon(h)) for h in part.interiors if Polygon(h).area >= HOLE_M2]
    if footway_m:
        rows += [("walkway", piece) for piece in walkways(net, area, footway_m)]
    root = ET.Element("additional")
    counts: dict[str, int] = {}
    for kind, polygon in rows:
        number = counts[kind] = counts.get(kind, -1) + 1
        colour, layer = COLOURS[kind]
        shape = " ".join(f"{x:.2f},{y:.2f}" for x, y in shapely.normalize(polygon).exterior.coords)
        row = {"id": f"{kind}_{number}", "type": kind, "color": colour, "fill": "1", "layer": layer}
        ET.SubElement(root, "poly", {**row, "shape": shape})
    ET.indent(root, "    ")
    note = f"<!-- Made by: python tools/make_networks.py {name} (SPDX-License-Identifier: Apache-2.0) -->"
    body = ET.tostring(root, encoding="unicode")
    target.write_text(f'<?xml version="1.0" encoding="UTF-8"?>\n{note}\n{body}\n', encoding="utf-8")


def _lane_areas(net: Any) -> list[BaseGeometry]:
    lanes = [lane for edge in net.getEdges(withInternal=True) for lane in edge.getLanes()]
    return [_band(lane.getShape(), lane.getWidth() / 2, _margins_m(lane)) for lane in lanes]


def _band(
    shape: Sequence[tuple[float, float]], half_m: float, margins_m: tuple[float, float]
) -> BaseGeometry:
    """Return a lane's surface with margins that change linearly from its beginning to its end."""
    first, last = margins_m
    lane = LineString(shape)
    even = lane.buffer(half_m + min(margins_m), cap_style="flat", join_style="mitre")
    if first == last:
        return even
    points = np.asarray(lane.segmentize(5.0).coords)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))]) / lane.length
    aside = normals(points) * (half_m + first + along * (last - first))[:, None]
    return shapely.union(even, Polygon(np.vstack([points + aside, (points - aside)[::-1]])))


def _margins_m(lane: Any) -> tuple[float, float]:
    """Return the margins at the beginning and the end of a lane; the shoulder of a ramp ends at the surface road."""
    if lane.getSpeed() < RAMP_MPS:
        return KERB_M, KERB_M
    first, last = (_node_margin_m(n) for n in (lane.getEdge().getFromNode(), lane.getEdge().getToNode()))
    return first, last


def _node_margin_m(node: Any) -> float:
    edges = [*node.getIncoming(), *node.getOutgoing()]
    return SHOULDER_M if any(e.getSpeed() >= MOTORWAY_MPS for e in edges) else KERB_M


def _junction_areas(net: Any) -> list[BaseGeometry]:
    shapes = [node.getShape() for node in net.getNodes() if node.getType() != "dead_end"]
    return [Polygon(shape).buffer(KERB_M, join_style="mitre") for shape in shapes if len(shape) >= 3]


def _beyond_fringe(net: Any) -> list[BaseGeometry]:
    """Return boxes beyond each fringe point, so that no footway leads around the end of a street."""
    boxes: list[BaseGeometry] = []
    for edge in net.getEdges(withInternal=False):
        points = np.asarray(edge.getShape())
        for node, end, before in ((edge.getToNode(), -1, -2), (edge.getFromNode(), 0, 1)):
            if node.getType() == "dead_end":
                outward = points[end] - points[before]
                ray = LineString([points[end], points[end] + 10.0 * outward / np.hypot(*outward)])
                boxes.append(ray.buffer(15.0, cap_style="flat"))
    return boxes


def _parts(area: BaseGeometry) -> MultiPolygon:
    pieces: list[BaseGeometry] = list(shapely.get_parts(area))
    polygons = [p for p in pieces if isinstance(p, Polygon)]
    ordered = sorted(polygons, key=_bounds)
    return MultiPolygon(ordered)


def _bounds(polygon: Polygon) -> tuple[float, float, float, float]:
    return polygon.bounds


def _without_holes(polygon: Polygon) -> list[Polygon]:
    """Return pieces of a polygon, cut north to south through its holes until no piece has one."""
    if not polygon.interiors:
        return [polygon] if polygon.area > HOLE_M2 else []
    x = polygon.interiors[0].centroid.x
    x0, y0, x1, y1 = polygon.buffer(1.0).bounds
    halves = [polygon.intersection(shapely.box(*b)) for b in ((x0, y0, x, y1), (x, y0, x1, y1))]
    return [piece for half in halves for part in _parts(half).geoms for piece in _without_holes(part)]
