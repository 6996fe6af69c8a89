"""Find the roundabouts of a planned net, where circulating vehicles have priority (netconvert misses some)."""

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

LONGEST_M = 250.0  # longest circumference; longer loops surround blocks of houses
SAMPLES = 64  # points at which a loop is sampled
# Largest turn in an eighth of a loop: a circle turns by 45°, a block of houses by 90° at its corners.
EIGHTH_RAD = math.radians(75.0)
EMPTY_M = 1.5  # farther inside the loop there are no lanes
ENTRIES = 2  # smallest number of entries


def find_rings(plan: NetPlan) -> tuple[Ring, ...]:
    """Return the roundabouts of *plan*.

    From every edge, the connection nearest to a possible island is followed (the leftmost if traffic keeps right). A
    loop that returns to its beginning is a roundabout if it turns evenly, is at most ``LONGEST_M`` long, has at least
    two entries and no lane inside it.
    """
    connections: dict[str, list[ConnectionPlan]] = defaultdict(list)
    for connection in plan.connections:
        connections[connection.origin[0]].append(connection)
    edges = plan.edge_of
    side = -1.0 if plan.lefthand else 1.0
    inner = {name: max(leaving, key=lambda c: side * _turn(c)) for name, leaving in connections.items()}
    rings, visited = [], set[str]()
    for edge in plan.edges:
        loop = _loop(edge.id, inner, edges) if edge.id not in visited else None
        if loop is not None and _is_ring(loop, edges, plan, side):
            names = tuple(connection.origin[0] for connection in loop)
            visited.update(names)
            rings.append(Ring(names, tuple(edges[name].origin for name in names)))
    return tuple(rings)


def _turn(connection: ConnectionPlan) -> float:
    """Return the change of heading along a connection in rad, left positive."""
    return float(np.sum(polyline.turns(connection.shape_m)))


def _loop(
    start: str, inner: dict[str, ConnectionPlan], edges: dict[str, EdgePlan]
) -> list[ConnectionPlan] | None:
    """Follow *inner*, the innermost connection of each edge, from edge *start*.

    Returns:
        The connections back to *start*; None if the loop does not close within ``LONGEST_M``.
    """
    loop: list[ConnectionPlan] = []
    edge, length, passed = start, 0.0, set[str]()
    while edge in inner and edge not in passed and length <= LONGEST_M:
        passed.add(edge)
        loop.append(inner[edge])
        length += edges[edge].length_m + line_length_m(inner[edge].shape_m)
        edge = inner[edge].target[0]
        if edge == start:
            return loop if length <= LONGEST_M else None
    return None


def _is_ring(loop: list[ConnectionPlan], edges: dict[str, EdgePlan], plan: NetPlan, side: float) -> bool:
    """Return whether a closed *loop* of connections is a roundabout; *side*: 1 if it turns left, −1 if right."""
    names = {connection.origin[0] for connection in loop}
    junctions = {edges[name].target for name in names}
    if len(junctions) < len(loop) or len(loop) < 2:
        return False
    entries = {edge.id for edge in plan.edges if edge.target in junctions} - names
    line = np.vstack([part for connection in loop for part in (_lane(edges, connection), connection.shape_m)])
    return len(entries) >= ENTRIES and _turns_evenly(line, side) and _is_empty(line, names, plan)


def _lane(edges: dict[str, EdgePlan], connection: ConnectionPlan) -> FloatArray:
    return edges[connection.origin[0]].lanes[connection.origin[1]].shape_m


def _turns_evenly(line: FloatArray, side: float) -> bool:
    """Return whether a closed line turns full circle once, without corners; *side*: 1 to the left, −1 to the right."""
    closed = np.vstack((line, line[:1]))
    s = np.linspace(0.0, line_length_m(closed), SAMPLES, endpoint=False)
    points = polyline.at(closed, s)
    bends = side * polyline.turns(np.vstack((points, points[:2])))
    window = SAMPLES // 8
    eighths = np.convolve(np.concatenate((bends, bends[: window - 1])), np.ones(window), mode="valid")
    is_full_circle = abs(float(bends.sum()) - 2.0 * math.pi) < 0.1
    return is_full_circle and bool(eighths.max() <= EIGHTH_RAD)


def _is_empty(line: FloatArray, ring: set[str], plan: NetPlan) -> bool:
    """Return whether no lane or connection other than those of the *ring* lies inside the closed *line*."""
    island = shapely.Polygon(line).buffer(0.0).buffer(-EMPTY_M)
    return not any(island.intersects(shapely.LineString(other)) for other in _lines_outside(ring, plan))


def _lines_outside(ring: set[str], plan: NetPlan) -> Iterator[FloatArray]:
    """Yield the lines (N, 2) of all lanes and connections except those of the *ring*."""
    yield from (lane.shape_m for edge in plan.edges if edge.id not in ring for lane in edge.lanes)
    yield from (way.shape_m for way in plan.connections if not {way.origin[0], way.target[0]} <= ring)
