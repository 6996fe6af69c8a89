"""Add return edges from the exits of a clipped map to its entries, so that traffic never runs out.

They lie west of the map and have the type :data:`BEYOND_TYPE`. Nothing is measured on them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import shapely
from shapely.geometry import LineString

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.annotate import CONNECTION_VIA, put_shapes
from advdiff_sumo.maps.convert.layout.clear_stretches import BODIES_M
from advdiff_sumo.maps.convert.layout.lane_segments import ROOM_M
from advdiff_sumo.maps.convert.netplan import EdgePlan, NetPlan
from advdiff_sumo.maps.convert.routability import reachable, strong_parts
from advdiff_sumo.maps.read_net import BEYOND_TYPE

LENGTH_M = 100.0  # of a return edge
SPEED_MPS = 13.89  # speed limit on it
CONNECTION_M = 15.0  # length of a connection to or from it, enough for a car and its gap
WEST_M = 300.0  # distance from the western rim of the map
APART_M = 10.0  # distance between return edges


@dataclass(frozen=True)
class ReturnEdge:
    """An edge from the end of *origin*, an edge without successor, to *target*, an edge without predecessor."""

    id: str
    origin: EdgePlan
    target: EdgePlan


def return_edges(
    plan: NetPlan, following_beyond: Mapping[str, Sequence[str]] | None = None
) -> tuple[tuple[ReturnEdge, ...], list[str]]:
    """Return the return edges of a net, and the entries that stay without one.

    An exit is an edge without successor, an entry one without predecessor. Exits and entries are paired, nearest first.
    Then partners are exchanged until all edges that can reach an exit can reach each other. Exits that no entry leads
    to are joined to the nearest entry afterwards.

    Entries that lie on other lanes of the map (:func:`blocked_entries`) get no return edge. The same holds for entries
    and exits in a signalled junction, as its program covers the connections of the map only. Without exits or entries
    left there are no return edges.

    Args:
        plan: the planned net.
        following_beyond: the edges that follow each street beyond the rim, if there are streets.
    """
    following = _following(plan, following_beyond or {})
    entered = {successor for names in following.values() for successor in names}
    edges = plan.edge_of
    signalled = {junction.id for junction in plan.junctions if junction.kind == "traffic_light"}
    exits = [name for name, edge in edges.items() if not following[name] and edge.target not in signalled]
    all_entries = [name for name in edges if name not in entered]
    blocked = {*blocked_entries(plan, all_entries), *(n for n in all_entries if edges[n].origin in signalled)}
    left_open = [name for name in all_entries if name in blocked]
    entries = [name for name in all_entries if name not in left_open]
    if not exits or not entries:
        return (), left_open
    unused = set(exits) - reachable(entries, following)  # without traffic that could return to an entry
    used = [name for name in exits if name not in unused] or exits
    pairs = _strongly_connected(_pair_nearest(edges, used, entries), following)
    pairs += _pair_each_with_nearest(edges, [name for name in exits if name not in used], entries)
    return tuple(ReturnEdge(f"rim{n}", edges[a], edges[b]) for n, (a, b) in enumerate(pairs)), left_open


def blocked_entries(plan: NetPlan, names: Iterable[str]) -> list[str]:
    """Return those of the edges *names*, which have no predecessor, where an entering car would block another lane.

    The body of an entering car still lies behind the beginning of the edge. There it may be less than 2.2 m away from
    other lanes or connections. Their junction has no connection for this car, so no vehicle yields to it.
    """
    lanes = [({edge.id}, lane.shape_m) for edge in plan.edges for lane in edge.lanes]
    connections = [({c.origin[0], c.target[0]}, c.shape_m) for c in plan.connections]
    owners = [owner for owner, _ in (*lanes, *connections)]
    tree = shapely.STRtree([LineString(line) for _, line in (*lanes, *connections)])

    def is_blocked(name: str) -> bool:
        bodies = [_entering_body(lane.shape_m) for lane in plan.edge_of[name].lanes]
        near = np.unique(tree.query(bodies, predicate="dwithin", distance=BODIES_M)[1])
        return any(name not in owners[number] for number in near.tolist())

    return [name for name in names if is_blocked(name)]


def _entering_body(lane_m: FloatArray) -> LineString:
    """Return the line that a car and its standing gap occupy when its front enters a lane (N, 2)."""
    start, after = lane_m[:2]
    return LineString([start, start - ROOM_M * (after - start) / np.hypot(*(after - start))])


def _following(plan: NetPlan, beyond: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:
    """Return the edges that follow each edge of *plan* and each street *beyond* the rim."""
    following: dict[str, dict[str, None]] = {edge.id: {} for edge in plan.edges}
    following |= {name: dict.fromkeys(successors) for name, successors in beyond.items()}
    for connection in plan.connections:
        following[connection.origin[0]][connection.target[0]] = None
    return {name: list(successors) for name, successors in following.items()}


def _pair_nearest(
    edges: Mapping[str, EdgePlan], exits: list[str], entries: list[str]
) -> list[tuple[str, str]]:
    """Pair exits and entries, nearest first; those left of the longer list take their nearest partner again."""
    distances = _distances_m(edges, exits, entries)
    free_exits, free_entries = set(range(len(exits))), set(range(len(entries)))
    pairs = []
    for flat in np.argsort(distances, axis=None, kind="stable").tolist():
        i, j = divmod(flat, len(entries))
        both_free = i in free_exits and j in free_entries
        left_over = (i in free_exits and not free_entries) or (j in free_entries and not free_exits)
        if both_free or left_over:
            pairs.append((i, j))
            free_exits.discard(i)
            free_entries.discard(j)
    pairs += [(i, int(distances[i].argmin())) for i in sorted(free_exits)]
    pairs += [(int(distances[:, j].argmin()), j) for j in sorted(free_entries)]
    return [(exits[i], entries[j]) for i, j in pairs]


def _pair_each_with_nearest(
    edges: Mapping[str, EdgePlan], exits: list[str], entries: list[str]
) -> list[tuple[str, str]]:
    """Pair each of *exits* with its nearest entry."""
    if not exits:
        return []
    distances = _distances_m(edges, exits, entries)
    return [(name, entries[row.argmin()]) for name, row in zip(exits, distances, strict=True)]


def _distances_m(edges: Mapping[str, EdgePlan], exits: list[str], entries: list[str]) -> FloatArray:
    """Return the distances (number of exits, number of entries) from exits to entries in m."""
    ends = np.array([edges[name].lanes[0].shape_m[-1] for name in exits])
    starts = np.array([edges[name].lanes[0].shape_m[0] for name in entries])
    return np.asarray(np.linalg.norm(ends[:, None] - starts, axis=-1))


def _strongly_connected(
    pairs: list[tuple[str, str]], following: Mapping[str, Sequence[str]]
) -> list[tuple[str, str]]:
    """Exchange partners between pairs of different strongly connected parts of the net, until it has one part."""
    while True:
        graph: dict[str, list[str]] = {name: list(successors) for name, successors in following.items()}
        for a, b in pairs:
            graph[a].append(b)
        part_of = {name: n for n, part in enumerate(strong_parts(graph)) for name in part}
        inside: dict[int, list[int]] = defaultdict(list)
        for index, (a, b) in enumerate(pairs):
            if part_of[a] == part_of[b]:
                inside[part_of[a]].append(index)
        parts = sorted(inside)
        if len(parts) < 2:
            return pairs
        first, second = inside[parts[0]][0], inside[parts[1]][0]
        (exit_1, entry_1), (exit_2, entry_2) = pairs[first], pairs[second]
        pairs[first], pairs[second] = (exit_1, entry_2), (exit_2, entry_1)


def return_rows(edges: Sequence[ReturnEdge]) -> Iterator[ET.Element]:
    """Yield the return edges as netconvert's plain XML."""
    for edge in edges:
        yield ET.Element(
            "edge",
            {"id": edge.id, "from": edge.origin.target, "to": edge.target.origin, "type": BEYOND_TYPE},
            numLanes="1",
            speed=f"{SPEED_MPS}",
            length=f"{LENGTH_M}",
            priority="1",
        )


def return_connections(edges: Sequence[ReturnEdge]) -> Iterator[ET.Element]:
    """Yield the connections from every lane of the exit to a return edge, and from it to every lane of the entry."""
    for edge in edges:
        for lane in range(len(edge.origin.lanes)):
            yield _connection(edge.origin.id, edge.id, lane, 0)
        for lane in range(len(edge.target.lanes)):
            yield _connection(edge.id, edge.target.id, 0, lane)


def _connection(origin: str, target: str, from_lane: int, to_lane: int) -> ET.Element:
    row = ET.Element("connection", {"from": origin, "to": target})
    row.set("fromLane", str(from_lane))
    row.set("toLane", str(to_lane))
    row.set("contPos", "0")
    return row


def move_return_edges(net: Path, plan: NetPlan, edges: Sequence[ReturnEdge]) -> None:
    """Move the return edges of *net* to the west of the map.

    The connections to and from them continue the lanes of the map straight ahead. They are as long as a car and its
    gap, so that the body of a car whose front is on the map lies on the map or on the connection.
    """
    text = net.read_text(encoding="utf-8")
    shapes = _return_shapes(plan, edges)
    returns = {edge.id for edge in edges}
    for match in CONNECTION_VIA.finditer(text):
        if match["target"] in returns:
            end, before = plan.edge_of[match["origin"]].lanes[int(match["from_lane"])].shape_m[[-1, -2]]
            shapes[match["via"]] = np.array([end, end + _connection_vector(before, end)])
        elif match["origin"] in returns:
            start, after = plan.edge_of[match["target"]].lanes[int(match["to_lane"])].shape_m[[0, 1]]
            shapes[match["via"]] = np.array([start + _connection_vector(after, start), start])
    put_shapes(net, text, shapes)


def _return_shapes(plan: NetPlan, edges: Sequence[ReturnEdge]) -> dict[str, FloatArray]:
    """Return the shape of each return edge's lane by lane id: side by side, heading north."""
    west, south = plan.lane_points_m.min(axis=0)
    return {
        f"{edge.id}_0": np.array([[x, south], [x, south + LENGTH_M]])
        for edge, x in zip(edges, west - WEST_M - APART_M * np.arange(len(edges)), strict=True)
    }


def _connection_vector(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the vector (2,) of length ``CONNECTION_M`` in the direction from *start* to *end*."""
    return np.asarray(CONNECTION_M * (end - start) / np.hypot(*(end - start)))
