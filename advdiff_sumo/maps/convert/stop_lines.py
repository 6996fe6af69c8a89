"""What stop lines do beyond choosing a junction's kind: where vehicles stop, and which turns wait inside."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import shapely
from shapely.geometry import LineString, Polygon

from advdiff_sumo.maps.convert.layout.clear_stretches import BODIES_M
from advdiff_sumo.maps.convert.narrow import Ends
from advdiff_sumo.maps.convert.netplan import ConnectionPlan, EdgePlan, LanePlan, NetPlan
from advdiff_sumo.maps.convert.sources.source_map import SourceMap

LEAST_OFFSET_M = 0.5  # nearer to the lane's end the line is at the end
MOST_SHARE = 0.7  # of a lane that may lie behind its stop line
TURN_STOP = "TURN_STOP"


def with_stop_offsets(edges: Iterable[EdgePlan], lines: dict[str, list[Polygon]]) -> tuple[EdgePlan, ...]:
    """Return *edges* whose lanes stop vehicles before the stop lines that cross them.

    Args:
        edges: of a plan.
        lines: areas of the stop lines that act on each edge.
    """
    return tuple(
        replace(edge, lanes=tuple(_with_offset(lane, lines[edge.id]) for lane in edge.lanes))
        if edge.id in lines
        else edge
        for edge in edges
    )


def _with_offset(lane: LanePlan, areas: Sequence[Polygon]) -> LanePlan:
    """Return *lane* with the distance from the upstream edge of its stop line to its end."""
    line = LineString(lane.shape_m)
    hits = [line.intersection(area) for area in areas if line.intersects(area)]
    if not hits:
        return lane
    first = min(line.project(shapely.Point(place)) for hit in hits for place in shapely.get_coordinates(hit))
    offset = float(line.length - first)
    if not LEAST_OFFSET_M <= offset <= MOST_SHARE * line.length:
        return lane
    return replace(lane, stop_offset_m=offset)


def waiting_turns(plan: NetPlan, source: SourceMap) -> list[tuple[Ends, Ends]]:
    """Return (who goes first, who waits) for the ways through junctions that a TURN_STOP line crosses."""
    areas = [line.area for line in source.stop_lines if line.kind.upper() == TURN_STOP]
    if not areas:
        return []
    inside: dict[str, list[ConnectionPlan]] = defaultdict(list)
    target = {edge.id: edge.target for edge in plan.edges}
    for connection in plan.connections:
        inside[target[connection.origin[0]]].append(connection)
    pairs = {pair for ways in inside.values() for pair in _pairs(ways, areas)}
    return sorted(pair for pair in pairs if pair[::-1] not in pairs)


def _pairs(ways: list[ConnectionPlan], areas: Sequence[Polygon]) -> Iterator[tuple[Ends, Ends]]:
    lines = [LineString(way.shape_m) for way in ways]
    waits = [any(line.intersects(area) for area in areas) for line in lines]
    for own, line, waiting in zip(ways, lines, waits, strict=True):
        for other, foe, also in zip(ways, lines, waits, strict=True):
            apart = own.origin[0] != other.origin[0] and line.distance(foe) < BODIES_M
            if waiting and not also and apart:
                yield (other.origin[0], other.target[0]), (own.origin[0], own.target[0])
