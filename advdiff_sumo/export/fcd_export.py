"""Writes and reads SUMO's floating car data (FCD), with a configuration that sumo-gui can play.

SUMO's device ``fcd-replay`` moves the vehicles. Formats: https://sumo.dlr.de/docs/Simulation/Output/FCDOutput.html and
https://sumo.dlr.de/docs/Simulation/FCDReplay.html.
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
from advdiff_sumo.export.export_scene import (
    ExportScene,
    ImportedScene,
    decimal_text,
    plain_names,
    seconds_text,
)
from advdiff_sumo.export.importers.assemble import AgentPart, assemble, reading, spacing_s, steps_of
from advdiff_sumo.export.importers.xml_file import attribute, read_xml

TARGET_COLOUR, OTHER_COLOUR, PERSON_COLOUR = "214,39,40", "31,119,180", "44,160,44"
PATH_EVERY_S = 0.5  # spacing of the points of drawn paths
PLAIN_NAME = r"[A-Za-z0-9_.:#-]+"
#: Options that prevent SUMO from changing the recorded positions.
_AS_RECORDED = {
    "lateral-resolution": "0.4",
    "insertion-checks": "none",
    "collision.action": "none",
    "time-to-teleport": "-1",
}
_KINDS = {vclass: kind for kind, vclass in VCLASS_OF_CLASS.items()}
_WHAT = "SUMO's floating car data"


class Fcd:
    """Exporter of FCD with vehicle types, driven paths, the net and a ``.sumocfg``."""

    def write(self, scene: ExportScene, folder: Path) -> tuple[Path, ...]:
        """Write ``NAME.fcd.xml``, ``NAME.add.xml``, ``NAME.sumocfg`` and a copy of the net.

        As in SUMO, positions are those of the front bumper, and angles are in degrees clockwise from north.
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
        """Return the trajectories; ``NAME.add.xml`` must be in the same folder."""
        return read_fcd(path)


def _data(tracks: Tracks, names: list[str]) -> ET.Element:
    root = ET.Element("fcd-export")
    length = np.broadcast_to(tracks.size_m[:, :1], tracks.yaw_rad.shape)
    bumper = bumper_from_centre(tracks.xy_m, tracks.yaw_rad, length)
    angle = sumo_from_yaw(tracks.yaw_rad)
    is_person = tracks.classes == AgentClass.PEDESTRIAN
    for step in range(tracks.steps):
        instant = ET.SubElement(root, "timestep", time=seconds_text(step, tracks.dt_s))
        present = np.flatnonzero(tracks.valid[:, step])
        for row in present[np.argsort(is_person[present], kind="stable")]:  # the schema requires persons last
            ET.SubElement(
                instant,
                "person" if is_person[row] else "vehicle",
                id=names[row],
                x=decimal_text(bumper[row, step, 0]),
                y=decimal_text(bumper[row, step, 1]),
                angle=decimal_text(angle[row, step]),
                type=f"type_{names[row]}",
                speed=decimal_text(max(tracks.speed_mps[row, step], 0.0)),
            )
    return root


def _additional(tracks: Tracks, names: list[str], target: int) -> ET.Element:
    root = ET.Element("additional")
    for row, name in enumerate(names):
        kind = AgentClass(int(tracks.classes[row]))
        is_person = kind is AgentClass.PEDESTRIAN
        colour = TARGET_COLOUR if row == target else PERSON_COLOUR if is_person else OTHER_COLOUR
        length, width = (decimal_text(x) for x in tracks.size_m[row])
        vehicle_type = ET.SubElement(
            root,
            "vType",
            id=f"type_{name}",
            vClass=VCLASS_OF_CLASS[kind],
            length=length,
            width=width,
            minGap="0",
        )
        vehicle_type.set("color", colour)
        for key, value in (("agent", tracks.ids[row]), ("target", str(row == target).lower())):
            ET.SubElement(vehicle_type, "param", key=key, value=value)
    for row, name in enumerate(names):
        _add_path(root, tracks, row, name, TARGET_COLOUR if row == target else "127,127,127")
    return root


def _add_path(root: ET.Element, tracks: Tracks, row: int, name: str, colour: str) -> None:
    """Add the driven path of an agent as a line, if it moves."""
    points = tracks.xy_m[row][tracks.valid[row]]
    points = np.vstack((points[:: max(1, round(PATH_EVERY_S / tracks.dt_s))], points[-1:]))
    if np.ptp(points, axis=0).max() > 1.0:
        shape = " ".join(f"{decimal_text(x, 2)},{decimal_text(y, 2)}" for x, y in points)
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
            "end": seconds_text(tracks.steps + 1, tracks.dt_s),
            "step-length": seconds_text(1, tracks.dt_s),
        },
        "processing": _AS_RECORDED,
        "report": {"no-warnings": "true"},
        "fcd_replay_device": {"device.fcd-replay.files": data},
        "gui_only": {"delay": str(round(1000 * tracks.dt_s))},
    }
    for section_name, options in groups.items():
        section = ET.SubElement(root, section_name)
        for name, value in options.items():
            ET.SubElement(section, name, value=value)
    return root


def _save(root: ET.Element, path: Path) -> None:
    ET.indent(root)
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


@dataclass
class _Rows:
    """The type of an agent and its rows: time, x, y, angle, speed."""

    type_id: str
    values: list[tuple[float, float, float, float, float]] = field(default_factory=list)


def read_fcd(path: Path) -> ImportedScene:
    """Return the trajectories in ``NAME.fcd.xml``; sizes and the target are read from ``NAME.add.xml`` beside it.

    Raises:
        FileError: one of the two is missing or damaged.
    """
    root = read_xml(path, "fcd-export", _WHAT)
    additional = path.with_name(f"{path.name.removesuffix('.xml').removesuffix('.fcd')}.add.xml")
    additional_root = read_xml(additional, "additional", "the additional file of exported FCD")
    with reading(path, _WHAT):
        types = {attribute(element, "id"): element for element in additional_root.iter("vType")}
        rows: dict[str, _Rows] = defaultdict(lambda: _Rows(""))
        for instant in root.iter("timestep"):
            time = float(attribute(instant, "time"))
            for agent in instant:
                agent_rows = rows[attribute(agent, "id")]
                agent_rows.type_id = attribute(agent, "type")
                x, y, angle, speed = (float(attribute(agent, key)) for key in ("x", "y", "angle", "speed"))
                agent_rows.values.append((time, x, y, angle, speed))
        dt_s = spacing_s(np.array([row[0] for agent_rows in rows.values() for row in agent_rows.values]))
        # in the order of the types, which is that of the tracks
        order = {type_id: number for number, type_id in enumerate(types)}
        ordered = sorted(rows.items(), key=lambda item: order[item[1].type_id])
        return assemble([_part(name, types[r.type_id], r, dt_s) for name, r in ordered], dt_s)


def _part(name: str, vehicle_type: ET.Element, rows: _Rows, dt_s: float) -> AgentPart:
    values = np.array(rows.values, dtype=np.float64)
    yaw = yaw_from_sumo(values[:, 3])
    length, width = float(attribute(vehicle_type, "length")), float(attribute(vehicle_type, "width"))
    params = {row.get("key"): row.get("value") for row in vehicle_type.iter("param")}
    return AgentPart(
        name=params.get("agent") or name,
        kind=_KINDS[attribute(vehicle_type, "vClass")],
        size_m=(length, width),
        step=steps_of(values[:, 0], dt_s),
        xy_m=centre_from_bumper(values[:, 1:3], yaw, np.asarray(length)),
        yaw_rad=yaw,
        speed_mps=values[:, 4],
        is_target=params.get("target") == "true",
    )
