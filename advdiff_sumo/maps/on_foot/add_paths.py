"""Writes crossings, walking areas and sidewalks into a SUMO net, whose lanes for vehicles stay as they are.

netconvert builds sidewalks as lanes of the roads' own edges, which would shift the numbers and shapes of all lanes, so
the elements are written after it: crossings over the ways of junctions with their rows of right of way and links of
the signals, walking areas at their ends, and sidewalks as edges of their own.
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
NO_SIDEWALK = "no place to stand at its end"


@dataclass(frozen=True)
class FootPaths:
    """What became of the crossings.

    Attributes:
        guessed: whether they are guessed rather than given.
        given: how many there were.
        kept: how many of them are in the net.
        crossings: SUMO crossings, one for each carriageway.
        left_out: places (x, y) in m of those that are not, by reason.
        sidewalk_m: length of all sidewalks.
        on_walkways: share of that length on the map's walkways; None where it has none.
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
        net: a SUMO net; written anew unless there is nothing to add.
        areas: what is painted on the road.
        guess: put crossings over the arms of junctions where *areas* is empty.
        drivable: area of which the rim is the kerb, beside the lanes.
        walkways: areas for people on foot, for comparison.
    """
    root = read_root(net, "net", "a SUMO net")
    road = Carriageway(root, drivable)
    guessed = guess and not areas
    wanted = guessed_crossings(road) if guessed else list(areas)
    lines, left_out = _accepted(wanted, road)
    lines, places, walks = _with_sidewalks(lines, road, left_out)
    crossings = [line for own in lines for line in own]
    if crossings:
        NetWriter(root, road, crossings, places, walks).write()
        ET.indent(root, "    ")
        ET.ElementTree(root).write(net, encoding="utf-8", xml_declaration=True)
    metres = [shapely.LineString(walk.line_m) for walk in walks]
    total = float(sum(line.length for line in metres))
    share = None
    if walkways and total:
        paved = shapely.union_all(list(walkways))
        share = round(float(sum(line.intersection(paved).length for line in metres)) / total, 4)
    return FootPaths(guessed, len(wanted), len(lines), len(crossings), dict(left_out), round(total, 1), share)


def _accepted(
    wanted: Iterable[Polygon], road: Carriageway
) -> tuple[list[list[CrossingLine]], dict[str, list[Place]]]:
    """Return the lines of each crossing that can be in the net, and where those are that cannot, by reason."""
    accepted: list[list[CrossingLine]] = []
    left_out: dict[str, list[Place]] = defaultdict(list)
    controlled = {
        j.get("id") for j in road.root.iterfind("junction") if len(j.findall("request")) == len(lanes_of(j))
    }
    for area in wanted:
        lines = crossing_lines(area, road)
        if isinstance(lines, str):
            left_out[lines].append(_place(area.centroid))
        elif not all(line.junction in controlled for line in lines):
            left_out[UNCONTROLLED].append(_place(area.centroid))
        elif overlaps(lines, [line for own in accepted for line in own]):
            left_out[TAKEN].append(_place(area.centroid))
        else:
            accepted.append(lines)
    return accepted, left_out


def _place(point: Point) -> Place:
    return round(point.x, 2), round(point.y, 2)


def _with_sidewalks(
    lines: list[list[CrossingLine]], road: Carriageway, left_out: dict[str, list[Place]]
) -> tuple[list[list[CrossingLine]], list[WalkingArea], list[Sidewalk]]:
    """Return crossings, walking areas and sidewalks; a crossing from which no sidewalk leads on is left out."""
    kerbs = kerbs_of(road) if lines else []
    while True:
        crossings = [line for own in lines for line in own]
        places = walking_areas(crossings, kerbs)
        walks = sidewalks(places, kerbs, crossings, road) if crossings else []
        served = {number for walk in walks for number in (walk.origin, walk.target)}
        dead = {
            number
            for place, area in enumerate(places)
            if place not in served and len(area.ends) == 1
            for number, _ in area.ends
        }
        if not dead:
            return lines, places, walks
        stuck = {id(crossings[number]) for number in dead}
        kept = [own for own in lines if not any(id(line) in stuck for line in own)]
        left_out[NO_SIDEWALK] += [_place(own[0].line.centroid) for own in lines if own not in kept]
        lines = kept
