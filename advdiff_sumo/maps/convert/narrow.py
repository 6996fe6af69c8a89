"""Ways through a junction that come too near each other for netconvert to notice: one of them has to yield.

SUMO takes a conflict for the spot where two centre lines cross, widened by the angle between them, and disregards who
is inside on a way that does not cross one's own. Opposite turns pass each other within less than a width over many
metres. ``<conflict>`` elements tell SUMO from where to where a way is shared.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from defusedxml import ElementTree
from shapely.geometry import LineString, Point

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.annotate import CONNECTION
from advdiff_sumo.maps.convert.layout.clear_stretches import BODIES_M
from advdiff_sumo.maps.convert.netplan import ConnectionPlan, NetPlan
from advdiff_sumo.maps.read_net import marked_requests

LONG_M = 12.0  # a crossing at 20° or more is shorter
Ends = tuple[str, str]  # edges that a way leaves and enters
Key = tuple[str, int, str, int]  # the same with lanes
Span = tuple[float, float]


def unseen_conflicts(plan: NetPlan, net: Path) -> list[tuple[Ends, Ends]]:
    """Return (who goes first, who yields) for ways that lie too near for two cars, which *net* lets go together.

    netconvert finds who conflicts with whom from the order of the edges around a junction. So it takes two turns
    that pass each other in a narrow neck for free of conflict, and some that cross where one edge enters a junction
    between the ends of another. The way that turns less goes first.
    """
    inside = _by_junction(plan)
    known = _known_conflicts(net)
    conflicts: set[tuple[Ends, Ends]] = set()
    for name in sorted(inside):
        for one, other in _near(inside[name]):
            if frozenset((one.key, other.key)) not in known:
                first, second = sorted((one, other), key=lambda way: (_turn(way), way.origin, way.target))
                conflicts.add((_ends(first), _ends(second)))
    return sorted(pair for pair in conflicts if pair[::-1] not in conflicts or pair < pair[::-1])


def unseen_pairs(plan: NetPlan) -> list[tuple[ConnectionPlan, ConnectionPlan]]:
    """Return the pairs of ways to different edges of which SUMO does not see where they are in each other's way.

    They come too near without crossing, or run along each other for long.
    """
    return [
        (one, other)
        for ways in _by_junction(plan).values()
        for one, other in _near(ways)
        if one.target[0] != other.target[0] and (not _cross(one, other) or _shared_m(one, other) > LONG_M)
    ]


def _cross(one: ConnectionPlan, other: ConnectionPlan) -> bool:
    return bool(shapely.LineString(one.shape_m).crosses(shapely.LineString(other.shape_m)))


def long_conflicts(plan: NetPlan) -> set[frozenset[Ends]]:
    """Return the pairs of ways of different edges that run close to each other, bodies touching, for long.

    SUMO takes a conflict of two ways for a spot where they cross; two opposite turns that meet at a flat angle over
    many metres must not be green together. Ways into one edge merge and are left aside.
    """
    return {
        frozenset((_ends(one), _ends(other)))
        for ways in _by_junction(plan).values()
        for one, other in _near(ways)
        if one.target[0] != other.target[0] and _shared_m(one, other) > LONG_M
    }


def junctions_of(pairs: Iterable[frozenset[Ends]], plan: NetPlan) -> set[str]:
    """Return the junctions in which *pairs* of ways meet."""
    target = {edge.id: edge.target for edge in plan.edges}
    return {target[origin] for pair in pairs for origin, _ in pair}


def _by_junction(plan: NetPlan) -> dict[str, list[ConnectionPlan]]:
    """Return the ways through each junction."""
    target = {edge.id: edge.target for edge in plan.edges}
    inside: dict[str, list[ConnectionPlan]] = defaultdict(list)
    for connection in plan.connections:
        if (
            connection.origin[0] in target
        ):  # those that come from a street beyond the rim have no others beside them
            inside[target[connection.origin[0]]].append(connection)
    return inside


def _shared_m(one: ConnectionPlan, other: ConnectionPlan) -> float:
    """Return the length of *one* that lies in the way of *other*."""
    near = shapely.LineString(other.shape_m).buffer(BODIES_M)
    return float(shapely.LineString(one.shape_m).intersection(near).length)


def _near(ways: list[ConnectionPlan]) -> Iterator[tuple[ConnectionPlan, ConnectionPlan]]:
    """Yield ways from different edges that come too near; into one edge only if they cross."""
    lines = [shapely.LineString(way.shape_m) for way in ways]
    near = shapely.STRtree(lines).query(lines, predicate="dwithin", distance=BODIES_M)
    for a, b in zip(*near.tolist(), strict=True):
        apart = ways[a].target[0] != ways[b].target[0] or lines[a].crosses(lines[b])
        if a < b and ways[a].origin[0] != ways[b].origin[0] and apart:
            yield ways[a], ways[b]


def _known_conflicts(net: Path) -> set[frozenset[Key]]:
    """Return the pairs of connections of which one yields to the other in a written net."""
    root: Any = ElementTree.fromstring(net.read_bytes())
    links: dict[str, dict[int, Key]] = defaultdict(dict)
    for row in root.iter("connection"):
        if row.get("via") and not row.attrib["from"].startswith(":"):
            junction, edge, lane = row.attrib["via"][1:].rsplit("_", 2)
            links[junction][int(edge) + int(lane)] = (
                row.attrib["from"],
                int(row.attrib["fromLane"]),
                row.attrib["to"],
                int(row.attrib["toLane"]),
            )
    known = set()
    for junction in root.iter("junction"):
        own = links[junction.attrib["id"]]
        for request in junction.iter("request"):
            here = own.get(int(request.attrib["index"]))
            for index in marked_requests(request.attrib["foes"]):
                if here is not None and index in own:
                    known.add(frozenset((here, own[index])))
    return known


def _turn(way: ConnectionPlan) -> float:
    """Return by how much a way turns, in whole degrees."""
    start, end = polyline.heading(way.shape_m, np.array([0.0, line_length_m(way.shape_m)]))
    return round(float(np.degrees(abs((end - start + np.pi) % (2.0 * np.pi) - np.pi))))


def _ends(way: ConnectionPlan) -> Ends:
    return way.origin[0], way.target[0]


def write_conflicts(net: Path, plan: NetPlan) -> int:
    """Write into the connections of *net* which parts of their ways others share; return for how many pairs."""
    shared: dict[Key, dict[Key, Span]] = defaultdict(dict)
    pairs = unseen_pairs(plan)
    for one, other in pairs:
        for way, foe in ((one, other), (other, one)):
            shared[way.key][foe.key] = shared_span(way.shape_m, foe.shape_m)
    if not shared:
        return 0

    def with_conflicts(match: re.Match[str]) -> str:
        key = (match["origin"], int(match["leaves"]), match["target"], int(match["enters"]))
        own = shared.get(key)
        if not own or ' via="' not in match[0]:
            return match[0]
        rows = "".join(_row(foe, span, match["indent"]) for foe, span in own.items())
        if match["close"] == "/>":
            return f"{match[0][:-2]}>\n{rows}{match['indent']}</connection>"
        return match[0].removesuffix("</connection>").rstrip() + f"\n{rows}{match['indent']}</connection>"

    net.write_text(CONNECTION.sub(with_conflicts, net.read_text(encoding="utf-8")), encoding="utf-8")
    return len(pairs)


def _row(foe: Key, span: Span, indent: str) -> str:
    origin, leaves, target, enters = foe
    return (
        f'{indent}    <conflict from="{origin}" to="{target}" fromLane="{leaves}" toLane="{enters}" '
        f'startPos="{span[0]:.2f}" endPos="{span[1]:.2f}"/>\n'
    )


def shared_span(line_m: FloatArray, foe_m: FloatArray) -> Span:
    """Return from where to where *line_m* lies so near to *foe_m* that bodies of cars touch."""
    line, foe = LineString(line_m), LineString(foe_m)
    near = shapely.get_coordinates(line.intersection(foe.buffer(BODIES_M)))
    if not len(near):  # a buffer is a polygon within the round shape, some millimetres short of it
        near = shapely.get_coordinates(shapely.shortest_line(line, foe))[:1]
    places = [line.project(Point(place)) for place in near]
    return min(places), max(places)
