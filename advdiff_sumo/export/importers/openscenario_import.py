"""Reads the OpenSCENARIO files that are exported here; the standard library is enough for it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import TypeAlias
from xml.etree import ElementTree as ET

import numpy as np

from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.export.export_scene import ImportedScene
from advdiff_sumo.export.importers.assemble import AgentPart, assemble, reading, spacing_s, steps_of
from advdiff_sumo.export.importers.xml_file import attribute, found, read_xml

_WHAT = "an OpenSCENARIO file"
_KINDS = {
    "car": AgentClass.CAR,
    "truck": AgentClass.TRUCK,
    "bus": AgentClass.BUS,
    "motorbike": AgentClass.MOTORCYCLE,
    "bicycle": AgentClass.BICYCLE,
}


def read_openscenario(path: Path) -> ImportedScene:
    """Return the trajectories in *path*; speeds are derived from them, as polylines have none.

    Raises:
        FileError: it is missing or damaged, or its entities do not follow trajectories with times.
    """
    root = read_xml(path, "OpenSCENARIO", _WHAT)
    with reading(path, _WHAT):
        poses: dict[str, dict[float, tuple[float, float, float]]] = defaultdict(dict)
        for name, time, pose in (*_beginnings(root), *_appearances(root), *_vertices(root)):
            poses[name][round(time, 6)] = pose
        dt_s = spacing_s(np.array([time for of_one in poses.values() for time in of_one]))
        objects = {attribute(row, "name"): row for row in root.iterfind("Entities/ScenarioObject")}
        return assemble([_part(row, poses[name], dt_s) for name, row in objects.items()], dt_s)


_Sample: TypeAlias = tuple[str, float, tuple[float, float, float]]


def _beginnings(root: ET.Element) -> Iterator[_Sample]:
    """Yield where entities are at the start."""
    for private in root.iterfind("Storyboard/Init/Actions/Private"):
        place = private.find(".//TeleportAction")
        if place is not None:
            yield attribute(private, "entityRef"), 0.0, _pose(place)


def _appearances(root: ET.Element) -> Iterator[_Sample]:
    """Yield where entities are added later."""
    for event in root.iter("Event"):
        added = event.find(".//EntityAction")
        place = None if added is None else added.find("AddEntityAction")
        if added is not None and place is not None:
            time = float(attribute(found(event, ".//SimulationTimeCondition"), "value"))
            yield attribute(added, "entityRef"), time, _pose(place)


def _vertices(root: ET.Element) -> Iterator[_Sample]:
    """Yield the vertices of the trajectories."""
    for group in root.iter("ManeuverGroup"):
        name = attribute(found(group, "Actors/EntityRef"), "entityRef")
        for vertex in group.iter("Vertex"):
            yield name, float(attribute(vertex, "time")), _pose(vertex)


def _pose(holder: ET.Element) -> tuple[float, float, float]:
    place = found(holder, "Position/WorldPosition")
    return float(attribute(place, "x")), float(attribute(place, "y")), float(place.get("h", "0"))


def _part(row: ET.Element, poses: dict[float, tuple[float, float, float]], dt_s: float) -> AgentPart:
    """Return an entity's track: poses are of its reference point, the bounding box says where its centre is."""
    values = np.array([(time, *poses[time]) for time in sorted(poses)])
    body = row[0]
    marks = {attribute(x, "name"): attribute(x, "value") for x in body.iterfind("Properties/Property")}
    box = found(body, "BoundingBox/Dimensions")
    ahead = float(attribute(found(body, "BoundingBox/Center"), "x"))
    person = body.tag == "Pedestrian"
    return AgentPart(
        name=marks.get("agent", attribute(row, "name")),
        kind=AgentClass.PEDESTRIAN if person else _KINDS[attribute(body, "vehicleCategory")],
        size_m=(float(attribute(box, "length")), float(attribute(box, "width"))),
        step=steps_of(values[:, 0], dt_s),
        xy_m=values[:, 1:3] + ahead * unit(values[:, 3]),
        yaw_rad=values[:, 3],
        speed_mps=None,
        is_target=marks.get("role") == "target",
    )
