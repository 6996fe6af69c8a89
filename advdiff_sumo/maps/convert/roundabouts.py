"""Roundabouts of a planned net: who circulates goes first. netconvert's own search misses some."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator

import numpy as np
import shapely

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.netplan import ConnectionPlan, EdgePlan, NetPlan, Ring

LONGEST_M = 250.0  # circumference; larger ones are blocks of houses
SAMPLES = 64
EIGHTH_RAD = math.radians(
    75.0
)  # a circle turns by 45° in an eighth of its length, a block by 90° at its corners
EMPTY_M = 1.5  # nothing runs farther inside the ring than this
ENTRIES = 2


def find_rings(plan: NetPlan) -> tuple[Ring, ...]:
    """Return the roundabouts of *plan*.

    From every edge the way that keeps nearest to the island is followed (leftmost where traffic keeps right). What
    comes back to its beginning is a roundabout if it turns evenly, is no longer than ``LONGEST_M``, has two entries
    at least and nothing runs inside it.
    """
    ways: dict[str, list[ConnectionPlan]] = defaultdict(list)
    for way in plan.connections:
        ways[way.origin[0]].append(way)
    edges = {edge.id: edge for edge in plan.edges}
    side = -1.0 if plan.lefthand else 1.0
    inner = {name: max(own, key=lambda way: side * _turn(way)) for name, own in ways.items()}
    rings, visited = [], set[str]()
    for edge in plan.edges:
        loop = _loop(edge.id, inner, edges) if edge.id not in visited else None
        if loop is not None and _is_ring(loop, edges, plan, side):
            names = tuple(way.origin[0] for way in loop)
            visited.update(names)
            rings.append(Ring(names, tuple(edges[name].origin for name in names)))
    return tuple(rings)


def _turn(way: ConnectionPlan) -> float:
    """Return by how much a way turns to the left, in rad."""
    return float(np.sum(polyline.turns(way.shape_m)))


def _loop(
    start: str, inner: dict[str, ConnectionPlan], edges: dict[str, EdgePlan]
) -> list[ConnectionPlan] | None:
    """Return the ways from *start* back to it, or None if there are none within the longest circumference."""
    loop: list[ConnectionPlan] = []
    here, length, passed = start, 0.0, set[str]()
    while here in inner and here not in passed and length <= LONGEST_M:
        passed.add(here)
        loop.append(inner[here])
        length += edges[here].length_m + line_length_m(inner[here].shape_m)
        here = inner[here].target[0]
        if here == start:
            return loop if length <= LONGEST_M else None
    return None


def _is_ring(loop: list[ConnectionPlan], edges: dict[str, EdgePlan], plan: NetPlan, side: float) -> bool:
    names = {way.origin[0] for way in loop}
    junctions = {edges[name].target for name in names}
    if len(junctions) < len(loop) or len(loop) < 2:
        return False
    entries = {edge.id for edge in plan.edges if edge.target in junctions} - names
    line = np.vstack([part for way in loop for part in (_lane(edges, way), way.shape_m)])
    return len(entries) >= ENTRIES and _turns_evenly(line, side) and _is_empty(line, names, plan)


def _lane(edges: dict[str, EdgePlan], way: ConnectionPlan) -> FloatArray:
    return edges[way.origin[0]].lanes[way.origin[1]].shape_m


def _turns_evenly(line: FloatArray, side: float) -> bool:
    """Return whether a closed line goes round once, with no corner in it."""
    closed = np.vstack((line, line[:1]))
    s = np.linspace(0.0, line_length_m(closed), SAMPLES, endpoint=False)
    points = polyline.at(closed, s)
    bends = side * polyline.turns(np.vstack((points, points[:2])))
    window = SAMPLES // 8
    eighths = np.convolve(np.concatenate((bends, bends[: window - 1])), np.ones(window), mode="valid")
    once = abs(float(bends.sum()) - 2.0 * math.pi) < 0.1
    return once and bool(eighths.max() <= EIGHTH_RAD)


def _is_empty(line: FloatArray, ring: set[str], plan: NetPlan) -> bool:
    island = shapely.Polygon(line).buffer(0.0).buffer(-EMPTY_M)
    return not any(island.intersects(shapely.LineString(other)) for other in _others(ring, plan))


def _others(ring: set[str], plan: NetPlan) -> Iterator[FloatArray]:
    """Yield every lane and way but those of the ring."""
    yield from (lane.shape_m for edge in plan.edges if edge.id not in ring for lane in edge.lanes)
    yield from (way.shape_m for way in plan.connections if not {way.origin[0], way.target[0]} <= ring)
