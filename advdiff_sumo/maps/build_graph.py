"""Turns the elements of a net file into lanes, links, edges and junctions."""

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
from advdiff_sumo.maps.lanes import Edge, Junction, Lane, Link
from advdiff_sumo.maps.read_net import RawNet, leaving_lanes, marked_requests, shape_of

DEFAULT_LANE_WIDTH_M = 3.2
"""SUMO's width of a lane that states none (SUMO_const_laneWidth)."""

_STUB_M = 0.01
_SIDE_MARGIN_M = 0.3


@dataclass(frozen=True)
class LaneGraph:
    """Everything of a net that is not area.

    Attributes:
        lanes: by id, internal ones included.
        edges: by id, internal ones included.
        junctions: by id.
        links: by (from lane, to lane), neither of them internal.
    """

    lanes: Mapping[str, Lane]
    edges: Mapping[str, Edge]
    junctions: Mapping[str, Junction]
    links: Mapping[tuple[str, str], Link]


def build_graph(raw: RawNet) -> LaneGraph:
    """Return the lane graph of *raw*.

    Raises:
        NetError: an element lacks an attribute or holds a malformed value, or motor vehicles have no lane.
    """
    try:
        junctions = {name: _junction(element) for name, element in raw.junctions.items()}
        successors = _links(raw, junctions)
        groups = {
            name: _lanes_of(name, element, raw.lefthand, successors) for name, element in raw.edges.items()
        }
    except (KeyError, ValueError, IndexError) as error:
        problem = f"holds an element with a missing or malformed value ({error})"
        raise NetError(raw.path, problem, "write it anew with netconvert") from None
    lanes = {lane.id: lane for group in groups.values() for lane in group}
    _refuse_useless(raw, lanes)
    lanes = _with_directions(lanes)
    edges = {name: _edge(name, raw.edges[name], [lanes[x.id] for x in groups[name]]) for name in groups}
    links = {
        (link.from_lane, link.to_lane): link
        for lane in lanes.values()
        if not lane.is_internal
        for link in lane.successors
    }
    return LaneGraph(lanes, edges, junctions, links)


def _refuse_useless(raw: RawNet, lanes: Mapping[str, Lane]) -> None:
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
    """Return the vehicle classes that SUMO's ``allow`` and ``disallow`` leave; with neither, all."""
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
    """Return the edge's lanes by index."""
    elements = sorted(edge.iterfind("lane"), key=lambda e: int(e.attrib["index"]))
    names = [element.attrib["id"] for element in elements]
    centres = [_centre(element) for element in elements]
    left: dict[str, str] = {}
    right: dict[str, str] = {}
    for low in range(len(names) - 1):
        is_left = _is_left_of(centres[low + 1], centres[low], lefthand)
        on_left, on_right = (low + 1, low) if is_left else (low, low + 1)
        left[names[on_right]], right[names[on_left]] = names[on_left], names[on_right]
    return [
        _lane(edge_id, element, centre, (left.get(name), right.get(name)), successors.get(name, ()))
        for name, element, centre in zip(names, elements, centres, strict=True)
    ]


def _is_left_of(upper: FloatArray, lower: FloatArray, lefthand: bool) -> bool:
    """Return whether the lane of the higher index lies left of the other, by shape where that is clear."""
    if len(upper) > 1 and len(lower) > 1:
        (x0, y0), (x1, y1), (x, y) = lower[0], lower[1], upper[0]
        ahead_x, ahead_y = x1 - x0, y1 - y0
        d = (ahead_x * (y - y0) - ahead_y * (x - x0)) / np.hypot(ahead_x, ahead_y)
        if abs(d) <= _SIDE_MARGIN_M:  # they start together: look half-way
            other = Polyline.of(upper)
            _, d = Polyline.of(lower).project(other.at(0.5 * other.length_m)[0])
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
    beside: tuple[str | None, str | None],
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
        left_id=beside[0],
        right_id=beside[1],
        successors=tuple(successors),
    )


def _with_directions(lanes: Mapping[str, Lane]) -> dict[str, Lane]:
    """Give lanes that are drawn as one point a centimetre of length, along the lane that leads to them."""
    leading: dict[str, Lane] = {}
    for lane in lanes.values():
        for link in lane.successors:
            for follower in (*link.via, link.to_lane):
                leading.setdefault(follower, lane)
    fixed = dict(lanes)
    for lane in lanes.values():
        if len(lane.centre_xy_m) < 2:
            before = leading.get(lane.id)
            known = before is not None and len(before.centre_xy_m) > 1
            tangent = before.line.tangents[-1] if before is not None and known else np.array([1.0, 0.0])
            centre = np.vstack((lane.centre_xy_m, lane.centre_xy_m + _STUB_M * tangent))
            fixed[lane.id] = replace(lane, centre_xy_m=centre, length_m=_STUB_M)
    return fixed


def _links(raw: RawNet, junctions: Mapping[str, Junction]) -> dict[str, list[Link]]:
    """Return the links from each lane; those whose second half the net lists apart are joined."""
    outgoing = leaving_lanes(raw.connections)
    second = {origin: first for origin, (first, *_) in outgoing.items() if origin.startswith(":")}
    numbers = _request_numbers(junctions, raw.counted)
    return {
        origin: [_link(origin, c, raw, second, numbers) for c in connections]
        for origin, connections in outgoing.items()
    }


def _link(
    origin: str,
    connection: ET.Element,
    raw: RawNet,
    second: Mapping[str, ET.Element],
    numbers: Mapping[int, int],
) -> Link:
    via: list[str] = []
    step: ET.Element | None = connection
    while step is not None and (internal := step.get("via")) and internal not in via:
        via.append(internal)
        step = second.get(internal)
    edge = raw.edges[connection.attrib["from"]]
    light, index = connection.get("tl"), int(connection.get("linkIndex", "-1"))
    controlled = bool(light) and index >= 0  # −1: the light stands there and leaves this connection alone
    return Link(
        from_lane=origin,
        to_lane=f"{connection.attrib['to']}_{connection.attrib['toLane']}",
        via=tuple(via),
        direction=connection.get("dir", "s"),
        tls_id=light if controlled else None,
        tls_index=index if controlled else None,
        state=connection.get("state", "M"),
        junction_id=edge.get("to") or junction_of_internal(origin),
        request_index=numbers.get(id(connection), -1),
    )


def _request_numbers(junctions: Mapping[str, Junction], counted: Iterable[ET.Element]) -> dict[int, int]:
    """Return the request index of each connection element (by its identity).

    SUMO numbers the links of a junction lane by lane in the order of ``incLanes``, each lane's connections in
    file order; those over crossings come last.
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
    """Return the junction that an internal lane ":J_0_0" lies on."""
    return lane_or_edge_id[1:].rsplit("_", 2)[0]


def _edge(name: str, element: ET.Element, lanes: Sequence[Lane]) -> Edge:
    internal = element.get("function") == "internal"
    junction = name[1:].rsplit("_", 1)[0] if internal else ""
    onward = {link.to_lane.rsplit("_", 1)[0]: None for lane in lanes for link in lane.successors}
    return Edge(
        id=name,
        lane_ids=tuple(lane.id for lane in lanes),
        from_junction=element.get("from") or junction,
        to_junction=element.get("to") or junction,
        length_m=float(np.mean([lane.length_m for lane in lanes])),
        speed_mps=max(lane.speed_mps for lane in lanes),
        is_internal=internal,
        priority=int(element.get("priority", "-1")),
        successors=tuple(onward),
    )
