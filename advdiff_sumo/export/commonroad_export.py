"""Writes and reads CommonRoad scenarios 2020a (Althoff, Koschi, Manzinger 2017, doi:10.1109/IVS.2017.7995802).

The module follows the schema of the format, https://commonroad.in.tum.de. It does not use commonroad-io, which pins an
old protobuf; only the tests read its files with that.
"""

from __future__ import annotations

import re
from pathlib import Path
from urllib.parse import quote, unquote
from xml.etree import ElementTree as ET

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, stretches
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.export.commonroad_lanelets import add_map
from advdiff_sumo.export.export_scene import ExportScene, ImportedScene, decimal_text, unwrapped
from advdiff_sumo.export.importers.assemble import AgentPart, assemble, reading
from advdiff_sumo.export.importers.xml_file import attribute, element_at, read_xml, text_at

#: A constant date, so that the same episode gives the same file.
DATE = "1970-01-01"
_UNKNOWN_PLACE = ("999", "999")  # CommonRoad's values for it
_GOAL_MARGIN_M = 2.0  # added to length and width of the target's box for the goal area
_WHAT = "a CommonRoad scenario"


class CommonRoad:
    """Exporter of a scenario with lanelets, the trajectories of all agents and the target's planning problem."""

    def write(self, scene: ExportScene, folder: Path) -> tuple[Path, ...]:
        """Write ``NAME.cr.xml``.

        Each uninterrupted part of an agent's track is a dynamic obstacle with a comment that contains the agent's name.
        The target is an obstacle too, so that criticality can be measured. To test another planner on the planning
        problem, remove it.
        """
        path, tracks = folder / f"{scene.name}.cr.xml", scene.tracks
        root = ET.Element("commonRoad", commonRoadVersion="2020a", benchmarkID=benchmark_id(scene.road.name))
        root.set("date", DATE)
        root.set("author", "advdiff-sumo")
        root.set("affiliation", "")
        root.set("source", f"advdiff-sumo, episode {scene.name}")
        root.set("timeStepSize", f"{tracks.dt_s:.6f}".rstrip("0"))
        _location(root, scene)
        tags = ET.SubElement(root, "scenarioTags")
        for tag in ("critical", "simulated"):
            ET.SubElement(tags, tag)
        next_id = add_map(root, scene)
        for row in range(tracks.agents):
            for start, stop in stretches(tracks.valid[row]):
                _add_obstacle(root, scene, row, start, stop, next_id)
                next_id += 1
        _add_problem(root, scene, next_id)
        ET.indent(root)
        ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
        return (path,)

    def read(self, path: Path) -> ImportedScene:
        """Return the trajectories."""
        return read_commonroad(path)


def benchmark_id(net: str) -> str:
    """Return a benchmark id in CommonRoad's form for a scenario on *net* (ZAM: an imaginary country)."""
    words = re.findall(r"[A-Za-z0-9]+", net)
    return f"ZAM_{''.join(word[:1].upper() + word[1:] for word in words) or 'Net'}-1_1_T-1"


def _location(root: ET.Element, scene: ExportScene) -> None:
    degrees = scene.road.lonlat(scene.tracks.xy_m[scene.target][scene.tracks.valid[scene.target]][0])
    lon, lat = (
        _UNKNOWN_PLACE if degrees is None else (decimal_text(degrees[0], 7), decimal_text(degrees[1], 7))
    )
    location = ET.SubElement(root, "location")
    for name, value in (("geoNameId", "-999"), ("gpsLatitude", lat), ("gpsLongitude", lon)):
        ET.SubElement(location, name).text = value


def _add_obstacle(
    root: ET.Element, scene: ExportScene, row: int, start: int, stop: int, obstacle_id: int
) -> None:
    """Add the steps *start* to *stop* of agent *row* as an obstacle."""
    tracks = scene.tracks
    element = ET.SubElement(root, "dynamicObstacle", id=str(obstacle_id))
    role = "target" if row == scene.target else "agent"
    element.append(ET.Comment(f" {role}: {quote(tracks.ids[row], safe='').replace('-', '%2D')} "))
    ET.SubElement(element, "type").text = AgentClass(int(tracks.classes[row])).name.lower()
    box = ET.SubElement(ET.SubElement(element, "shape"), "rectangle")
    for name, size in zip(("length", "width"), tracks.size_m[row], strict=True):
        ET.SubElement(box, name).text = decimal_text(size)
    yaw = unwrapped(tracks.yaw_rad[row, start:stop])
    trajectory = None
    for step in range(start, stop):
        if step == start:
            state = ET.SubElement(element, "initialState")
        else:
            trajectory = ET.SubElement(element, "trajectory") if trajectory is None else trajectory
            state = ET.SubElement(trajectory, "state")
        _fill_state(state, tracks.xy_m[row, step], yaw[step - start], tracks.speed_mps[row, step], step)


def _fill_state(state: ET.Element, xy_m: FloatArray, yaw_rad: float, speed_mps: float, step: int) -> None:
    point = ET.SubElement(ET.SubElement(state, "position"), "point")
    for name, value in zip(("x", "y"), xy_m, strict=True):
        ET.SubElement(point, name).text = decimal_text(value)
    _add_exact(state, "orientation", decimal_text(yaw_rad, 6))
    _add_exact(state, "time", str(step))
    _add_exact(state, "velocity", decimal_text(speed_mps))


def _add_exact(parent: ET.Element, name: str, value: str) -> None:
    ET.SubElement(ET.SubElement(parent, name), "exact").text = value


def _add_problem(root: ET.Element, scene: ExportScene, problem_id: int) -> None:
    """Add the planning problem: from the target's first to its last pose, in at most the time that it took."""
    tracks, row = scene.tracks, scene.target
    steps = np.flatnonzero(tracks.valid[row])
    first, last = int(steps[0]), int(steps[-1])
    problem = ET.SubElement(root, "planningProblem", id=str(problem_id))
    state = ET.SubElement(problem, "initialState")
    _fill_state(
        state, tracks.xy_m[row, first], tracks.yaw_rad[row, first], tracks.speed_mps[row, first], first
    )
    for name in ("yawRate", "slipAngle"):
        _add_exact(state, name, "0.0")
    goal = ET.SubElement(problem, "goalState")
    time = ET.SubElement(goal, "time")
    ET.SubElement(time, "intervalStart").text = "0"
    ET.SubElement(time, "intervalEnd").text = str(max(last, 1))
    area = ET.SubElement(ET.SubElement(goal, "position"), "rectangle")
    for name, size in zip(("length", "width"), tracks.size_m[row] + _GOAL_MARGIN_M, strict=True):
        ET.SubElement(area, name).text = decimal_text(size)
    ET.SubElement(area, "orientation").text = decimal_text(tracks.yaw_rad[row, last], 6)
    centre = ET.SubElement(area, "center")
    for name, value in zip(("x", "y"), tracks.xy_m[row, last], strict=True):
        ET.SubElement(centre, name).text = decimal_text(value)


def read_commonroad(path: Path) -> ImportedScene:
    """Return the trajectories in *path*; obstacles with the same name are parts of one agent's track.

    Raises:
        FileError: it is missing or damaged, or its obstacles have no names.
    """
    root = read_xml(path, "commonRoad", _WHAT)
    with reading(path, _WHAT):
        parts = [_part(element) for element in root.iterfind("dynamicObstacle")]
        return assemble(parts, float(attribute(root, "timeStepSize")))


def _part(element: ET.Element) -> AgentPart:
    role, name = _name(element)
    states = [element_at(element, "initialState"), *element.iterfind("trajectory/state")]
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
    """Return the role and name of the agent from the comment in its obstacle."""
    for child in element:
        tag: object = child.tag  # for a comment, the tag is the function that creates comments
        if tag is ET.Comment and child.text:
            role, _, name = child.text.strip().partition(": ")
            if role in ("target", "agent"):
                return role, unquote(name)
    raise ValueError(f"obstacle {element.get('id')} has no comment with the agent's name")
