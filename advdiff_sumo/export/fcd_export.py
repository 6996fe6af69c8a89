"""SUMO's floating car data with a configuration that sumo-gui plays.

SUMO's own device ``fcd-replay`` moves the vehicles; formats: https://sumo.dlr.de/docs/Simulation/Output/FCDOutput.html
and https://sumo.dlr.de/docs/Simulation/FCDReplay.html.
"""

from __future__ import annotations

import shutil
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from advdiff_sumo.core.frames import bumper_from_centre, centre_from_bumper, sumo_from_yaw, yaw_from_sumo
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.core.sumo_classes import VCLASS_OF_CLASS
from advdiff_sumo.export.export_scene import ExportScene, ImportedScene, number, plain_names, seconds
from advdiff_sumo.export.importers.assemble import AgentPart, assemble, reading, spacing_s, steps_of
from advdiff_sumo.export.importers.xml_file import attribute, read_xml

TARGET_COLOUR, OTHER_COLOUR, PERSON_COLOUR = "214,39,40", "31,119,180", "44,160,44"
PATH_EVERY_S = 0.5
PLAIN_NAME = r"[A-Za-z0-9_.:#-]+"
#: Nothing may keep a vehicle from being where the data have it.
_AS_RECORDED = {
    "lateral-resolution": "0.4",
    "insertion-checks": "none",
    "collision.action": "none",
    "time-to-teleport": "-1",
}
_KINDS = {vclass: kind for kind, vclass in VCLASS_OF_CLASS.items()}
_WHAT = "SUMO's floating car data"


class Fcd:
    """FCD with types, driven paths, the net and a ``.sumocfg``."""

    def write(self, scene: ExportScene, folder: Path) -> tuple[Path, ...]:
        """Write ``NAME.fcd.xml``, ``NAME.add.xml``, ``NAME.sumocfg`` and a copy of the net.

        Positions are front bumpers and angles degrees clockwise from north, as SUMO's.
        """
        tracks, suffix = scene.tracks, ".net.xml.gz" if scene.road.path.suffix == ".gz" else ".net.xml"
        net = folder / f"{scene.name}{suffix}"
        data, types, config = (folder / f"{scene.name}{end}" for end in (".fcd.xml", ".add.xml", ".sumocfg"))
        shutil.copyfile(scene.road.path, net)
        names = plain_names(tracks.ids, PLAIN_NAME)
        _save(_data(tracks, names), data)
        _save(_additional(tracks, names, scene.target), types)
        _save(_configuration(tracks, net.name, types.name, data.name), config)
        return data, types, config, net

    def read(self, path: Path) -> ImportedScene:
        """Return the trajectories; ``NAME.add.xml`` must lie beside."""
        return read_fcd(path)


def _data(tracks: Tracks, names: list[str]) -> ET.Element:
    root = ET.Element("fcd-export")
    length = np.broadcast_to(tracks.size_m[:, :1], tracks.yaw_rad.shape)
    bumper = bumper_from_centre(tracks.xy_m, tracks.yaw_rad, length)
    angle = sumo_from_yaw(tracks.yaw_rad)
    person = tracks.classes == AgentClass.PEDESTRIAN
    for step in range(tracks.steps):
        instant = ET.SubElement(root, "timestep", time=seconds(step, tracks.dt_s))
        there = np.flatnonzero(tracks.valid[:, step])
        for row in there[np.argsort(person[there], kind="stable")]:  # the schema wants persons last
            ET.SubElement(
                instant,
                "person" if person[row] else "vehicle",
                id=names[row],
                x=number(bumper[row, step, 0]),
                y=number(bumper[row, step, 1]),
                angle=number(angle[row, step]),
                type=f"type_{names[row]}",
                speed=number(max(tracks.speed_mps[row, step], 0.0)),
            )
    return root


def _additional(tracks: Tracks, names: list[str], target: int) -> ET.Element:
    root = ET.Element("additional")
    for row, name in enumerate(names):
        kind = AgentClass(int(tracks.classes[row]))
        person = kind is AgentClass.PEDESTRIAN
        colour = TARGET_COLOUR if row == target else PERSON_COLOUR if person else OTHER_COLOUR
        length, width = (number(x) for x in tracks.size_m[row])
        of_agent = ET.SubElement(
            root,
            "vType",
            id=f"type_{name}",
            vClass=VCLASS_OF_CLASS[kind],
            length=length,
            width=width,
            minGap="0",
        )
        of_agent.set("color", colour)
        for key, value in (("agent", tracks.ids[row]), ("target", str(row == target).lower())):
            ET.SubElement(of_agent, "param", key=key, value=value)
    for row, name in enumerate(names):
        _path(root, tracks, row, name, TARGET_COLOUR if row == target else "127,127,127")
    return root


def _path(root: ET.Element, tracks: Tracks, row: int, name: str, colour: str) -> None:
    """Add the driven path as a line, for those that move."""
    points = tracks.xy_m[row][tracks.valid[row]]
    points = np.vstack((points[:: max(1, round(PATH_EVERY_S / tracks.dt_s))], points[-1:]))
    if np.ptp(points, axis=0).max() > 1.0:
        shape = " ".join(f"{number(x, 2)},{number(y, 2)}" for x, y in points)
        line = ET.SubElement(root, "poly", id=f"path_{name}", type="path", color=colour, fill="false")
        line.set("layer", "5")
        line.set("lineWidth", "0.3")
        line.set("shape", shape)


def _configuration(tracks: Tracks, net: str, types: str, data: str) -> ET.Element:
    root = ET.Element("sumoConfiguration")
    groups = {
        "input": {"net-file": net, "additional-files": types},
        "time": {
            "begin": "0",
            "end": seconds(tracks.steps + 1, tracks.dt_s),
            "step-length": seconds(1, tracks.dt_s),
        },
        "processing": _AS_RECORDED,
        "report": {"no-warnings": "true"},
        "fcd_replay_device": {"device.fcd-replay.files": data},
        "gui_only": {"delay": str(round(1000 * tracks.dt_s))},
    }
    for group, options in groups.items():
        holder = ET.SubElement(root, group)
        for name, value in options.items():
            ET.SubElement(holder, name, value=value)
    return root


def _save(root: ET.Element, path: Path) -> None:
    ET.indent(root)
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


@dataclass
class _Rows:
    type_id: str
    values: list[tuple[float, float, float, float, float]] = field(default_factory=list)


def read_fcd(path: Path) -> ImportedScene:
    """Return the trajectories in ``NAME.fcd.xml``; sizes and the target come from ``NAME.add.xml`` beside it.

    Raises:
        FileError: one of the two is missing or damaged.
    """
    root = read_xml(path, "fcd-export", _WHAT)
    beside = path.with_name(f"{path.name.removesuffix('.xml').removesuffix('.fcd')}.add.xml")
    types = read_xml(beside, "additional", "the additional file of exported FCD")
    with reading(path, _WHAT):
        by_id = {attribute(row, "id"): row for row in types.iter("vType")}
        rows: dict[str, _Rows] = defaultdict(lambda: _Rows(""))
        for instant in root.iter("timestep"):
            time = float(attribute(instant, "time"))
            for agent in instant:
                of_agent = rows[attribute(agent, "id")]
                of_agent.type_id = attribute(agent, "type")
                x, y, angle, speed = (float(attribute(agent, key)) for key in ("x", "y", "angle", "speed"))
                of_agent.values.append((time, x, y, angle, speed))
        dt_s = spacing_s(np.array([value[0] for of_agent in rows.values() for value in of_agent.values]))
        # in the order of the types, which is that of the tracks
        order = {type_id: number for number, type_id in enumerate(by_id)}
        named = sorted(rows.items(), key=lambda item: order[item[1].type_id])
        return assemble([_part(name, by_id[r.type_id], r, dt_s) for name, r in named], dt_s)


def _part(name: str, of_type: ET.Element, rows: _Rows, dt_s: float) -> AgentPart:
    values = np.array(rows.values, dtype=np.float64)
    yaw = yaw_from_sumo(values[:, 3])
    length, width = float(attribute(of_type, "length")), float(attribute(of_type, "width"))
    marks = {row.get("key"): row.get("value") for row in of_type.iter("param")}
    return AgentPart(
        name=marks.get("agent") or name,
        kind=_KINDS[attribute(of_type, "vClass")],
        size_m=(length, width),
        step=steps_of(values[:, 0], dt_s),
        xy_m=centre_from_bumper(values[:, 1:3], yaw, np.asarray(length)),
        yaw_rad=yaw,
        speed_mps=values[:, 4],
        is_target=marks.get("target") == "true",
    )
