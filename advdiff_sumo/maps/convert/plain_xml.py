"""Write a net plan as netconvert's plain XML."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from advdiff_sumo.maps.convert.lane_routes import CHANGE_M
from advdiff_sumo.maps.convert.netplan import ConnectionPlan, EdgePlan, Ends, JunctionPlan, NetPlan, Ring
from advdiff_sumo.maps.convert.osm.street_xml import NO_ROWS, StreetRows
from advdiff_sumo.maps.convert.polyline import shape_text
from advdiff_sumo.maps.convert.rim import ReturnEdge, return_connections, return_rows
from advdiff_sumo.maps.convert.sources.source_map import LaneUse

NOBODY = "custom2"  # a vehicle class without vehicles; lane changes allowed to it alone are forbidden
ALLOWED = {  # vehicle classes by use of a lane; "": SUMO's default
    LaneUse.CAR: "",
    LaneUse.BUS: "bus coach taxi emergency",
    LaneUse.BICYCLE: "bicycle",
}


def write_plain_xml(
    plan: NetPlan,
    folder: Path,
    location: str,
    projection: str | None,
    prohibitions: Iterable[tuple[Ends, Ends]] = (),
    returns: Sequence[ReturnEdge] = (),
    streets: StreetRows = NO_ROWS,
) -> dict[str, Path]:
    """Write node, edge and connection files into *folder*; return them by netconvert's option name.

    Args:
        plan: the planned net.
        folder: where the files are written.
        location: name of the place.
        projection: PROJ string of the net's frame, if known. It goes into the element ``location``, because with
            netconvert's option ``--proj`` the coordinates would be read as degrees.
        prohibitions: pairs of connections of which the second yields to the first.
        returns: return edges beyond the rim of the map.
        streets: streets beyond the rim of the map.
    """
    joined_to_return = {name for edge in returns for name in (edge.origin.target, edge.target.origin)}
    junctions = [
        replace(j, kind="priority") if j.id in joined_to_return and j.kind == "dead_end" else j
        for j in plan.junctions
    ]
    nodes = [*([_location(plan, projection)] if projection else []), *map(_node, junctions), *streets.nodes]
    return {
        "node-files": _file(folder / "plain.nod.xml", "nodes", nodes),
        "edge-files": _file(
            folder / "plain.edg.xml",
            "edges",
            [
                *(_edge(e, location) for e in plan.edges),
                *return_rows(returns),
                *streets.edges,
                *map(_roundabout, plan.rings),
            ],
        ),
        "connection-files": _file(
            folder / "plain.con.xml",
            "connections",
            (*_connections(plan, prohibitions, returns), *streets.connections),
        ),
    }


def _file(path: Path, root: str, elements: Iterable[ET.Element]) -> Path:
    tree = ET.Element(root)
    tree.extend(elements)
    ET.indent(tree)
    ET.ElementTree(tree).write(path, encoding="utf-8", xml_declaration=True)
    return path


def _location(plan: NetPlan, projection: str) -> ET.Element:
    xy = np.array([junction.xy_m for junction in plan.junctions])
    bounds = ",".join(f"{v:.2f}" for v in (*xy.min(axis=0), *xy.max(axis=0)))
    return ET.Element(
        "location", netOffset="0.00,0.00", convBoundary=bounds, origBoundary=bounds, projParameter=projection
    )


def _node(junction: JunctionPlan) -> ET.Element:
    x, y = junction.xy_m
    return ET.Element(
        "node",
        id=junction.id,
        x=f"{x:.4f}",
        y=f"{y:.4f}",
        type=junction.kind,
        shape=shape_text(np.asarray(junction.shape.exterior.coords)[:-1]),
    )


def _edge(edge: EdgePlan, location: str) -> ET.Element:
    middle = edge.lanes[len(edge.lanes) // 2]
    element = ET.Element(
        "edge",
        {"id": edge.id, "from": edge.origin, "to": edge.target, "priority": str(edge.priority)},
        numLanes=str(len(edge.lanes)),
        speed=f"{max(lane.speed_mps for lane in edge.lanes):.2f}",
        length=f"{edge.length_m:.3f}",
        spreadType="center",
        shape=shape_text(middle.shape_m),
    )
    for index, lane in enumerate(edge.lanes):
        row = ET.SubElement(
            element, "lane", index=str(index), speed=f"{lane.speed_mps:.2f}", width=f"{lane.width_m:.2f}"
        )
        row.set("shape", shape_text(lane.shape_m))
        if ALLOWED[lane.use]:
            row.set("allow", ALLOWED[lane.use])
        for side, solid in (("changeLeft", lane.no_change_up), ("changeRight", lane.no_change_down)):
            if solid or edge.length_m < CHANGE_M:  # "left" means the higher index, also in left-hand traffic
                row.set(side, NOBODY)
        if lane.stop_offset_m > 0.0:
            ET.SubElement(row, "stopOffset", value=f"{lane.stop_offset_m:.2f}")
        _param(row, "source", lane.source)
        if len(lane.widths):
            _param(row, "widths", " ".join(f"{s:.1f}:{width:.2f}" for s, width in lane.widths))
    _param(element, "location", location)
    return element


def _roundabout(ring: Ring) -> ET.Element:
    return ET.Element("roundabout", nodes=" ".join(ring.junctions), edges=" ".join(ring.edges))


def _connections(
    plan: NetPlan, prohibitions: Iterable[tuple[Ends, Ends]], returns: Sequence[ReturnEdge]
) -> Iterable[ET.Element]:
    for connection in plan.connections:
        yield _connection(connection)
    for first, second in prohibitions:
        yield ET.Element("prohibition", prohibitor="->".join(first), prohibited="->".join(second))
    yield from return_connections(returns)
    continued = {connection.origin[0] for connection in plan.connections} | {e.origin.id for e in returns}
    for edge in plan.edges:
        if edge.id not in continued:  # prevents that netconvert adds connections of its own
            yield ET.Element("connection", {"from": edge.id})


def _connection(connection: ConnectionPlan) -> ET.Element:
    element = ET.Element("connection", {"from": connection.origin[0], "to": connection.target[0]})
    element.set("fromLane", str(connection.origin[1]))
    element.set("toLane", str(connection.target[1]))
    element.set("shape", shape_text(connection.shape_m))
    element.set("contPos", "0")  # yielding vehicles wait before the junction, not inside it
    for side in ("changeLeft", "changeRight"):  # connections of two lanes may come close inside a junction
        element.set(side, NOBODY)
    if connection.passes:
        element.set("pass", "true")
    if np.isfinite(connection.speed_mps):
        element.set("speed", f"{connection.speed_mps:.2f}")
    return element


def _param(parent: ET.Element, key: str, value: str) -> None:
    ET.SubElement(parent, "param", key=key, value=value)
