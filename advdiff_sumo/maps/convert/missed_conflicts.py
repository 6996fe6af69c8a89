"""Find conflicts between connections of a junction that netconvert and SUMO miss, and state them in the net.

SUMO derives the area of a conflict from the point where two centre lines cross and from the angle between them. It
ignores vehicles on a connection that does not cross one's own. But two opposite turns may pass each other at less than
a vehicle's width over many metres. Elements ``<conflict>`` tell SUMO which part of a connection is shared.
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
from advdiff_sumo.maps.convert.annotate import CONNECTION, connection_key
from advdiff_sumo.maps.convert.layout.clear_stretches import BODIES_M
from advdiff_sumo.maps.convert.netplan import ConnectionKey, ConnectionPlan, Ends, NetPlan
from advdiff_sumo.maps.read_net import marked_requests

LONG_M = 12.0  # connections that share a longer stretch run along each other (a crossing at 20° or more is shorter)
Span = tuple[float, float]  # first and last arc length in m


def unseen_conflicts(plan: NetPlan, net: Path) -> list[tuple[Ends, Ends]]:
    """Return (first, yielding) connections that are too close for two cars but without conflict in *net*.

    netconvert derives conflicts from the order of the edges around a junction. So it misses two turns that pass each
    other in a narrow junction. It also misses some connections that cross if an edge enters the junction between the
    ends of another edge. The connection that turns less has priority.
    """
    inside = by_junction(plan)
    known = _known_conflicts(net)
    conflicts: set[tuple[Ends, Ends]] = set()
    for name in sorted(inside):
        for pair in _close_pairs(inside[name]):
            if frozenset(connection.key for connection in pair) not in known:
                first, second = sorted(pair, key=lambda c: (_turn(c), c.origin, c.target))
                conflicts.add((first.ends, second.ends))
    return sorted(pair for pair in conflicts if pair[::-1] not in conflicts or pair < pair[::-1])


def unseen_pairs(plan: NetPlan) -> list[tuple[ConnectionPlan, ConnectionPlan]]:
    """Return the pairs of connections to different edges whose shared stretch SUMO does not compute correctly.

    They come too close without crossing, or run along each other over a long distance.
    """
    return [
        (first, second)
        for first, second in _pairs_apart(plan)
        if not _lines_cross(first, second) or _shared_m(first, second) > LONG_M
    ]


def _lines_cross(first: ConnectionPlan, second: ConnectionPlan) -> bool:
    return bool(shapely.LineString(first.shape_m).crosses(shapely.LineString(second.shape_m)))


def long_conflicts(plan: NetPlan) -> set[frozenset[Ends]]:
    """Return the pairs of connections to different edges on which vehicles would touch over a long distance.

    SUMO treats a conflict as a point where two connections cross. So two opposite turns that meet at a small angle over
    many metres must not have green together. Connections into the same edge merge and are not returned.
    """
    return {
        frozenset((first.ends, second.ends))
        for first, second in _pairs_apart(plan)
        if _shared_m(first, second) > LONG_M
    }


def _pairs_apart(plan: NetPlan) -> Iterator[tuple[ConnectionPlan, ConnectionPlan]]:
    """Yield the pairs of connections to different edges that come too close."""
    for connections in by_junction(plan).values():
        for first, second in _close_pairs(connections):
            if first.target[0] != second.target[0]:
                yield first, second


def junctions_of(pairs: Iterable[frozenset[Ends]], plan: NetPlan) -> set[str]:
    """Return the junctions in which *pairs* of connections meet."""
    return {plan.edge_of[origin].target for pair in pairs for origin, _ in pair}


def by_junction(plan: NetPlan) -> dict[str, list[ConnectionPlan]]:
    """Return the connections through each junction."""
    inside: dict[str, list[ConnectionPlan]] = defaultdict(list)
    for connection in plan.connections:
        origin = plan.edge_of.get(connection.origin[0])
        if origin is not None:  # else from a street beyond the rim: no other connection is near
            inside[origin.target].append(connection)
    return inside


def _shared_m(connection: ConnectionPlan, foe: ConnectionPlan) -> float:
    """Return the length in m of *connection* on which vehicles would touch those on *foe*."""
    near = shapely.LineString(foe.shape_m).buffer(BODIES_M)
    return float(shapely.LineString(connection.shape_m).intersection(near).length)


def _close_pairs(connections: list[ConnectionPlan]) -> Iterator[tuple[ConnectionPlan, ConnectionPlan]]:
    """Yield pairs of connections from different edges that come too close; into the same edge only if they cross."""
    lines = [shapely.LineString(connection.shape_m) for connection in connections]
    near = shapely.STRtree(lines).query(lines, predicate="dwithin", distance=BODIES_M)
    for a, b in zip(*near.tolist(), strict=True):
        conflict = connections[a].target[0] != connections[b].target[0] or lines[a].crosses(lines[b])
        if a < b and connections[a].origin[0] != connections[b].origin[0] and conflict:
            yield connections[a], connections[b]


def _known_conflicts(net: Path) -> set[frozenset[ConnectionKey]]:
    """Return the pairs of connections that are foes of each other in a written net."""
    root: Any = ElementTree.fromstring(net.read_bytes())
    links: dict[str, dict[int, ConnectionKey]] = defaultdict(dict)
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
        by_index = links[junction.attrib["id"]]
        for request in junction.iter("request"):
            connection = by_index.get(int(request.attrib["index"]))
            for index in marked_requests(request.attrib["foes"]):
                if connection is not None and index in by_index:
                    known.add(frozenset((connection, by_index[index])))
    return known


def _turn(connection: ConnectionPlan) -> float:
    """Return the absolute change of heading along a connection, in whole degrees."""
    start, end = polyline.heading(connection.shape_m, np.array([0.0, line_length_m(connection.shape_m)]))
    return round(float(np.degrees(abs((end - start + np.pi) % (2.0 * np.pi) - np.pi))))


def write_conflicts(net: Path, plan: NetPlan) -> int:
    """Write into *net* which part of a connection others share; return the number of conflicting pairs."""
    shared: dict[ConnectionKey, dict[ConnectionKey, Span]] = defaultdict(dict)
    pairs = unseen_pairs(plan)
    for first, second in pairs:
        for connection, foe in ((first, second), (second, first)):
            shared[connection.key][foe.key] = shared_span(connection.shape_m, foe.shape_m)
    if not shared:
        return 0

    def with_conflicts(match: re.Match[str]) -> str:
        conflicts = shared.get(connection_key(match))
        if not conflicts or ' via="' not in match[0]:
            return match[0]
        rows = "".join(_conflict_row(foe, span, match["indent"]) for foe, span in conflicts.items())
        if match["close"] == "/>":
            return f"{match[0][:-2]}>\n{rows}{match['indent']}</connection>"
        return match[0].removesuffix("</connection>").rstrip() + f"\n{rows}{match['indent']}</connection>"

    net.write_text(CONNECTION.sub(with_conflicts, net.read_text(encoding="utf-8")), encoding="utf-8")
    return len(pairs)


def _conflict_row(foe: ConnectionKey, span: Span, indent: str) -> str:
    origin, from_lane, target, to_lane = foe
    return (
        f'{indent}    <conflict from="{origin}" to="{target}" fromLane="{from_lane}" toLane="{to_lane}" '
        f'startPos="{span[0]:.2f}" endPos="{span[1]:.2f}"/>\n'
    )


def shared_span(line_m: FloatArray, foe_m: FloatArray) -> Span:
    """Return the first and last arc length in m on *line_m* (N, 2) at which cars would touch those on *foe_m*."""
    line, foe = LineString(line_m), LineString(foe_m)
    near = shapely.get_coordinates(line.intersection(foe.buffer(BODIES_M)))
    if not len(near):  # the buffer is a polygon inside the round shape, too small by some millimetres
        near = shapely.get_coordinates(shapely.shortest_line(line, foe))[:1]
    stations = [line.project(Point(point)) for point in near]
    return min(stations), max(stations)
