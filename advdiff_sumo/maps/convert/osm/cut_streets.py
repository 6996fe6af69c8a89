"""Cut away the parts of streets that lie on the HD map, and find those on routes from its rim back to it."""

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
from advdiff_sumo.maps.convert.osm.import_streets import Street, StreetNet, offset_left
from advdiff_sumo.maps.convert.routability import reachable

MARGIN_M = 0.5  # distance between a street and the HD map
SHORTEST_M = 2.0  # shortest part of a street that is kept
STUB_M = 5.0  # a part with less length outside junctions has no room for a joint
NOTHING_M = 1e-6  # tolerance at the ends of a street
HEADING_M = 5.0  # length over which the heading at an end is measured


@dataclass(frozen=True, eq=False)
class StreetStretch:
    """The part of a street between two arc lengths on its middle line.

    Attributes:
        id: name of the edge that it becomes.
        street: the street.
        from_m: arc length at which it begins.
        to_m: arc length at which it ends.
        begins_open: whether an HD lane may lead into it: it was cut there, or no other street leads into it.
        ends_open: whether it may lead into an HD lane, likewise.
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
        """Return the stretch shortened by *by_m* at one end."""
        if at_start:
            return replace(self, from_m=self.from_m + by_m)
        return replace(self, to_m=self.to_m - by_m)

    def lane_lines(self, lefthand: bool) -> list[FloatArray]:
        """Return the centre line (N, 2) of each lane; lane 0 is the outermost."""
        return [offset_left(self.middle_m, left) for left in self.street.lane_offsets_m(lefthand)]

    @cached_property
    def directions(self) -> tuple[FloatArray, FloatArray]:
        """Unit vectors (2,) along the first and the last ``HEADING_M``."""
        reach = min(HEADING_M, self.length_m)
        begin, after, before, end = polyline.at(
            self.middle_m, np.array([0.0, reach, self.length_m - reach, self.length_m])
        )
        return polyline.direction(begin, after), polyline.direction(before, end)


def stretches_outside(net: StreetNet, area: BaseGeometry) -> list[StreetStretch]:
    """Return the parts of the streets of *net* that lie outside *area*, the area of the HD map."""
    widened: dict[float, BaseGeometry] = {}
    stretches: list[StreetStretch] = []
    for street in net.streets.values():
        half_m = round(0.5 * street.width_m + MARGIN_M, 2)
        if half_m not in widened:
            widened[half_m] = area.buffer(half_m)
            shapely.prepare(widened[half_m])
        stretches += _outside_parts(street, net, widened[half_m])
    return _without_stubs(stretches, net)


def _without_stubs(stretches: Sequence[StreetStretch], net: StreetNet) -> list[StreetStretch]:
    """Return *stretches* without stubs; the next street becomes open for a joint instead.

    A stub is the rest of a street between the map and the next street, too short for a joint. It occurs where a street
    changes its number of lanes just beyond the map.
    """
    stubs = [s for s in stretches if s.has_start is not s.has_end and s.clear_m < STUB_M]
    exit_stubs = {
        (s.street.target, s.street.origin): s
        for s in stubs
        if s.has_end and _continues_once(net, s.street.target)
    }
    entry_stubs = {
        (s.street.origin, s.street.target): s
        for s in stubs
        if s.has_start and _continues_once(net, s.street.origin)
    }
    left_out = {stub.id for stub in (*exit_stubs.values(), *entry_stubs.values())}
    return [
        replace(
            stretch,
            begins_open=stretch.begins_open
            or (stretch.has_start and _has_stub_beyond(exit_stubs, stretch.street, 0)),
            ends_open=stretch.ends_open
            or (stretch.has_end and _has_stub_beyond(entry_stubs, stretch.street, 1)),
        )
        for stretch in stretches
        if stretch.id not in left_out
    ]


def _continues_once(net: StreetNet, node: str) -> bool:
    """Return whether *node* joins just two streets (or pairs of opposite ones)."""
    return len(net.neighbours[node]) == 2


def _has_stub_beyond(stubs: Collection[tuple[str, str]], street: Street, end: int) -> bool:
    """Return whether one of *stubs* lies beyond the beginning (*end* 0) or end (1) of *street*.

    *stubs* are pairs of the node at the end of the stub away from the map, and the node at its other end.
    """
    node, opposite = (street.origin, street.target) if end == 0 else (street.target, street.origin)
    return any(stub_node == node and map_node != opposite for stub_node, map_node in stubs)


def _outside_parts(street: Street, net: StreetNet, area: BaseGeometry) -> Iterator[StreetStretch]:
    """Yield the parts of *street* outside *area*."""
    line = LineString(street.middle_m)
    length_m = line_length_m(street.middle_m)
    parts = shapely.get_parts(line.difference(area)).tolist() if area.intersects(line) else [line]
    for number, (first, last) in enumerate(sorted(_span(part, line) for part in parts)):
        has_start, has_end = first < NOTHING_M, last > length_m - NOTHING_M
        if not (has_start and has_end) and last - first < SHORTEST_M:
            continue
        yield StreetStretch(
            street.id if has_start and has_end else f"{street.id}.{number}",
            street,
            0.0 if has_start else first,
            length_m if has_end else last,
            not has_start or net.is_dead_end(street.origin),
            not has_end or net.is_dead_end(street.target),
        )


def _span(part: LineString, line: LineString) -> tuple[float, float]:
    """Return first and last arc length of *part* on *line*, from its middle (the ends of a loop coincide)."""
    middle = line.project(part.interpolate(0.5, normalized=True))
    return middle - 0.5 * part.length, middle + 0.5 * part.length


class StretchGraph:
    """Graph of stretches that follow each other.

    Attributes:
        names: ids of the stretches.
        connections: rows of connections, each with the stretches from and to which it leads.
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
        """Return the stretches on routes from *entered* stretches (from the map) to *left* stretches (to the map)."""
        onward: dict[str, set[str]] = defaultdict(set)
        backward: dict[str, set[str]] = defaultdict(set)
        for _, a, b in self.connections:
            onward[a.id].add(b.id)
            backward[b.id].add(a.id)
        return reachable(entered, onward) & reachable(left, backward)

    def separated(self, entered: Collection[str], left: Collection[str]) -> StretchGraph:
        """Return the graph without connections into *entered* and out of *left* stretches, which the map replaces."""
        return self._with(
            self.names,
            [(row, a, b) for row, a, b in self.connections if b.id not in entered and a.id not in left],
        )

    def only(self, kept: Collection[str]) -> StretchGraph:
        """Return the graph of the *kept* stretches alone."""
        rows = [(row, a, b) for row, a, b in self.connections if a.id in kept and b.id in kept]
        return self._with(set(kept), rows)

    def _with(
        self, names: set[str], rows: list[tuple[ET.Element, StreetStretch, StreetStretch]]
    ) -> StretchGraph:
        graph = copy(self)
        graph.names, graph.connections = names, rows
        return graph
