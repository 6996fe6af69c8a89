"""Adds crossings, walking areas and sidewalks to the elements of a SUMO net."""

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

REPEAT_M = 0.05
WALK_SPEED = "2.78"  # m/s, netconvert's limit on sidewalks


def lanes_of(junction: ET.Element) -> list[str]:
    """Return the lanes inside *junction*, one a right-of-way row."""
    return junction.get("intLanes", "").split()


class NetWriter:
    """Adds the elements to a net."""

    def __init__(
        self,
        root: ET.Element,
        road: Carriageway,
        crossings: Sequence[CrossingLine],
        places: Sequence[WalkingArea],
        walks: Sequence[Sidewalk],
    ) -> None:
        self.root, self.road = root, road
        self.crossings, self.places, self.walks = crossings, places, walks
        self.junctions = {j.get("id", ""): j for j in root.iterfind("junction")}
        self.lanes = {lane.get("id", ""): lane for lane in root.iterfind("edge/lane")}
        self.lights = self._lights()
        self.place_of = {end: number for number, place in enumerate(places) for end in place.ends}
        self.inner: list[ET.Element] = []
        self.edges: list[ET.Element] = []
        self.nodes: list[ET.Element] = []
        self.connections: list[ET.Element] = []
        self.begins: dict[str, list[FloatArray]] = defaultdict(list)

    def write(self) -> None:
        """Add everything to the net."""
        by_junction: dict[str, list[int]] = defaultdict(list)
        for number, crossing in enumerate(self.crossings):
            by_junction[crossing.junction].append(number)
        self.area_names = self._area_names()
        for junction in sorted(by_junction):
            self._junction(junction, by_junction[junction])
        for number, walk in enumerate(self.walks):
            self._sidewalk(number, walk)
        for number, place in enumerate(self.places):
            shape = outline(place, self.crossings, self.begins[self.area_names[number]])
            self._walking_area(self.area_names[number], shape)
        self._insert()

    def _area_names(self) -> list[str]:
        count: Counter[str] = Counter()
        names = []
        for place in self.places:
            names.append(f":{place.junction}_w{count[place.junction]}")
            count[place.junction] += 1
        return names

    def _junction(self, name: str, numbers: list[int]) -> None:
        """Add the crossings of one junction, each with its row of right of way."""
        numbers = sorted(numbers, key=lambda n: (self.place_of[n, 0], n))
        junction = self.junctions[name]
        rows = junction.findall("request")
        first, size = len(rows), len(rows) + len(numbers)
        signalled = []
        light = self.lights.get(name, "")
        programs = [p for p in self.root.iterfind("tlLogic") if p.get("id") == light]
        links = self._light_size(programs)
        for k, number in enumerate(numbers):
            crossing = self.crossings[number]
            foes = {way.link for way in crossing.ways}
            for link in foes:
                self._yield(rows[link], first + k, size)
            bits = "".join("1" if n in foes else "0" for n in reversed(range(size)))
            ET.SubElement(junction, "request", index=str(first + k), response="0" * size, foes=bits, cont="0")
            row = self._crossing(name, k, number)
            if programs:
                row.set("tl", light)
                row.set("linkIndex", str(links + k))
                signalled.append(self._signalled(name, crossing, links + k))
        for row in rows:
            row.set("response", row.get("response", "").rjust(size, "0"))
            row.set("foes", row.get("foes", "").rjust(size, "0"))
        starts = dict.fromkeys(self.area_names[self.place_of[n, 0]] for n in numbers)
        junction.set("incLanes", " ".join((junction.get("incLanes", ""), *(f"{w}_0" for w in starts))))
        lanes = [f":{name}_c{k}_0" for k in range(len(numbers))]
        junction.set("intLanes", " ".join((*lanes_of(junction), *lanes)))
        self._waiting_places(numbers, lanes)
        for program in programs:
            add_crossings(program, signalled, self._fastest_mps(light))

    def _lights(self) -> dict[str, str]:
        """Return the signal that controls each junction, the first by name."""
        lights: dict[str, str] = {}
        for (junction, _), row in self.road.links.items():
            light = row.get("tl")
            if light:
                lights[junction] = min(light, lights.get(junction, light))
        return lights

    def _light_size(self, programs: Sequence[ET.Element]) -> int:
        states = [phase.get("state", "") for program in programs for phase in program.iterfind("phase")]
        return max(map(len, states), default=0)

    def _signalled(self, junction: str, crossing: CrossingLine, index: int) -> SignalledCrossing:
        links: dict[bool, set[int]] = {True: set(), False: set()}
        for way in crossing.ways:
            light = self.road.links[junction, way.link].get("linkIndex")
            if light is not None:
                links[way.straight].add(int(light))
        straight, turning = frozenset(links[True]), frozenset(links[False])
        clear_s = max(self._clear_s(way, crossing) for way in crossing.ways)
        return SignalledCrossing(index, straight, turning, crossing.length_m, clear_s)

    def _fastest_mps(self, light: str) -> float:
        """Return the highest speed limit before a signal in m/s."""
        rows = [row for row in self.road.links.values() if row.get("tl") == light]
        return max((float(self._approach(row).get("speed", "0")) for row in rows), default=0.0)

    def _approach(self, link: ET.Element) -> ET.Element:
        """Return the lane that *link* leaves."""
        return self.lanes[f"{link.get('from')}_{link.get('fromLane')}"]

    def _clear_s(self, way: Strip, crossing: CrossingLine) -> float:
        """Return the seconds from the stop line until the rear of a vehicle on *way* has passed *crossing*."""
        link = self.road.links[way.junction, way.link]
        lane, parts = self._approach(link), self.road.parts(link)
        before_m = sum(line_length_m(shape_of(self.lanes[part])) for part in parts[: parts.index(way.lane)])
        stop = lane.find("stopOffset")
        offset_m = 0.0 if stop is None else float(stop.get("value", "0"))
        at_m = way.line.project(way.line.intersection(crossing.line).centroid) + 0.5 * crossing.width_m
        speed_mps = float(lane.get("speed", "0")) if way.straight else way.speed_mps
        return clearance_s(offset_m + before_m + at_m, speed_mps)

    def _yield(self, row: ET.Element, index: int, size: int) -> None:
        """Let the link of *row* yield to crossing *index*."""
        for key in ("response", "foes"):
            bits = list(row.get(key, "").rjust(size, "0"))
            bits[size - 1 - index] = "1"
            row.set(key, "".join(bits))

    def _waiting_places(self, numbers: Sequence[int], lanes: Sequence[str]) -> None:
        """Let who waits inside the junction see the crossings behind the waiting place."""
        for number, lane in zip(numbers, lanes, strict=True):
            for way in self.crossings[number].ways:
                inside = self.junctions.get(way.lane)
                if inside is not None:
                    inside.set("intLanes", " ".join((*lanes_of(inside), lane)))

    def _crossing(self, junction: str, k: int, number: int) -> ET.Element:
        """Add crossing *number*, and return the connection that leads on to it."""
        crossing = self.crossings[number]
        name = f":{junction}_c{k}"
        over = [self.road.links[junction, way.link] for way in crossing.ways]
        edges = sorted({row.get(key, "") for row in over for key in ("from", "to")})
        edge = ET.Element("edge", id=name, function="crossing", crossingEdges=" ".join(edges))
        self._lane(edge, crossing.ends_m, crossing.width_m)
        self.inner.append(edge)
        before, after = (self.area_names[self.place_of[number, side]] for side in (0, 1))
        row = self._connect(before, name)
        self._connect(name, after)
        for way in crossing.ways:
            link = self.road.links[junction, way.link]
            if link.get("state") == "M":
                link.set("state", "m")
        return row

    def _lane(self, edge: ET.Element, line: FloatArray, width_m: float) -> None:
        line = _without_repeats(line)
        length = line_length_m(line)
        ET.SubElement(
            edge,
            "lane",
            id=f"{edge.get('id')}_0",
            index="0",
            allow="pedestrian",
            speed=WALK_SPEED,
            length=f"{length:.2f}",
            width=f"{width_m:.2f}",
            shape=_shape(line),
        )

    def _connect(self, origin: str, target: str) -> ET.Element:
        row = ET.Element(
            "connection", {"from": origin, "to": target}, fromLane="0", toLane="0", dir="s", state="M"
        )
        self.connections.append(row)
        return row

    def _sidewalk(self, number: int, walk: Sidewalk) -> None:
        """Add the edges of a sidewalk; nodes between let no two edges share both ends."""
        start = self.places[walk.origin].junction
        end = None if walk.target is None else self.places[walk.target].junction
        inside = 2 if end == start else 1 if end is not None else 0
        length = line_length_m(walk.line_m)
        if end != start:
            inside = min(inside, int(length) // 2)
        line = LineString(walk.line_m)
        cuts = np.linspace(0.0, length, inside + 2)
        before, area = start, self.area_names[walk.origin]
        for k, (low, high) in enumerate(itertools.pairwise(cuts)):
            part = np.asarray(substring(line, low, high).coords)
            last = k == inside
            if last and end is not None and walk.target is not None:
                node, following = end, self.area_names[walk.target]
            else:
                node = f"foot{number}_{k}"
                following = self._node(node, part[-1])
            self._walk_edge(f"walk{number}_{k}", before, node, part, area, following)
            before, area = node, following

    def _node(self, name: str, place: FloatArray) -> str:
        x, y = place
        half = 0.5 * SIDEWALK_M
        shape = np.array(
            [[x - half, y - half], [x - half, y + half], [x + half, y + half], [x + half, y - half]]
        )
        node = ET.Element("junction", id=name, type="dead_end", x=f"{x:.2f}", y=f"{y:.2f}", intLanes="")
        node.set("incLanes", "")
        node.set("shape", _shape(shape))
        self.nodes.append(node)
        self._walking_area(f":{name}_w0", Polygon(shape))
        return f":{name}_w0"

    def _walk_edge(
        self, name: str, origin: str, target: str, line: FloatArray, before: str, after: str
    ) -> None:
        edge = ET.Element("edge", {"id": name, "from": origin, "to": target, "priority": "-1"})
        self._lane(edge, line, SIDEWALK_M)
        self.edges.append(edge)
        self._connect(before, name)
        self._connect(name, after)
        self.begins[before].append(line[:2])
        self.begins[after].append(line[::-1][:2])

    def _walking_area(self, name: str, shape: Polygon) -> None:
        edge = ET.Element("edge", id=name, function="walkingarea")
        ring = np.asarray(shapely.orient_polygons(shape).exterior.coords)[:-1]
        self._lane(edge, ring, SIDEWALK_M)
        self.inner.append(edge)

    def _insert(self) -> None:
        """Put edges before and behind the net's own, nodes behind its junctions, connections at the end."""
        rows = list(self.root)
        roads = [n for n, row in enumerate(rows) if row.tag == "edge"]
        normal = [n for n in roads if not rows[n].get("function")]
        inner_at, edges_at = (normal or roads)[0], roads[-1] + 1
        nodes = [n for n, row in enumerate(rows) if row.tag == "junction" and row.get("type") != "internal"]
        nodes_at = nodes[-1] + 1
        rows[nodes_at:nodes_at] = self.nodes
        rows[edges_at:edges_at] = self.edges
        rows[inner_at:inner_at] = self.inner
        self.root[:] = [*rows, *self.connections]


def _shape(line: FloatArray) -> str:
    return " ".join(f"{x:.2f},{y:.2f}" for x, y in line)


def _without_repeats(line: FloatArray) -> FloatArray:
    """Return *line* without points that are one once written: on them SUMO's walkers get places that are no number."""
    keep = np.concatenate(([True], np.hypot(*np.diff(line, axis=0).T) > REPEAT_M))
    if keep.sum() == 1:
        return line[[0, -1]]
    if not keep[-1]:  # the end counts, the point before it does not
        keep[np.flatnonzero(keep)[-1]], keep[-1] = keep.sum() == 1, True
    return np.asarray(line[keep])
