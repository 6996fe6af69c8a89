"""Episodes in the formats of other tools, and back: see ``docs/exports.md``."""

from __future__ import annotations

from advdiff_sumo.export.base import Exporter
from advdiff_sumo.export.check import check_exporter
from advdiff_sumo.export.importers import import_scene
from advdiff_sumo.export.registry import EXPORTERS, make_exporter
from advdiff_sumo.export.scene import ExportScene, ImportedScene

__all__ = [
    "EXPORTERS",
    "ExportScene",
    "Exporter",
    "ImportedScene",
    "check_exporter",
    "import_scene",
    "make_exporter",
]
