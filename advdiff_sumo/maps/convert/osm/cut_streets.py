"""Cut away what of the streets lies on the HD map, and keep what leads from its rim back to it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from xml.etree import ElementTree as ET

import numpy as np
import shapely
from shapely.geometry import LineString
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.osm.import_streets import Street, StreetNet, beside
from advdiff_sumo.maps.convert.routability import reached

MARGIN_M = 0.5  # between a street and the HD map
SHORTEST_M = 2.0  # of what is left of a street
STUB_M = 5.0  # outside junctions; what is shorter has no room for a joint
NOTHING_M = 1e-6
HEADING_M = 5.0  # over which the heading at an end is taken


@dataclass(frozen=True, eq=False)
class StreetStretch:
    """What is left of a street between two places on its middle line.

    Attributes:
        id: name of the edge that it becomes.
        street: the street.
        from_m: where it begins.
        to_m: where it ends.
        begins_open: whether an HD lane may lead into it, as it was cut there or nothing else leads into it.
        ends_open: the same of its end.
    """

    id: str
    street: Street
    from_m: float
    to_m: float
    begins_open: bool
    ends_open: bool

    @property
    def length_m(self) -> float:
        """Length in m."""
        return self.to_m - self.from_m

    @cached_property
    def middle_m(self) -> FloatArray:
        """(N, 2) middle line."""
        return polyline.cut(self.street.middle_m, self.from_m, self.to_m)

    @property
    def clear_m(self) -> float:
        """Length outside the junctions at its ends."""
        return min(self.to_m, self.street.clear_m[1]) - max(self.from_m, self.street.clear_m[0])

    @property
    def has_start(self) -> bool:
        """Whether nothing was cut off its beginning."""
        return self.from_m == 0.0

    @property
    def has_end(self) -> bool:
        """Whether nothing was cut off its end."""
        return self.to_m == line_length_m(self.street.middle_m)

    def shorter(self, by_m: float, *, at_start: bool) -> StreetStretch:
        """Return the stretch without *by_m* at one end."""
        if at_start:
            return replace(self, from_m=self.from_m + by_m)
        return replace(self, to_m=self.to_m - by_m)

    def lane_lines(self, lefthand: bool) -> list[FloatArray]:
        """Return the centre line (N, 2) of each lane; lane 0 is the outermost."""
        return [beside(self.middle_m, left) for left in self.street.lane_offsets_m(lefthand)]

    @cached_property
    def directions(self) -> tuple[FloatArray, FloatArray]:
        """Unit vectors along the first and the last metres."""
        reach = min(HEADING_M, self.length_m)
        begin, after, before, end = polyline.at(
            self.middle_m, np.array([0.0, reach, self.length_m - reach, self.length_m])
        )
        return polyline.direction(begin, after), polyline.direction(before, end)


def stretches_outside(net: StreetNet, area: BaseGeometry) -> list[StreetStretch]:
    """Return what of the streets of *net* lies outside *area*, the HD map's."""
    widened: dict[float, BaseGeometry] = {}
    stretches: list[StreetStretch] = []
    for street in net.streets.values():
        half_m = round(0.5 * street.width_m + MARGIN_M, 2)
        if half_m not in widened:
            widened[half_m] = area.buffer(half_m)
            shapely.prepare(widened[half_m])
        stretches += _outside(street, net, widened[half_m])
    return _without_stubs(stretches, net)


def _without_stubs(stretches: Sequence[StreetStretch], net: StreetNet) -> list[StreetStretch]:
    """Return *stretches* without what is left of a street between the map and the next one, too short for a joint.

    That is where a street changes its lanes just beyond the map: the next one takes the joint.
    """
    stubs = [s for s in stretches if s.has_start is not s.has_end and s.clear_m < STUB_M]
    inward = {
        (s.street.target, s.street.origin): s for s in stubs if s.has_end and _passes(net, s.street.target)
    }
    outward = {
        (s.street.origin, s.street.target): s for s in stubs if s.has_start and _passes(net, s.street.origin)
    }
    left_out = {stub.id for stub in (*inward.values(), *outward.values())}
    return [
        replace(
            stretch,
            begins_open=stretch.begins_open or (stretch.has_start and _beyond(inward, stretch.street, 0)),
            ends_open=stretch.ends_open or (stretch.has_end and _beyond(outward, stretch.street, 1)),
        )
        for stretch in stretches
        if stretch.id not in left_out
    ]


def _passes(net: StreetNet, node: str) -> bool:
    return len(net.neighbours[node]) == 2


def _beyond(stubs: Collection[tuple[str, str]], street: Street, end: int) -> bool:
    """Return whether one of *stubs*, by its nodes, lies on the other side of the node at an end of *street*."""
    node, other = (street.origin, street.target) if end == 0 else (street.target, street.origin)
    return any(at == node and away != other for at, away in stubs)


def _outside(street: Street, net: StreetNet, area: BaseGeometry) -> Iterator[StreetStretch]:
    line = LineString(street.middle_m)
    length_m = line_length_m(street.middle_m)
    parts = shapely.get_parts(line.difference(area)).tolist() if area.intersects(line) else [line]
    for number, (first, last) in enumerate(sorted(_span(part, line) for part in parts)):
        starts, ends = first < NOTHING_M, last > length_m - NOTHING_M
        if not (starts and ends) and last - first < SHORTEST_M:
            continue
        yield StreetStretch(
            street.id if starts and ends else f"{street.id}.{number}",
            street,
            0.0 if starts else first,
            length_m if ends else last,
            not starts or net.is_dead_end(street.origin),
            not ends or net.is_dead_end(street.target),
        )


def _span(part: LineString, line: LineString) -> tuple[float, float]:
    """Return between which arc lengths of *line* its *part* lies; its middle tells, as a loop begins where it ends."""
    middle = line.project(part.interpolate(0.5, normalized=True))
    return middle - 0.5 * part.length, middle + 0.5 * part.length


class StretchGraph:
    """Which stretches follow each other.

    Attributes:
        names: of the stretches.
        connections: rows of connections with the stretches that they join.
    """

    def __init__(self, net: StreetNet, stretches: Sequence[StreetStretch]) -> None:
        first: dict[str, StreetStretch] = {}
        last: dict[str, StreetStretch] = {}
        for stretch in stretches:
            if stretch.has_start:
                first[stretch.street.id] = stretch
            if stretch.has_end:
                last[stretch.street.id] = stretch
        rows = ((row, last.get(row.attrib["from"]), first.get(row.attrib["to"])) for row in net.connections)
        self.names = {stretch.id for stretch in stretches}
        self.connections = [(row, a, b) for row, a, b in rows if a is not None and b is not None]

    def between(self, entered: Collection[str], left: Collection[str]) -> set[str]:
        """Return the stretches on ways from those that the HD map leads into to those that lead back to it."""
        onward: dict[str, set[str]] = defaultdict(set)
        backward: dict[str, set[str]] = defaultdict(set)
        for _, a, b in self.connections:
            onward[a.id].add(b.id)
            backward[b.id].add(a.id)
        return reached(entered, onward) & reached(left, backward)

    def parted(self, entered: Collection[str], left: Collection[str]) -> StretchGraph:
        """Return the graph in which only the map leads into *entered* stretches, and on from *left* ones."""
        return self._with(
            self.names,
            [(row, a, b) for row, a, b in self.connections if b.id not in entered and a.id not in left],
        )

    def only(self, kept: Collection[str]) -> StretchGraph:
        """Return the graph of the stretches *kept*."""
        rows = [(row, a, b) for row, a, b in self.connections if a.id in kept and b.id in kept]
        return self._with(set(kept), rows)

    def _with(
        self, names: set[str], rows: list[tuple[ET.Element, StreetStretch, StreetStretch]]
    ) -> StretchGraph:
        graph = copy(self)
        graph.names, graph.connections = names, rows
        return graph
