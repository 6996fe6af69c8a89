"""Reads the FCD that is exported here."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from advdiff_sumo.core.frames import centre_from_bumper, yaw_from_sumo
from advdiff_sumo.core.sumo_classes import VCLASS_OF_CLASS
from advdiff_sumo.export.export_scene import ImportedScene
from advdiff_sumo.export.importers.assemble import AgentPart, assemble, reading, spacing_s, steps_of
from advdiff_sumo.export.importers.xml_file import attribute, read_xml

_KINDS = {vclass: kind for kind, vclass in VCLASS_OF_CLASS.items()}
_WHAT = "SUMO's floating car data"


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
