"""Return edges from where a clipped map ends to where it begins, so that traffic flows endlessly.

They lie beside the map, not on it, have the type :data:`BEYOND_TYPE`, and nothing is measured on them.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.annotate import LANE
from advdiff_sumo.maps.convert.entry_room import blocked_entries
from advdiff_sumo.maps.convert.netplan import EdgePlan, NetPlan
from advdiff_sumo.maps.convert.polyline import shape_text
from advdiff_sumo.maps.convert.routability import reached, strong_parts
from advdiff_sumo.maps.read_net import BEYOND_TYPE

LENGTH_M = 100.0
SPEED_MPS = 13.89
WAY_M = 15.0
ASIDE_M, APART_M = 300.0, 10.0  # from the map's western rim, and from each other
VIA = re.compile(
    r'<connection from="(?P<origin>[^":]+)" to="(?P<target>[^"]+)" fromLane="(?P<leaves>\d+)"'
    r' toLane="(?P<enters>\d+)"[^>]* via="(?P<via>[^"]+)"'
)


@dataclass(frozen=True)
class ReturnEdge:
    """An edge from the end of edge *origin*, which leads nowhere, to *target*, which nothing leads to."""

    id: str
    origin: EdgePlan
    target: EdgePlan


def return_edges(
    plan: NetPlan, following_beyond: Mapping[str, Sequence[str]] | None = None
) -> tuple[tuple[ReturnEdge, ...], list[str]]:
    """Return edges that join every dead end to a beginning, every beginning to a dead end; and what stays open.

    Each takes the nearest partner that is left; then partners are exchanged until all edges that can reach a dead
    end can reach each other. Beginnings that lie on other lanes of the map (:mod:`.entry_room`) stay open, and so do
    beginnings and dead ends in a signalled junction, whose program knows the map's ways alone. Without dead ends or
    other beginnings there is no return edge. *following_beyond* tells which edges follow each street beyond the rim,
    where there are any.
    """
    following = _following(plan, following_beyond or {})
    entered = {after for names in following.values() for after in names}
    edges = {edge.id: edge for edge in plan.edges}
    signalled = {junction.id for junction in plan.junctions if junction.kind == "traffic_light"}
    ends = [name for name, edge in edges.items() if not following[name] and edge.target not in signalled]
    beginnings = [name for name in edges if name not in entered]
    blocked = {*blocked_entries(plan, beginnings), *(n for n in beginnings if edges[n].origin in signalled)}
    left_open = [name for name in beginnings if name in blocked]
    starts = [name for name in beginnings if name not in left_open]
    if not ends or not starts:
        return (), left_open
    unused = set(ends) - reached(starts, following)  # nobody comes there who could serve a beginning
    served = [name for name in ends if name not in unused] or ends
    pairs = _joined(_nearest(edges, served, starts), following)
    rest = [name for name in ends if name not in served]
    pairs += _to_nearest(edges, rest, starts)
    return tuple(ReturnEdge(f"rim{n}", edges[a], edges[b]) for n, (a, b) in enumerate(pairs)), left_open


def _following(plan: NetPlan, beyond: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:
    following: dict[str, dict[str, None]] = {edge.id: {} for edge in plan.edges}
    following |= {name: dict.fromkeys(after) for name, after in beyond.items()}
    for connection in plan.connections:
        following[connection.origin[0]][connection.target[0]] = None
    return {name: list(after) for name, after in following.items()}


def _nearest(edges: Mapping[str, EdgePlan], ends: list[str], starts: list[str]) -> list[tuple[str, str]]:
    """Pair ends and starts, nearest first; those of the longer list that are left take any nearest partner."""
    gaps = _gaps_m(edges, ends, starts)
    free_a, free_b = set(range(len(ends))), set(range(len(starts)))
    pairs = []
    for flat in np.argsort(gaps, axis=None, kind="stable").tolist():
        i, j = divmod(flat, len(starts))
        both = i in free_a and j in free_b
        rest = (i in free_a and not free_b) or (j in free_b and not free_a)
        if both or rest:
            pairs.append((i, j))
            free_a.discard(i)
            free_b.discard(j)
    pairs += [(i, int(gaps[i].argmin())) for i in sorted(free_a)]
    pairs += [(int(gaps[:, j].argmin()), j) for j in sorted(free_b)]
    return [(ends[i], starts[j]) for i, j in pairs]


def _to_nearest(edges: Mapping[str, EdgePlan], ends: list[str], starts: list[str]) -> list[tuple[str, str]]:
    """Pair each of *ends* with its nearest start."""
    if not ends:
        return []
    gaps = _gaps_m(edges, ends, starts)
    return [(name, starts[row.argmin()]) for name, row in zip(ends, gaps, strict=True)]


def _gaps_m(edges: Mapping[str, EdgePlan], ends: list[str], starts: list[str]) -> FloatArray:
    """Return the distances (E, S) from ends to starts in m."""
    a = np.array([edges[name].lanes[0].shape_m[-1] for name in ends])
    b = np.array([edges[name].lanes[0].shape_m[0] for name in starts])
    return np.asarray(np.linalg.norm(a[:, None] - b, axis=-1))


def _joined(pairs: list[tuple[str, str]], following: Mapping[str, Sequence[str]]) -> list[tuple[str, str]]:
    """Exchange the partners of pairs in different strongly connected parts, which makes the parts one."""
    while True:
        graph: dict[str, list[str]] = {name: list(after) for name, after in following.items()}
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
        one, other = inside[parts[0]][0], inside[parts[1]][0]
        pairs[one], pairs[other] = (pairs[one][0], pairs[other][1]), (pairs[other][0], pairs[one][1])


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
    """Yield the connections from every lane of the dead end and to every lane of the beginning."""
    for edge in edges:
        for lane in range(len(edge.origin.lanes)):
            yield _connection(edge.origin.id, edge.id, lane, 0)
        for lane in range(len(edge.target.lanes)):
            yield _connection(edge.id, edge.target.id, 0, lane)


def _connection(origin: str, target: str, leaves: int, enters: int) -> ET.Element:
    row = ET.Element("connection", {"from": origin, "to": target})
    row.set("fromLane", str(leaves))
    row.set("toLane", str(enters))
    row.set("contPos", "0")
    return row


def put_aside(net: Path, plan: NetPlan, edges: Sequence[ReturnEdge]) -> None:
    """Move the return edges of *net* to the west of the map; the ways to and from them go straight on at its rim.

    The ways are as long as a car and its gap, so that a car on the map has its whole body there or on the way.
    """
    text = net.read_text(encoding="utf-8")
    shapes = _lines(plan, edges)
    lane_m = {(edge.id, n): lane.shape_m for edge in plan.edges for n, lane in enumerate(edge.lanes)}
    returns = {edge.id for edge in edges}
    for match in VIA.finditer(text):
        if match["target"] in returns:
            end, before = lane_m[match["origin"], int(match["leaves"])][[-1, -2]]
            shapes[match["via"]] = np.array([end, end + _towards(before, end)])
        elif match["origin"] in returns:
            start, after = lane_m[match["target"], int(match["enters"])][[0, 1]]
            shapes[match["via"]] = np.array([start + _towards(after, start), start])

    def moved(match: re.Match[str]) -> str:
        shape = shapes.get(match["id"])
        return match[0] if shape is None else match[1] + shape_text(shape) + match[4]

    net.write_text(LANE.sub(moved, text), encoding="utf-8")


def _lines(plan: NetPlan, edges: Sequence[ReturnEdge]) -> dict[str, FloatArray]:
    """Return the shape of each return edge's lane: one beside the other, northwards."""
    west, south = np.vstack([lane.shape_m for edge in plan.edges for lane in edge.lanes]).min(axis=0)
    return {
        f"{edge.id}_0": np.array([[x, south], [x, south + LENGTH_M]])
        for edge, x in zip(edges, west - ASIDE_M - APART_M * np.arange(len(edges)), strict=True)
    }


def _towards(here: FloatArray, there: FloatArray) -> FloatArray:
    """Return the vector of a way's length in the direction from *here* to *there*."""
    return np.asarray(WAY_M * (there - here) / np.hypot(*(there - here)))
