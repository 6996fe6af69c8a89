"""Write streets beyond the rim of a map as netconvert's plain XML."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

from advdiff_sumo.maps.convert.osm.cut_streets import StreetStretch, StretchGraph
from advdiff_sumo.maps.convert.osm.import_streets import StreetNet
from advdiff_sumo.maps.convert.polyline import shape_text
from advdiff_sumo.maps.read_net import BEYOND_TYPE

KEPT = ("priority", "numLanes", "speed", "width", "allow", "disallow")  # attributes that streets keep
LANE_KEPT = ("index", "speed", "width", "allow", "disallow")  # attributes that their lanes keep


@dataclass(frozen=True, eq=False)
class StreetRows:
    """Rows of nodes, edges (including roundabouts) and connections."""

    nodes: tuple[ET.Element, ...] = ()
    edges: tuple[ET.Element, ...] = ()
    connections: tuple[ET.Element, ...] = ()


NO_ROWS = StreetRows()


def street_rows(
    net: StreetNet,
    stretches: Sequence[StreetStretch],
    graph: StretchGraph,
    joints: Mapping[tuple[str, bool], str],
) -> StreetRows:
    """Return the rows of *stretches* of *net* and of the connections between them in *graph*.

    *joints* are the junctions that join a stretch to the map, by stretch id and whether at its beginning.
    """
    ends = {
        stretch.id: (
            joints.get((stretch.id, True), stretch.street.origin),
            joints.get((stretch.id, False), stretch.street.target),
        )
        for stretch in stretches
    }
    used = dict.fromkeys(name for pair in ends.values() for name in pair)
    return StreetRows(
        tuple(net.nodes[name] for name in used if name in net.nodes),
        (*(_edge(stretch, *ends[stretch.id]) for stretch in stretches), *_roundabouts(net, ends)),
        tuple(_connections(graph)),
    )


def _edge(stretch: StreetStretch, origin: str, target: str) -> ET.Element:
    source_row = stretch.street.row
    row = ET.Element("edge", {"id": stretch.id, "from": origin, "to": target, "type": BEYOND_TYPE})
    for key in KEPT:
        if key in source_row.attrib:
            row.set(key, source_row.attrib[key])
    row.set("spreadType", "center")
    row.set("shape", shape_text(stretch.middle_m))
    for lane in source_row.iterfind("lane"):
        ET.SubElement(row, "lane", {key: lane.attrib[key] for key in LANE_KEPT if key in lane.attrib})
    return row


def _roundabouts(net: StreetNet, ends: Mapping[str, tuple[str, str]]) -> Iterator[ET.Element]:
    """Yield the roundabouts of which no edge was cut."""
    for row in net.roundabouts:
        if all(name in ends for name in row.get("edges", "").split()):
            yield row


def _connections(graph: StretchGraph) -> Iterator[ET.Element]:
    """Yield the connections between streets.

    A lane without connections, because its targets were cut away, gets those of the nearest lane with connections.
    """
    targets: dict[str, dict[int, list[ET.Element]]] = defaultdict(lambda: defaultdict(list))
    lanes: dict[str, int] = {}
    for row, origin, target in graph.connections:
        renamed = ET.Element("connection", row.attrib | {"from": origin.id, "to": target.id})
        targets[origin.id][int(row.attrib["fromLane"])].append(renamed)
        lanes[origin.id] = len(origin.street.for_cars)
    for name, by_lane in targets.items():
        for lane in range(lanes[name]):
            nearest = min(by_lane, key=lambda other: (abs(other - lane), other))
            for row in by_lane[nearest]:
                yield ET.Element("connection", row.attrib | {"fromLane": str(lane)})
