"""Reads the ScenarioNet record that is exported here, through the reader of driving logs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from advdiff_sumo.core.errors import LogError
from advdiff_sumo.core.frames import unit
from advdiff_sumo.data import ScenarioNetReader
from advdiff_sumo.data.scenarionet_log import read_record
from advdiff_sumo.export.export_scene import ImportedScene
from advdiff_sumo.export.importers.assemble import reading


def read_scenarionet(path: Path) -> ImportedScene:
    """Return the trajectories in *path*; nothing in the pickle is run (see ``data.pickles``).

    Raises:
        FileError: it is missing, damaged or no record.
    """
    if not path.is_file():
        raise LogError(path, "no such file", "give a ScenarioNet record")
    log = ScenarioNetReader(path).read(path.stem)
    with reading(path, "a ScenarioNet record"):
        rows = read_record(path)["tracks"]
        velocity = np.array([np.asarray(rows[name]["state"]["velocity"], float) for name in log.tracks.ids])
        along = (velocity * unit(log.tracks.yaw_rad)).sum(axis=-1)
        speed = np.where(log.tracks.valid, along, np.nan)
        return ImportedScene(replace(log.tracks, speed_mps=speed), log.ego)
