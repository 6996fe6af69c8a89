"""One row an agent and instant, for spreadsheets and scripts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv

from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.export.export_scene import ExportScene, ImportedScene
from advdiff_sumo.export.importers import csv_import as importer


class Csv:
    """CSV with the columns of ``states.parquet``, numbers in full."""

    def write(self, scene: ExportScene, folder: Path) -> tuple[Path, ...]:
        """Write ``NAME.csv``, rows by time."""
        tracks, path = scene.tracks, folder / f"{scene.name}.csv"
        step, row = np.nonzero(tracks.valid.T)
        kinds = [AgentClass(int(k)).name.lower() for k in tracks.classes]
        columns = {
            "time_s": np.round(step * tracks.dt_s, 6),
            "agent": [tracks.ids[i] for i in row],
            "class": [kinds[i] for i in row],
            "length_m": tracks.size_m[row, 0],
            "width_m": tracks.size_m[row, 1],
            "x_m": tracks.xy_m[row, step, 0],
            "y_m": tracks.xy_m[row, step, 1],
            "yaw_rad": tracks.yaw_rad[row, step],
            "speed_mps": tracks.speed_mps[row, step],
            "is_target": row == scene.target,
        }
        pa_csv.write_csv(pa.table(columns), path)
        return (path,)

    def read(self, path: Path) -> ImportedScene:
        """Return the trajectories."""
        return importer.read_csv(path)
