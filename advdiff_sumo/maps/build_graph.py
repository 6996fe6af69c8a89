"""Builds lanes, links, edges and junctions from the XML elements of a net file."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from sumolib.net.lane import SUMO_VEHICLE_CLASSES

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import NetError
from advdiff_sumo.core.polylines import Polyline, without_repeats
from advdiff_sumo.maps.lanes import Edge, Junction, Lane, Link, edge_of_lane
from advdiff_sumo.maps.read_net import RawNet, leaving_lanes, marked_requests, shape_of

DEFAULT_LANE_WIDTH_M = 3.2
"""SUMO's lane width where the net states none (SUMO_const_laneWidth)."""

_STUB_M = 0.01  # length given to a lane that is drawn as a single point
_SIDE_MARGIN_M = 0.3  # smallest lateral offset that shows on which side of another lane a lane lies


@dataclass(frozen=True)
class LaneGraph:
    """The lanes, edges, junctions and links of a net.

    Attributes:
        lanes: lane id → lane, internal ones included.
        edges: edge id → edge, internal ones included.
        junctions: junction id → junction.
        links: (from lane, to lane) → link; neither lane is internal.
    """

    lanes: Mapping[str, Lane]
    edges: Mapping[str, Edge]
    junctions: Mapping[str, Junction]
    links: Mapping[tuple[str, str], Link]


def build_graph(raw: RawNet) -> LaneGraph:
    """Return the lane graph of *raw*.

    Raises:
        NetError: an element lacks an attribute or has a malformed value, or no lane is open to motor vehicles.
    """
    try:
        junctions = {name: _junction(element) for name, element in raw.junctions.items()}
        successors = _links(raw, junctions)
        edge_lanes = {
            name: _lanes_of(name, element, raw.lefthand, successors) for name, element in raw.edges.items()
        }
    except (KeyError, ValueError, IndexError) as error:
        problem = f"holds an element with a missing or malformed value ({error})"
        raise NetError(raw.path, problem, "write it anew with netconvert") from None
    lanes = {lane.id: lane for own_lanes in edge_lanes.values() for lane in own_lanes}
    _refuse_unusable(raw, lanes)
    lanes = _with_directions(lanes)
    edges = {
        name: _edge(name, raw.edges[name], [lanes[x.id] for x in edge_lanes[name]]) for name in edge_lanes
    }
    links = {
        (link.from_lane, link.to_lane): link
        for lane in lanes.values()
        if not lane.is_internal
        for link in lane.successors
    }
    return LaneGraph(lanes, edges, junctions, links)


def _refuse_unusable(raw: RawNet, lanes: Mapping[str, Lane]) -> None:
    if not any(lane.is_drivable and not lane.is_internal for lane in lanes.values()):
        raise NetError(raw.path, "has no lane that is open to motor vehicles", "give another net")
    for lane in lanes.values():
        for link in lane.successors:
            for name in (*link.via, link.to_lane):
                if name not in lanes:
                    problem = (
                        f"a connection from lane '{lane.id}' leads to '{name}', which is no lane of the net"
                    )
                    raise NetError(raw.path, problem, "write it anew with netconvert")


@lru_cache(maxsize=256)
def permissions(allow: str | None, disallow: str | None) -> frozenset[str]:
    """Return the vehicle classes that a lane's ``allow`` and ``disallow`` permit; all if both are absent."""
    if allow is not None and allow.strip() != "all":
        return frozenset(allow.split())
    if disallow is None:
        return frozenset(SUMO_VEHICLE_CLASSES)
    if disallow.strip() == "all":
        return frozenset()
    return frozenset(SUMO_VEHICLE_CLASSES) - frozenset(disallow.split())


def _junction(element: ET.Element) -> Junction:
    foes, response = {}, {}
    for request in element.iterfind("request"):
        index = int(request.attrib["index"])
        foes[index] = marked_requests(request.get("foes", ""))
        response[index] = marked_requests(request.get("response", ""))
    return Junction(
        id=element.attrib["id"],
        type=element.get("type", "unknown"),
        xy_m=np.array([float(element.attrib["x"]), float(element.attrib["y"])]),
        shape_xy_m=shape_of(element),
        foes=foes,
        response=response,
        incoming_lanes=tuple(element.get("incLanes", "").split()),
    )


def _lanes_of(
    edge_id: str, edge: ET.Element, lefthand: bool, successors: Mapping[str, Sequence[Link]]
) -> list[Lane]:
    """Return the lanes of an edge, ordered by index."""
    elements = sorted(edge.iterfind("lane"), key=lambda e: int(e.attrib["index"]))
    names = [element.attrib["id"] for element in elements]
    centres = [_centre(element) for element in elements]
    left: dict[str, str] = {}
    right: dict[str, str] = {}
    for i in range(len(names) - 1):
        is_left = _is_left_of(centres[i + 1], centres[i], lefthand)
        left_row, right_row = (i + 1, i) if is_left else (i, i + 1)
        left[names[right_row]], right[names[left_row]] = names[left_row], names[right_row]
    return [
        _lane(edge_id, element, centre, (left.get(name), right.get(name)), successors.get(name, ()))
        for name, element, centre in zip(names, elements, centres, strict=True)
    ]


def _is_left_of(upper: FloatArray, lower: FloatArray, lefthand: bool) -> bool:
    """Return whether the lane with the higher index (*upper*) lies left of the one with the lower index.

    The centre lines (P, 2) decide. If they are too close together, the side of the road that the net drives on does.
    """
    if len(upper) > 1 and len(lower) > 1:
        (x0, y0), (x1, y1), (x, y) = lower[0], lower[1], upper[0]
        ahead_x, ahead_y = x1 - x0, y1 - y0
        d = (ahead_x * (y - y0) - ahead_y * (x - x0)) / np.hypot(ahead_x, ahead_y)
        if abs(d) <= _SIDE_MARGIN_M:  # both start at the same point: compare them half-way
            upper_line = Polyline.of(upper)
            _, d = Polyline.of(lower).project(upper_line.at(0.5 * upper_line.length_m)[0])
        if abs(d) > _SIDE_MARGIN_M:
            return bool(d > 0.0)
    return not lefthand


def _centre(element: ET.Element) -> FloatArray:
    centre = shape_of(element)
    if len(centre) == 0 or not np.isfinite(centre).all():
        raise ValueError(f"lane {element.attrib['id']} has no shape")
    return without_repeats(centre)


def _lane(
    edge_id: str,
    element: ET.Element,
    centre: FloatArray,
    neighbours: tuple[str | None, str | None],
    successors: Sequence[Link],
) -> Lane:
    step = centre[1:] - centre[:-1]
    length = float(np.hypot(step[:, 0], step[:, 1]).sum())
    return Lane(
        id=element.attrib["id"],
        edge_id=edge_id,
        index=int(element.attrib["index"]),
        centre_xy_m=centre,
        width_m=float(element.get("width", DEFAULT_LANE_WIDTH_M)),
        speed_mps=float(element.attrib["speed"]),
        length_m=length,
        sumo_length_m=float(element.get("length", length)),
        is_internal=edge_id.startswith(":"),
        allows=permissions(element.get("allow"), element.get("disallow")),
        left_id=neighbours[0],
        right_id=neighbours[1],
        successors=tuple(successors),
    )


def _with_directions(lanes: Mapping[str, Lane]) -> dict[str, Lane]:
    """Give lanes that are drawn as a single point a length of 1 cm, in the direction of a lane that leads to them."""
    predecessors: dict[str, Lane] = {}
    for lane in lanes.values():
        for link in lane.successors:
            for successor in (*link.via, link.to_lane):
                predecessors.setdefault(successor, lane)
    fixed = dict(lanes)
    for lane in lanes.values():
        if len(lane.centre_xy_m) < 2:
            previous = predecessors.get(lane.id)
            has_direction = previous is not None and len(previous.centre_xy_m) > 1
            tangent = (
                previous.line.tangents[-1] if previous is not None and has_direction else np.array([1.0, 0.0])
            )
            centre = np.vstack((lane.centre_xy_m, lane.centre_xy_m + _STUB_M * tangent))
            fixed[lane.id] = replace(lane, centre_xy_m=centre, length_m=_STUB_M)
    return fixed


def _links(raw: RawNet, junctions: Mapping[str, Junction]) -> dict[str, list[Link]]:
    """Return the links from each lane. A link with two internal lanes is listed as two connections; they are joined."""
    outgoing = leaving_lanes(raw.connections)
    second_halves = {origin: first for origin, (first, *_) in outgoing.items() if origin.startswith(":")}
    request_numbers = _request_numbers(junctions, raw.counted)
    return {
        origin: [_link(origin, c, raw, second_halves, request_numbers) for c in connections]
        for origin, connections in outgoing.items()
    }


def _link(
    origin: str,
    connection: ET.Element,
    raw: RawNet,
    second_halves: Mapping[str, ET.Element],
    request_numbers: Mapping[int, int],
) -> Link:
    via: list[str] = []
    half: ET.Element | None = connection
    while half is not None and (internal := half.get("via")) and internal not in via:
        via.append(internal)
        half = second_halves.get(internal)
    edge = raw.edges[connection.attrib["from"]]
    tls_id, tls_index = connection.get("tl"), int(connection.get("linkIndex", "-1"))
    is_controlled = bool(tls_id) and tls_index >= 0  # −1: the traffic light does not control this connection
    return Link(
        from_lane=origin,
        to_lane=f"{connection.attrib['to']}_{connection.attrib['toLane']}",
        via=tuple(via),
        direction=connection.get("dir", "s"),
        tls_id=tls_id if is_controlled else None,
        tls_index=tls_index if is_controlled else None,
        state=connection.get("state", "M"),
        junction_id=edge.get("to") or junction_of_internal(origin),
        request_index=request_numbers.get(id(connection), -1),
    )


def _request_numbers(junctions: Mapping[str, Junction], counted: Iterable[ET.Element]) -> dict[int, int]:
    """Return ``id(connection element)`` → its request index.

    SUMO numbers the links of a junction lane by lane in the order of ``incLanes``. The connections of a lane are
    numbered in file order. Those over pedestrian crossings come last.
    """
    leaving = leaving_lanes(counted)
    numbers: dict[int, int] = {}
    for junction in junctions.values():
        rows = (connection for lane in junction.incoming_lanes for connection in leaving[lane])
        for number, connection in enumerate(rows):
            if number in junction.foes:
                numbers[id(connection)] = number
    return numbers


def junction_of_internal(lane_or_edge_id: str) -> str:
    """Return the id of the junction that an internal lane, such as ":J_0_0", lies on."""
    return lane_or_edge_id[1:].rsplit("_", 2)[0]


def _edge(name: str, element: ET.Element, lanes: Sequence[Lane]) -> Edge:
    is_internal = element.get("function") == "internal"
    junction = name[1:].rsplit("_", 1)[0] if is_internal else ""
    successor_ids = {edge_of_lane(link.to_lane): None for lane in lanes for link in lane.successors}
    return Edge(
        id=name,
        lane_ids=tuple(lane.id for lane in lanes),
        from_junction=element.get("from") or junction,
        to_junction=element.get("to") or junction,
        length_m=float(np.mean([lane.length_m for lane in lanes])),
        speed_mps=max(lane.speed_mps for lane in lanes),
        is_internal=is_internal,
        priority=int(element.get("priority", "-1")),
        successors=tuple(successor_ids),
    )
