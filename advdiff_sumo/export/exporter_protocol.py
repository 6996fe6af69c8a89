"""What writes an episode in the format of another tool."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, runtime_checkable

from advdiff_sumo.export.export_scene import ExportScene, ImportedScene


@runtime_checkable
class Exporter(Protocol):
    """Writes one format and reads it back; it keeps nothing between calls."""

    def write(self, scene: ExportScene, folder: Path) -> tuple[Path, ...]:
        """Write *scene* into the existing *folder* and return the files, first the one that :meth:`read` takes.

        The same scene gives the same bytes; file names begin with the scene's name or hold it.

        Raises:
            ConfigError: the format cannot hold such a scene.
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
