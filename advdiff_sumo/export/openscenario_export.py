"""Writes ASAM OpenSCENARIO XML 1.2 with OpenDRIVE, see https://www.asam.net/standards/detail/openscenario-xml/."""

from __future__ import annotations

from pathlib import Path

from advdiff_sumo.core.errors import ConfigError, MissingExtraError
from advdiff_sumo.export.export_scene import ExportScene, ImportedScene
from advdiff_sumo.export.importers import openscenario_import as importer
from advdiff_sumo.export.net_opendrive import write_net_opendrive


class OpenScenario:
    """Exporter of a scenario in which all agents follow their recorded trajectories."""

    def write(self, scene: ExportScene, folder: Path) -> tuple[Path, ...]:
        """Write ``NAME.xosc`` and ``NAME.xodr``.

        Positions are those of the rear axle's centre, as the format requires (of the box's centre for pedestrians).
        Times count from the start. Agents that are not always present are added and deleted.

        Raises:
            ConfigError: the episode has only one instant; the format cannot represent a scene without motion.
        """
        if scene.tracks.steps < 2:
            raise ConfigError(
                f"{scene.name} ended at its first instant, and the format 'openscenario' holds motion only; "
                "choose another episode or format"
            )
        try:
            from advdiff_sumo.export.story import scenario_of  # late: it needs an extra
        except ModuleNotFoundError as error:
            if error.name != "scenariogeneration":
                raise
            raise MissingExtraError("the format 'openscenario'", "openscenario") from None
        path, roads = folder / f"{scene.name}.xosc", folder / f"{scene.name}.xodr"
        write_net_opendrive(scene.road, roads)
        scenario_of(scene, roads.name).write_xml(str(path))
        return path, roads

    def read(self, path: Path) -> ImportedScene:
        """Return the trajectories."""
        return importer.read_openscenario(path)
