"""Writes and reads CSV files with one row for each agent and instant, for spreadsheets and scripts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv

from advdiff_sumo.core.errors import FileError
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.export.export_scene import ExportScene, ImportedScene
from advdiff_sumo.export.importers.assemble import AGAIN, AgentPart, assemble, reading, spacing_s, steps_of

_REAL = ("time_s", "length_m", "width_m", "x_m", "y_m", "yaw_rad", "speed_mps")
_TYPES = {
    **dict.fromkeys(_REAL, pa.float64()),
    "agent": pa.string(),
    "class": pa.string(),
    "is_target": pa.bool_(),
}


class Csv:
    """Exporter of CSV with columns of ``states.parquet``; numbers are not rounded."""

    def write(self, scene: ExportScene, folder: Path) -> tuple[Path, ...]:
        """Write ``NAME.csv``, with rows ordered by time."""
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
        return read_csv(path)


def read_csv(path: Path) -> ImportedScene:
    """Return the trajectories in *path*.

    Raises:
        FileError: it is missing, or is not a CSV file with the columns that :class:`Csv` writes.
    """
    options = pa_csv.ConvertOptions(
        column_types=_TYPES, include_columns=list(_TYPES), strings_can_be_null=False
    )
    with reading(path, "a CSV of trajectories"):
        try:
            table = pa_csv.read_csv(path, convert_options=options)
        except pa.ArrowException as error:
            problem = f"is not a CSV of trajectories ({' '.join(str(error).split())})"
            raise FileError(path, problem, AGAIN) from None
        values = {name: np.asarray(table[name].to_numpy(), dtype=np.float64) for name in _REAL}
        names = np.array(table["agent"].to_pylist(), dtype=object)
        dt_s = spacing_s(values["time_s"])
        parts = []
        for name in dict.fromkeys(names.tolist()):
            rows = np.flatnonzero(names == name)
            parts.append(
                AgentPart(
                    name=str(name),
                    kind=AgentClass[str(table["class"][int(rows[0])].as_py()).upper()],
                    size_m=(float(values["length_m"][rows[0]]), float(values["width_m"][rows[0]])),
                    step=steps_of(values["time_s"][rows], dt_s),
                    xy_m=np.column_stack((values["x_m"][rows], values["y_m"][rows])),
                    yaw_rad=values["yaw_rad"][rows],
                    speed_mps=values["speed_mps"][rows],
                    is_target=bool(table["is_target"][int(rows[0])].as_py()),
                )
            )
        return assemble(parts, dt_s)
