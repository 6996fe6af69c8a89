"""Apply stop lines of the source: where vehicles stop, and which turns yield at a line inside a junction."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import shapely
from shapely.geometry import LineString, Polygon

from advdiff_sumo.maps.convert.layout.clear_stretches import BODIES_M
from advdiff_sumo.maps.convert.missed_conflicts import by_junction
from advdiff_sumo.maps.convert.netplan import ConnectionPlan, EdgePlan, Ends, LanePlan, NetPlan
from advdiff_sumo.maps.convert.sources.source_map import SourceMap

LEAST_OFFSET_M = 0.5  # a stop line nearer to the end of its lane counts as being at the end
MOST_SHARE = 0.7  # largest share of a lane beyond its stop line; other lines are ignored
TURN_STOP = "TURN_STOP"  # kind of the lines inside a junction


def with_stop_offsets(edges: Iterable[EdgePlan], lines: dict[str, list[Polygon]]) -> tuple[EdgePlan, ...]:
    """Return *edges* with the stop offsets of their lanes set, so that vehicles stop before the stop lines.

    Args:
        edges: edges of a plan.
        lines: areas of the stop lines of each edge.
    """
    return tuple(
        replace(edge, lanes=tuple(_with_offset(lane, lines[edge.id]) for lane in edge.lanes))
        if edge.id in lines
        else edge
        for edge in edges
    )


def _with_offset(lane: LanePlan, areas: Sequence[Polygon]) -> LanePlan:
    """Return *lane* with the distance from the upstream border of its first stop line to its end."""
    line = LineString(lane.shape_m)
    crossings = [line.intersection(area) for area in areas if line.intersects(area)]
    if not crossings:
        return lane
    first = min(
        line.project(shapely.Point(point))
        for crossing in crossings
        for point in shapely.get_coordinates(crossing)
    )
    offset = float(line.length - first)
    if not LEAST_OFFSET_M <= offset <= MOST_SHARE * line.length:
        return lane
    return replace(lane, stop_offset_m=offset)


def waiting_turns(plan: NetPlan, source: SourceMap) -> list[tuple[Ends, Ends]]:
    """Return (first, yielding) pairs: connections across a TURN_STOP line yield to those close by without one."""
    areas = [line.area for line in source.stop_lines if line.kind.upper() == TURN_STOP]
    if not areas:
        return []
    junctions = by_junction(plan).values()
    pairs = {pair for connections in junctions for pair in _yielding_pairs(connections, areas)}
    return sorted(pair for pair in pairs if pair[::-1] not in pairs)


def _yielding_pairs(
    connections: list[ConnectionPlan], areas: Sequence[Polygon]
) -> Iterator[tuple[Ends, Ends]]:
    """Yield the pairs of one junction; *areas* are the TURN_STOP lines."""
    lines = [LineString(connection.shape_m) for connection in connections]
    has_stop = [any(line.intersects(area) for area in areas) for line in lines]
    for connection, line, must_yield in zip(connections, lines, has_stop, strict=True):
        for foe, foe_line, foe_must_yield in zip(connections, lines, has_stop, strict=True):
            conflict = connection.origin[0] != foe.origin[0] and line.distance(foe_line) < BODIES_M
            if must_yield and not foe_must_yield and conflict:
                yield foe.ends, connection.ends
