"""Make OpenStreetMap extracts around maps: of streets given in the map's frame, or of the streets of a SUMO net."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import pyproj
import sumolib

from advdiff_sumo.maps.convert.projection import projection_of

Point = tuple[float, float]


class OsmExtract:
    """OpenStreetMap ways through nodes in degrees; equal positions are one node."""

    def __init__(self, projection: str | None = None) -> None:
        self._plane = pyproj.Proj(projection or projection_of("boston-seaport"))
        self._nodes: dict[Point, int] = {}
        self._node_tags: dict[Point, dict[str, str]] = {}
        self._ways: list[tuple[list[int], dict[str, str]]] = []

    def way(self, *points_m: Point, **tags: str) -> None:
        """Add a way through points in m."""
        self.way_deg([self._plane(x, y, inverse=True) for x, y in points_m], **tags)

    def way_deg(self, places_deg: Sequence[Point], **tags: str) -> None:
        """Add a way through points (longitude, latitude)."""
        names = [
            self._nodes.setdefault((round(x, 8), round(y, 8)), len(self._nodes) + 1) for x, y in places_deg
        ]
        self._ways.append((names, {"highway": "residential"} | tags))

    def tag(self, place_deg: Point, **tags: str) -> None:
        """Give a node tags."""
        self._node_tags[round(place_deg[0], 8), round(place_deg[1], 8)] = tags

    def write(self, path: Path) -> Path:
        """Write the extract and return its path."""
        rows = [
            f'<node id="{n}" version="1" lat="{y:.8f}" lon="{x:.8f}">{_tags(self._node_tags.get((x, y), {}))}</node>'
            for (x, y), n in self._nodes.items()
        ]
        for number, (names, tags) in enumerate(self._ways, 1000):
            refs = "".join(f'<nd ref="{name}"/>' for name in names)
            rows.append(f'<way id="{number}" version="1">{refs}{_tags(tags)}</way>')
        text = ['<?xml version="1.0" encoding="UTF-8"?>', '<osm version="0.6">', *rows, "</osm>"]
        path.write_text("\n".join(text), encoding="utf-8")
        return path


def _tags(tags: dict[str, str]) -> str:
    return "".join(f"<tag k={quoteattr(key)} v={quoteattr(value)}/>" for key, value in tags.items())


def extract_of_net(net_file: Path) -> OsmExtract:
    """Return the streets for cars of a net that was made from OpenStreetMap, as an extract."""
    net = sumolib.net.readNet(str(net_file))
    extract = OsmExtract()
    for edge in net.getEdges():
        if not edge.getType().startswith("highway.") or not edge.allows("passenger"):
            continue
        line = edge.getRawShape()
        back = next(
            (other for other in edge.getToNode().getOutgoing() if other.getRawShape() == line[::-1]), None
        )
        if back is not None and back.getID() < edge.getID():
            continue
        ends = edge.getFromNode(), edge.getToNode()
        points = [ends[0].getCoord(), *line[1:-1], ends[1].getCoord()]
        lanes = edge.getLaneNumber() + (back.getLaneNumber() if back is not None else 0)
        extract.way_deg(
            [net.convertXY2LonLat(*point[:2]) for point in points],
            highway=edge.getType().split(".")[1].split("|")[0],
            oneway="yes" if back is None else "no",
            lanes=str(lanes),
            maxspeed=str(round(3.6 * edge.getSpeed())),
        )
        for node in ends:
            _signals(extract, net, node)
    return extract


def _signals(extract: OsmExtract, net: Any, node: Any) -> None:
    if node.getType() == "traffic_light":
        extract.tag(net.convertXY2LonLat(*node.getCoord()), highway="traffic_signals")
