"""Reads exported scenarios back as trajectories."""

from __future__ import annotations

from pathlib import Path

from advdiff_sumo.core.errors import FileError
from advdiff_sumo.export.export_scene import ImportedScene
from advdiff_sumo.export.exporter_registry import make_exporter

_ENDINGS = {
    ".xosc": "openscenario",
    ".cr.xml": "commonroad",
    ".pkl": "scenarionet",
    ".fcd.xml": "fcd",
    ".csv": "csv",
}


def import_scene(path: str | Path) -> ImportedScene:
    """Return the trajectories in a file that a built-in exporter wrote; its ending shows the format.

    Raises:
        FileError: the ending is unknown, or the file is missing, damaged or of another kind.
    """
    path = Path(path)
    for ending, name in _ENDINGS.items():
        if path.name.endswith(ending):
            return make_exporter(name).read(path)
    raise FileError(path, "has an ending that no format has", f"known are {', '.join(_ENDINGS)}")
