"""Defines the interface of exporters, which write episodes in the formats of other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, runtime_checkable

from advdiff_sumo.export.export_scene import ExportScene, ImportedScene


@runtime_checkable
class Exporter(Protocol):
    """Writes one format and reads it back; it stores nothing between calls."""

    def write(self, scene: ExportScene, folder: Path) -> tuple[Path, ...]:
        """Write *scene* into the existing *folder* and return the files, first the one that :meth:`read` reads.

        The same scene gives the same bytes. File names contain the scene's name.

        Raises:
            ConfigError: the format cannot represent such a scene.
            MissingExtraError: the format needs a package that is not installed.
            OSError: the folder cannot be written.
        """
        ...

    def read(self, path: Path) -> ImportedScene:
        """Return the trajectories in *path*, the first file of :meth:`write`.

        Positions are within 1 cm and headings within 0.1° of those that were written.

        Raises:
            FileError: the file is missing, damaged or of another kind.
        """
        ...
