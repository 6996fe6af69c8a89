"""Writes episodes in the formats of other tools and reads them back; see ``docs/exports.md``."""

from __future__ import annotations

from advdiff_sumo.export.export_check import check_exporter
from advdiff_sumo.export.export_scene import ExportScene, ImportedScene
from advdiff_sumo.export.exporter_protocol import Exporter
from advdiff_sumo.export.exporter_registry import EXPORTERS, make_exporter
from advdiff_sumo.export.importers import import_scene

__all__ = [
    "EXPORTERS",
    "ExportScene",
    "Exporter",
    "ImportedScene",
    "check_exporter",
    "import_scene",
    "make_exporter",
]
