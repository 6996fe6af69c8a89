"""Adds crossings, walking areas and sidewalks to a SUMO net without changing its vehicle lanes.

netconvert would build sidewalks as lanes of the roads' edges, which changes the indices and shapes of all lanes. So
these elements are added to a finished net: crossings with rows in the right-of-way matrix and links of the traffic
lights, walking areas at their ends, and sidewalks as separate edges.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import shapely
from shapely.geometry import Point, Polygon
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.maps.on_foot.carriageway import Carriageway
from advdiff_sumo.maps.on_foot.crossing_lines import (
    TAKEN,
    UNCONTROLLED,
    CrossingLine,
    crossing_lines,
    overlaps,
)
from advdiff_sumo.maps.on_foot.guess import guessed_crossings
from advdiff_sumo.maps.on_foot.kerbs import (
    Sidewalk,
    WalkingArea,
    kerbs_of,
    sidewalks,
    walking_areas,
)
from advdiff_sumo.maps.on_foot.net_writer import NetWriter, lanes_of
from advdiff_sumo.maps.read_net import read_root

Place: TypeAlias = tuple[float, float]
"""Position (x, y) in m."""
NO_SIDEWALK = "no place to stand at its end"


@dataclass(frozen=True)
class FootPaths:
    """The result of :func:`add_foot_paths`.

    Attributes:
        guessed: whether the crossings were guessed, not given.
        given: number of crossings that were guessed or given.
        kept: number of them that were added to the net.
        crossings: number of SUMO crossings in the net, one for each carriageway.
        left_out: reason → positions (x, y) in m of the crossings that were not added.
        sidewalk_m: total length of the sidewalks.
        on_walkways: share of that length that lies on the map's walkways; None if the map has none.
    """

    guessed: bool
    given: int
    kept: int
    crossings: int
    left_out: dict[str, list[Place]] = field(default_factory=dict)
    sidewalk_m: float = 0.0
    on_walkways: float | None = None


def add_foot_paths(
    net: Path,
    areas: Sequence[Polygon],
    *,
    guess: bool = False,
    drivable: BaseGeometry | None = None,
    walkways: Sequence[Polygon] = (),
) -> FootPaths:
    """Write crossings at *areas*, and sidewalks between them, into *net*.

    Args:
        net: a SUMO net; overwritten if there is anything to add.
        areas: outlines of the crossings that are painted on the road.
        guess: whether to put crossings over the arms of junctions if *areas* is empty.
        drivable: drivable area; its boundary and that of the lanes are the kerbs.
        walkways: areas for pedestrians; only compared with the result.
    """
    root = read_root(net, "net", "a SUMO net")
    road = Carriageway(root, drivable)
    guessed = guess and not areas
    outlines = guessed_crossings(road) if guessed else list(areas)
    crossings, left_out = _accepted(outlines, road)
    crossings, walking_places, footways = _with_sidewalks(crossings, road, left_out)
    parts = [part for crossing in crossings for part in crossing]
    if parts:
        NetWriter(root, road, parts, walking_places, footways).write()
        ET.indent(root, "    ")
        ET.ElementTree(root).write(net, encoding="utf-8", xml_declaration=True)
    lines = [shapely.LineString(footway.line_m) for footway in footways]
    total_m = float(sum(line.length for line in lines))
    share = None
    if walkways and total_m:
        walkway_area = shapely.union_all(list(walkways))
        share = round(float(sum(line.intersection(walkway_area).length for line in lines)) / total_m, 4)
    return FootPaths(
        guessed, len(outlines), len(crossings), len(parts), dict(left_out), round(total_m, 1), share
    )


def _accepted(
    outlines: Iterable[Polygon], road: Carriageway
) -> tuple[list[list[CrossingLine]], dict[str, list[Place]]]:
    """Return the parts of each crossing that can be added, and the positions of the other crossings by reason."""
    accepted: list[list[CrossingLine]] = []
    left_out: dict[str, list[Place]] = defaultdict(list)
    controlled = {
        j.get("id") for j in road.root.iterfind("junction") if len(j.findall("request")) == len(lanes_of(j))
    }
    for area in outlines:
        parts = crossing_lines(area, road)
        if isinstance(parts, str):
            left_out[parts].append(_place(area.centroid))
        elif not all(part.junction in controlled for part in parts):
            left_out[UNCONTROLLED].append(_place(area.centroid))
        elif overlaps(parts, [part for crossing in accepted for part in crossing]):
            left_out[TAKEN].append(_place(area.centroid))
        else:
            accepted.append(parts)
    return accepted, left_out


def _place(point: Point) -> Place:
    return round(point.x, 2), round(point.y, 2)


def _with_sidewalks(
    crossings: list[list[CrossingLine]], road: Carriageway, left_out: dict[str, list[Place]]
) -> tuple[list[list[CrossingLine]], list[WalkingArea], list[Sidewalk]]:
    """Return crossings, walking areas and sidewalks.

    A crossing is left out and added to *left_out* if no sidewalk and no other crossing continues from one of its ends.
    """
    kerbs = kerbs_of(road) if crossings else []
    while True:
        parts = [part for crossing in crossings for part in crossing]
        areas = walking_areas(parts, kerbs)
        footways = sidewalks(areas, kerbs, parts, road) if parts else []
        connected_areas = {number for footway in footways for number in (footway.origin, footway.target)}
        dead_ends = {
            part
            for number, area in enumerate(areas)
            if number not in connected_areas and len(area.ends) == 1
            for part, _ in area.ends
        }
        if not dead_ends:
            return crossings, areas, footways
        dead_ids = {id(parts[part]) for part in dead_ends}
        kept = [crossing for crossing in crossings if not any(id(part) in dead_ids for part in crossing)]
        left_out[NO_SIDEWALK] += [_place(c[0].line.centroid) for c in crossings if c not in kept]
        crossings = kept
