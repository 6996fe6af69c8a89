"""Adds the elements of crossings, walking areas and sidewalks to the XML tree of a SUMO net."""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ET
from collections import Counter, defaultdict
from collections.abc import Sequence

import numpy as np
import shapely
from shapely.geometry import LineString, Polygon
from shapely.ops import substring

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.on_foot.carriageway import Carriageway, Strip
from advdiff_sumo.maps.on_foot.crossing_lines import CrossingLine
from advdiff_sumo.maps.on_foot.kerbs import SIDEWALK_M, Sidewalk, WalkingArea, outline
from advdiff_sumo.maps.on_foot.signal_phases import SignalledCrossing, add_crossings
from advdiff_sumo.maps.read_net import shape_of
from advdiff_sumo.maps.signal_times import clearance_s

_REPEAT_M = 0.05  # nearer points are one point once they are written
_WALK_SPEED = "2.78"  # m/s, netconvert's speed limit of sidewalks


def lanes_of(junction: ET.Element) -> list[str]:
    """Return the ids of the internal lanes of *junction*, one for each row of its right-of-way matrix."""
    return junction.get("intLanes", "").split()


class NetWriter:
    """Adds crossings, walking areas and sidewalks to a net.

    New elements are collected in lists and inserted into the net at the end.
    """

    def __init__(
        self,
        root: ET.Element,
        road: Carriageway,
        crossings: Sequence[CrossingLine],
        areas: Sequence[WalkingArea],
        sidewalks: Sequence[Sidewalk],
    ) -> None:
        self.root, self.road = root, road
        self.crossings, self.areas, self.sidewalks = crossings, areas, sidewalks
        self.junctions = {j.get("id", ""): j for j in root.iterfind("junction")}
        self.lanes = {lane.get("id", ""): lane for lane in root.iterfind("edge/lane")}
        self.light_ids = self._light_ids()
        self.area_of_end = {end: number for number, area in enumerate(areas) for end in area.ends}
        self.inner_edges: list[ET.Element] = []
        self.edges: list[ET.Element] = []
        self.nodes: list[ET.Element] = []
        self.connections: list[ET.Element] = []
        self.sidewalk_starts: dict[str, list[FloatArray]] = defaultdict(list)

    def write(self) -> None:
        """Add everything to the net."""
        by_junction: dict[str, list[int]] = defaultdict(list)
        for number, crossing in enumerate(self.crossings):
            by_junction[crossing.junction].append(number)
        self.area_ids = self._area_ids()
        for junction in sorted(by_junction):
            self._add_crossings(junction, by_junction[junction])
        for number, sidewalk in enumerate(self.sidewalks):
            self._add_sidewalk(number, sidewalk)
        for number, area in enumerate(self.areas):
            shape = outline(area, self.crossings, self.sidewalk_starts[self.area_ids[number]])
            self._add_walking_area(self.area_ids[number], shape)
        self._insert()

    def _area_ids(self) -> list[str]:
        count: Counter[str] = Counter()
        names = []
        for area in self.areas:
            names.append(f":{area.junction}_w{count[area.junction]}")
            count[area.junction] += 1
        return names

    def _add_crossings(self, name: str, numbers: list[int]) -> None:
        """Add the crossings *numbers* of the junction *name*, with right-of-way rows and traffic light phases."""
        numbers = sorted(numbers, key=lambda n: (self.area_of_end[n, 0], n))
        junction = self.junctions[name]
        requests = junction.findall("request")
        first, size = len(requests), len(requests) + len(numbers)
        signalled = []
        light_id = self.light_ids.get(name, "")
        programs = [p for p in self.root.iterfind("tlLogic") if p.get("id") == light_id]
        link_count = self._link_count(programs)
        for k, number in enumerate(numbers):
            crossing = self.crossings[number]
            foes = {strip.request for strip in crossing.strips}
            for foe in foes:
                self._set_yielding(requests[foe], first + k, size)
            bits = "".join("1" if n in foes else "0" for n in reversed(range(size)))
            ET.SubElement(junction, "request", index=str(first + k), response="0" * size, foes=bits, cont="0")
            connection = self._add_crossing(name, k, number)
            if programs:
                connection.set("tl", light_id)
                connection.set("linkIndex", str(link_count + k))
                signalled.append(self._signalled(name, crossing, link_count + k))
        for request in requests:
            request.set("response", request.get("response", "").rjust(size, "0"))
            request.set("foes", request.get("foes", "").rjust(size, "0"))
        starts = dict.fromkeys(self.area_ids[self.area_of_end[n, 0]] for n in numbers)
        junction.set("incLanes", " ".join((junction.get("incLanes", ""), *(f"{w}_0" for w in starts))))
        lanes = [f":{name}_c{k}_0" for k in range(len(numbers))]
        junction.set("intLanes", " ".join((*lanes_of(junction), *lanes)))
        self._extend_waiting_positions(numbers, lanes)
        for program in programs:
            add_crossings(program, signalled, self._highest_limit_mps(light_id))

    def _light_ids(self) -> dict[str, str]:
        """Return junction → id of the traffic light that controls it; of several, the first by name."""
        light_ids: dict[str, str] = {}
        for (junction, _), connection in self.road.links.items():
            light_id = connection.get("tl")
            if light_id:
                light_ids[junction] = min(light_id, light_ids.get(junction, light_id))
        return light_ids

    def _link_count(self, programs: Sequence[ET.Element]) -> int:
        states = [phase.get("state", "") for program in programs for phase in program.iterfind("phase")]
        return max(map(len, states), default=0)

    def _signalled(self, junction: str, crossing: CrossingLine, index: int) -> SignalledCrossing:
        links: dict[bool, set[int]] = {True: set(), False: set()}
        for strip in crossing.strips:
            link_index = self.road.links[junction, strip.request].get("linkIndex")
            if link_index is not None:
                links[strip.is_straight].add(int(link_index))
        straight, turning = frozenset(links[True]), frozenset(links[False])
        all_red_s = max(self._clearance_s(strip, crossing) for strip in crossing.strips)
        return SignalledCrossing(index, straight, turning, crossing.length_m, all_red_s)

    def _highest_limit_mps(self, light_id: str) -> float:
        """Return the highest speed limit of the lanes before a traffic light."""
        links = [link for link in self.road.links.values() if link.get("tl") == light_id]
        return max((float(self._approach(link).get("speed", "0")) for link in links), default=0.0)

    def _approach(self, link: ET.Element) -> ET.Element:
        """Return the lane from which *link* leads."""
        return self.lanes[f"{link.get('from')}_{link.get('fromLane')}"]

    def _clearance_s(self, strip: Strip, crossing: CrossingLine) -> float:
        """Return the time that a vehicle on *strip* needs from its stop line until its rear has passed *crossing*."""
        link = self.road.links[strip.junction, strip.request]
        lane, parts = self._approach(link), self.road.parts(link)
        before_m = sum(line_length_m(shape_of(self.lanes[part])) for part in parts[: parts.index(strip.lane)])
        stop = lane.find("stopOffset")
        offset_m = 0.0 if stop is None else float(stop.get("value", "0"))
        far_side_m = (
            strip.line.project(strip.line.intersection(crossing.line).centroid) + 0.5 * crossing.width_m
        )
        speed_mps = float(lane.get("speed", "0")) if strip.is_straight else strip.speed_mps
        return clearance_s(offset_m + before_m + far_side_m, speed_mps)

    def _set_yielding(self, request: ET.Element, index: int, size: int) -> None:
        """Make the link of *request* yield to the crossing with request *index*, in a matrix of *size* rows."""
        for key in ("response", "foes"):
            bits = list(request.get(key, "").rjust(size, "0"))
            bits[size - 1 - index] = "1"
            request.set(key, "".join(bits))

    def _extend_waiting_positions(self, numbers: Sequence[int], lanes: Sequence[str]) -> None:
        """Make vehicles that wait inside the junction yield to the crossings (*numbers*, *lanes*) beyond."""
        for number, lane in zip(numbers, lanes, strict=True):
            for strip in self.crossings[number].strips:
                waiting_position = self.junctions.get(strip.lane)
                if waiting_position is not None:
                    waiting_position.set("intLanes", " ".join((*lanes_of(waiting_position), lane)))

    def _add_crossing(self, junction: str, k: int, number: int) -> ET.Element:
        """Add crossing *number* as the *k*-th of its junction; return the connection that leads to it."""
        crossing = self.crossings[number]
        name = f":{junction}_c{k}"
        links = [self.road.links[junction, strip.request] for strip in crossing.strips]
        edges = sorted({link.get(key, "") for link in links for key in ("from", "to")})
        edge = ET.Element("edge", id=name, function="crossing", crossingEdges=" ".join(edges))
        self._add_lane(edge, crossing.ends_m, crossing.width_m)
        self.inner_edges.append(edge)
        from_area, to_area = (self.area_ids[self.area_of_end[number, side]] for side in (0, 1))
        connection = self._connect(from_area, name)
        self._connect(name, to_area)
        for link in links:
            if link.get("state") == "M":
                link.set("state", "m")
        return connection

    def _add_lane(self, edge: ET.Element, line: FloatArray, width_m: float) -> None:
        line = _without_repeats(line)
        length = line_length_m(line)
        ET.SubElement(
            edge,
            "lane",
            id=f"{edge.get('id')}_0",
            index="0",
            allow="pedestrian",
            speed=_WALK_SPEED,
            length=f"{length:.2f}",
            width=f"{width_m:.2f}",
            shape=_shape(line),
        )

    def _connect(self, origin: str, target: str) -> ET.Element:
        connection = ET.Element(
            "connection", {"from": origin, "to": target}, fromLane="0", toLane="0", dir="s", state="M"
        )
        self.connections.append(connection)
        return connection

    def _add_sidewalk(self, number: int, sidewalk: Sidewalk) -> None:
        """Add the edges of a sidewalk; nodes divide it, so that no two edges share both ends."""
        start = self.areas[sidewalk.origin].junction
        end = None if sidewalk.target is None else self.areas[sidewalk.target].junction
        node_count = 2 if end == start else 1 if end is not None else 0
        length = line_length_m(sidewalk.line_m)
        if end != start:
            node_count = min(node_count, int(length) // 2)
        line = LineString(sidewalk.line_m)
        cuts = np.linspace(0.0, length, node_count + 2)
        from_node, from_area = start, self.area_ids[sidewalk.origin]
        for k, (start_s, end_s) in enumerate(itertools.pairwise(cuts)):
            part = np.asarray(substring(line, start_s, end_s).coords)
            is_last = k == node_count
            if is_last and end is not None and sidewalk.target is not None:
                to_node, to_area = end, self.area_ids[sidewalk.target]
            else:
                to_node = f"foot{number}_{k}"
                to_area = self._add_node(to_node, part[-1])
            self._add_edge(f"walk{number}_{k}", (from_node, to_node), part, (from_area, to_area))
            from_node, from_area = to_node, to_area

    def _add_node(self, name: str, xy_m: FloatArray) -> str:
        """Add a node with a square walking area at *xy_m*; return the id of the area."""
        x, y = xy_m
        half = 0.5 * SIDEWALK_M
        shape = np.array(
            [[x - half, y - half], [x - half, y + half], [x + half, y + half], [x + half, y - half]]
        )
        node = ET.Element("junction", id=name, type="dead_end", x=f"{x:.2f}", y=f"{y:.2f}", intLanes="")
        node.set("incLanes", "")
        node.set("shape", _shape(shape))
        self.nodes.append(node)
        self._add_walking_area(f":{name}_w0", Polygon(shape))
        return f":{name}_w0"

    def _add_edge(self, name: str, nodes: tuple[str, str], line: FloatArray, areas: tuple[str, str]) -> None:
        """Add a sidewalk edge from one node and walking area to another."""
        edge = ET.Element("edge", {"id": name, "from": nodes[0], "to": nodes[1], "priority": "-1"})
        self._add_lane(edge, line, SIDEWALK_M)
        self.edges.append(edge)
        self._connect(areas[0], name)
        self._connect(name, areas[1])
        self.sidewalk_starts[areas[0]].append(line[:2])
        self.sidewalk_starts[areas[1]].append(line[::-1][:2])

    def _add_walking_area(self, name: str, shape: Polygon) -> None:
        edge = ET.Element("edge", id=name, function="walkingarea")
        ring = np.asarray(shapely.orient_polygons(shape).exterior.coords)[:-1]
        self._add_lane(edge, ring, SIDEWALK_M)
        self.inner_edges.append(edge)

    def _insert(self) -> None:
        """Insert the new elements into the net.

        Crossings and walking areas come before its normal edges, sidewalks after its edges, nodes after its junctions,
        and connections at the end.
        """
        elements = list(self.root)
        edges = [n for n, element in enumerate(elements) if element.tag == "edge"]
        normal_edges = [n for n in edges if not elements[n].get("function")]
        inner_at, edges_at = (normal_edges or edges)[0], edges[-1] + 1
        junctions = [n for n, e in enumerate(elements) if e.tag == "junction" and e.get("type") != "internal"]
        nodes_at = junctions[-1] + 1
        elements[nodes_at:nodes_at] = self.nodes
        elements[edges_at:edges_at] = self.edges
        elements[inner_at:inner_at] = self.inner_edges
        self.root[:] = [*elements, *self.connections]


def _shape(line: FloatArray) -> str:
    return " ".join(f"{x:.2f},{y:.2f}" for x, y in line)


def _without_repeats(line: FloatArray) -> FloatArray:
    """Return *line* (P, 2) without points that coincide once written; on them SUMO's walkers get NaN positions."""
    keep = np.concatenate(([True], np.hypot(*np.diff(line, axis=0).T) > _REPEAT_M))
    if keep.sum() == 1:
        return line[[0, -1]]
    if not keep[-1]:  # keep the end point instead of the one before it
        keep[np.flatnonzero(keep)[-1]], keep[-1] = keep.sum() == 1, True
    return np.asarray(line[keep])
