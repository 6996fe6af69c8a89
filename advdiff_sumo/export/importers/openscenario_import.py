"""Reads the OpenSCENARIO files that this package exports; it needs no extra."""

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
from advdiff_sumo.export.importers.xml_file import attribute, element_at, read_xml

_WHAT = "an OpenSCENARIO file"
_KINDS = {
    "car": AgentClass.CAR,
    "truck": AgentClass.TRUCK,
    "bus": AgentClass.BUS,
    "motorbike": AgentClass.MOTORCYCLE,
    "bicycle": AgentClass.BICYCLE,
}


def read_openscenario(path: Path) -> ImportedScene:
    """Return the trajectories in *path*; speeds are derived from positions, as the format's polylines have none.

    Raises:
        FileError: it is missing or damaged, or its entities do not follow trajectories with times.
    """
    root = read_xml(path, "OpenSCENARIO", _WHAT)
    with reading(path, _WHAT):
        poses: dict[str, dict[float, tuple[float, float, float]]] = defaultdict(dict)
        for name, time, pose in (*_initial_poses(root), *_added_poses(root), *_vertices(root)):
            poses[name][round(time, 6)] = pose
        dt_s = spacing_s(np.array([time for own_poses in poses.values() for time in own_poses]))
        objects = {attribute(row, "name"): row for row in root.iterfind("Entities/ScenarioObject")}
        return assemble([_part(row, poses[name], dt_s) for name, row in objects.items()], dt_s)


_Sample: TypeAlias = tuple[str, float, tuple[float, float, float]]


def _initial_poses(root: ET.Element) -> Iterator[_Sample]:
    """Yield the poses of entities that are present at the start."""
    for private in root.iterfind("Storyboard/Init/Actions/Private"):
        teleport = private.find(".//TeleportAction")
        if teleport is not None:
            yield attribute(private, "entityRef"), 0.0, _pose(teleport)


def _added_poses(root: ET.Element) -> Iterator[_Sample]:
    """Yield the poses at which entities are added later."""
    for event in root.iter("Event"):
        action = event.find(".//EntityAction")
        add = None if action is None else action.find("AddEntityAction")
        if action is not None and add is not None:
            time = float(attribute(element_at(event, ".//SimulationTimeCondition"), "value"))
            yield attribute(action, "entityRef"), time, _pose(add)


def _vertices(root: ET.Element) -> Iterator[_Sample]:
    """Yield the vertices of the trajectories."""
    for group in root.iter("ManeuverGroup"):
        name = attribute(element_at(group, "Actors/EntityRef"), "entityRef")
        for vertex in group.iter("Vertex"):
            yield name, float(attribute(vertex, "time")), _pose(vertex)


def _pose(parent: ET.Element) -> tuple[float, float, float]:
    position = element_at(parent, "Position/WorldPosition")
    return float(attribute(position, "x")), float(attribute(position, "y")), float(position.get("h", "0"))


def _part(row: ET.Element, poses: dict[float, tuple[float, float, float]], dt_s: float) -> AgentPart:
    """Return the track of an entity; its *poses* are of its reference point, its bounding box states its centre."""
    values = np.array([(time, *poses[time]) for time in sorted(poses)])
    body = row[0]
    properties = {attribute(x, "name"): attribute(x, "value") for x in body.iterfind("Properties/Property")}
    box = element_at(body, "BoundingBox/Dimensions")
    centre_ahead_m = float(attribute(element_at(body, "BoundingBox/Center"), "x"))
    is_person = body.tag == "Pedestrian"
    return AgentPart(
        name=properties.get("agent", attribute(row, "name")),
        kind=AgentClass.PEDESTRIAN if is_person else _KINDS[attribute(body, "vehicleCategory")],
        size_m=(float(attribute(box, "length")), float(attribute(box, "width"))),
        step=steps_of(values[:, 0], dt_s),
        xy_m=values[:, 1:3] + centre_ahead_m * unit(values[:, 3]),
        yaw_rad=values[:, 3],
        speed_mps=None,
        is_target=properties.get("role") == "target",
    )
