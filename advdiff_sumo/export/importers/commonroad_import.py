"""Reads the CommonRoad scenarios that are exported here."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree as ET

import numpy as np

from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.export.export_scene import ImportedScene
from advdiff_sumo.export.importers.assemble import AgentPart, assemble, reading
from advdiff_sumo.export.importers.xml_file import attribute, found, read_xml, text_at

_WHAT = "a CommonRoad scenario"


def read_commonroad(path: Path) -> ImportedScene:
    """Return the trajectories in *path*; obstacles of one name are stretches of one agent.

    Raises:
        FileError: it is missing or damaged, or its obstacles carry no names.
    """
    root = read_xml(path, "commonRoad", _WHAT)
    with reading(path, _WHAT):
        parts = [_part(element) for element in root.iterfind("dynamicObstacle")]
        return assemble(parts, float(attribute(root, "timeStepSize")))


def _part(element: ET.Element) -> AgentPart:
    role, name = _name(element)
    states = [found(element, "initialState"), *element.iterfind("trajectory/state")]
    xy = [[float(text_at(state, f"position/point/{axis}")) for axis in ("x", "y")] for state in states]
    yaw, step, speed = (
        np.array([float(text_at(state, f"{key}/exact")) for state in states])
        for key in ("orientation", "time", "velocity")
    )
    size = [float(text_at(element, f"shape/rectangle/{side}")) for side in ("length", "width")]
    return AgentPart(
        name=name,
        kind=AgentClass[text_at(element, "type").upper()],
        size_m=(size[0], size[1]),
        step=step.astype(np.int64),
        xy_m=np.array(xy),
        yaw_rad=yaw,
        speed_mps=speed,
        is_target=role == "target",
    )


def _name(element: ET.Element) -> tuple[str, str]:
    """Return role and name of the agent, from the comment in its obstacle."""
    for child in element:
        tag: object = child.tag  # of a comment, the function that makes comments
        if tag is ET.Comment and child.text:
            role, _, name = child.text.strip().partition(": ")
            if role in ("target", "agent"):
                return role, unquote(name)
    raise ValueError(f"obstacle {element.get('id')} has no comment with the agent's name")
