"""Checks that an exporter, built-in or a user's own, fulfils the contract of the protocol ``Exporter``."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from advdiff_sumo.core.errors import FileError
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.whole_file import sha256_of
from advdiff_sumo.export.export_scene import ExportScene, ImportedScene
from advdiff_sumo.export.exporter_protocol import Exporter

#: Largest permitted differences between the trajectories written and read.
POSITION_M = 0.01
HEADING_RAD = float(np.deg2rad(0.1))
_SIZE_M = 0.01


def check_exporter(exporter: Exporter, scene: ExportScene) -> list[str]:
    """Return one sentence for each violation of the contract by *exporter*; empty if there is none.

    The check writes *scene* twice into temporary folders, reads it back, and reads a damaged file.
    """
    with tempfile.TemporaryDirectory() as first, tempfile.TemporaryDirectory() as second:
        try:
            files = exporter.write(scene, Path(first))
            again = exporter.write(scene, Path(second))
        except Exception as error:  # noqa: BLE001 - a user's exporter may raise anything; that is a finding
            return [f"write raised {type(error).__name__}: {error}"]
        problems = list(_file_problems(files, scene, Path(first)))
        if problems:
            return problems
        if [_digest(path) for path in files] != [_digest(path) for path in again]:
            problems.append("the same scene gives other bytes a second time")
        try:
            problems += compare(exporter.read(files[0]), scene)
        except Exception as error:  # noqa: BLE001 - as above
            problems.append(f"read raised {type(error).__name__}: {error}")
        return [*problems, *_refusal_problems(exporter, files[0])]


def _file_problems(files: tuple[Path, ...], scene: ExportScene, folder: Path) -> Iterator[str]:
    if not files:
        yield "write returns no file"
    for path in files:
        if not path.is_file() or path.parent != folder:
            yield f"{path.name} is not in the folder that was given"
        elif scene.name not in path.name:
            yield f"{path.name} does not hold the scene's name '{scene.name}'"


def _digest(path: Path) -> tuple[str, str]:
    return path.name, sha256_of(path)


def _refusal_problems(exporter: Exporter, path: Path) -> Iterator[str]:
    path.write_bytes(b"\x00no file of this kind")
    try:
        exporter.read(path)
    except FileError:
        return
    except Exception as error:  # noqa: BLE001 - as above
        yield f"a damaged file makes read raise {type(error).__name__}, not FileError"
    else:
        yield "read takes a damaged file"


def compare(read: ImportedScene, scene: ExportScene) -> Iterator[str]:
    """Yield a sentence for each difference between *read* and *scene*.

    Positions may differ by ``POSITION_M`` and headings by ``HEADING_RAD``.
    """
    written, read_back = scene.tracks, read.tracks
    if sorted(read_back.ids) != sorted(written.ids):
        yield f"it has the agents {sorted(read_back.ids)}, written were {sorted(written.ids)}"
        return
    read_back = read_back.rows([read_back.index[name] for name in written.ids])
    if read.tracks.ids[read.target] != written.ids[scene.target]:
        yield f"the target is {read.tracks.ids[read.target]}, not {written.ids[scene.target]}"
    if abs(read_back.dt_s - written.dt_s) > 1e-6 or read_back.t0_s != written.t0_s:
        times = [f"{tracks.dt_s} s apart from {tracks.t0_s} s" for tracks in (read_back, written)]
        yield f"instants are {times[0]} on, not {times[1]} on"
    if read_back.valid.shape != written.valid.shape or (read_back.valid != written.valid).any():
        yield "agents are there at other instants"
        return
    if (read_back.classes != written.classes).any():
        yield "agents are of other classes"
    if np.abs(read_back.size_m - written.size_m).max() > _SIZE_M:
        yield f"boxes differ by up to {np.abs(read_back.size_m - written.size_m).max():.3f} m"
    distance_m = np.hypot(*(read_back.xy_m - written.xy_m)[written.valid].T)
    turn_rad = np.abs(wrap_angle(read_back.yaw_rad - written.yaw_rad)[written.valid])
    if distance_m.max() > POSITION_M:
        yield f"positions differ by up to {distance_m.max():.4f} m"
    if turn_rad.max() > HEADING_RAD:
        yield f"headings differ by up to {np.rad2deg(turn_rad.max()):.4f}°"
