"""Contract checker of exporters, for every built-in and for users' own."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from advdiff_sumo.core.errors import FileError
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.export.export_scene import ExportScene, ImportedScene
from advdiff_sumo.export.exporter_protocol import Exporter

#: How far a trajectory may be from what was written.
POSITION_M = 0.01
HEADING_RAD = float(np.deg2rad(0.1))
_SIZE_M = 0.01


def check_exporter(exporter: Exporter, scene: ExportScene) -> list[str]:
    """Return what *exporter* does against its contract, one sentence each; empty when it keeps it.

    Writes *scene* twice into folders of its own, reads it back, and reads a file that is none.
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
    return path.name, hashlib.sha256(path.read_bytes()).hexdigest()


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
    """Yield how *read* differs from *scene* by more than ``POSITION_M`` and ``HEADING_RAD``."""
    ours, theirs = scene.tracks, read.tracks
    if sorted(theirs.ids) != sorted(ours.ids):
        yield f"it has the agents {sorted(theirs.ids)}, written were {sorted(ours.ids)}"
        return
    theirs = theirs.rows([theirs.index[name] for name in ours.ids])
    if read.tracks.ids[read.target] != ours.ids[scene.target]:
        yield f"the target is {read.tracks.ids[read.target]}, not {ours.ids[scene.target]}"
    if abs(theirs.dt_s - ours.dt_s) > 1e-6 or theirs.t0_s != ours.t0_s:
        yield f"instants are {theirs.dt_s} s apart from {theirs.t0_s} s on, not {ours.dt_s} s from {ours.t0_s} s"
    if theirs.valid.shape != ours.valid.shape or (theirs.valid != ours.valid).any():
        yield "agents are there at other instants"
        return
    if (theirs.classes != ours.classes).any():
        yield "agents are of other classes"
    if np.abs(theirs.size_m - ours.size_m).max() > _SIZE_M:
        yield f"boxes differ by up to {np.abs(theirs.size_m - ours.size_m).max():.3f} m"
    apart = np.hypot(*(theirs.xy_m - ours.xy_m)[ours.valid].T)
    turned = np.abs(wrap_angle(theirs.yaw_rad - ours.yaw_rad)[ours.valid])
    if apart.max() > POSITION_M:
        yield f"positions differ by up to {apart.max():.4f} m"
    if turned.max() > HEADING_RAD:
        yield f"headings differ by up to {np.rad2deg(turned.max()):.4f}°"
