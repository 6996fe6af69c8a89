"""``advdiff-sumo export``: write an episode in the formats of other tools."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from advdiff_sumo.cli.terminal import terminal
from advdiff_sumo.core.errors import (
    AdvdiffError,
    ConfigError,
    FileError,
    MissingExtraError,
    NetError,
    UnknownNameError,
    os_reason,
)
from advdiff_sumo.core.plug_in_source import described, raised_at

if TYPE_CHECKING:
    from advdiff_sumo.export import Exporter, ExportScene

_console = terminal(highlight=False, soft_wrap=True)


def export(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a finished run or sweep.")],
    formats: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            "-f",
            help="openscenario, commonroad, scenarionet, fcd, csv, all of them with 'all', or "
            "package.module:Class; may be repeated.",
        ),
    ] = None,
    episode: Annotated[int | None, typer.Option(help="Number of the episode.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the files.", show_default="RUN/exports")
    ] = None,
) -> None:
    """Write one episode for colleagues who use other tools.

    Example: advdiff-sumo export runs/first --episode 3 --format openscenario --format fcd

    What each format holds, and what it cannot, stands in docs/exports.md.
    """
    from advdiff_sumo.experiments.folder_rows import put_together  # late: not for --help

    exporters = _exporters(formats or [])
    put_together(run)
    scene = scene_of(run, episode)
    folder = out or run / "exports"
    written, refused = _write(scene, exporters, folder)
    for path in written:
        _console.print(str(path))
    if refused:
        raise ConfigError("; ".join(refused))


def _exporters(formats: Sequence[str]) -> list[Exporter]:
    """Return the exporters of the *formats*, names of which 'all' means every one.

    Raises:
        ConfigError: no format was given, or a class cannot be imported or is no exporter.
        UnknownNameError: no such format.
    """
    from advdiff_sumo.export import EXPORTERS, make_exporter  # late, as above

    known = EXPORTERS.names()
    if not formats:
        raise ConfigError(f"say which format with --format; known are: {', '.join(known)}, all")
    try:
        return [make_exporter(name) for name in (known if "all" in formats else formats)]
    except UnknownNameError as error:
        raise UnknownNameError(error.kind, error.name, [*known, "all"]) from None


def _write(scene: ExportScene, exporters: Sequence[Exporter], folder: Path) -> tuple[list[Path], list[str]]:
    """Write *scene* into *folder* in all formats; return the files, and why formats could not be written."""
    written: list[Path] = []
    refused: list[str] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for exporter in exporters:
            try:
                written += _files_of(exporter, scene, folder)
            except (ConfigError, MissingExtraError) as error:
                refused.append(str(error))
    except OSError as error:
        raise FileError(folder, f"cannot be written ({os_reason(error)})", "choose another --out") from None
    return written, refused


def _files_of(exporter: Exporter, scene: ExportScene, folder: Path) -> Sequence[Path]:
    """Return the files that *exporter* writes.

    Raises:
        ConfigError: it cannot hold the scene or, a user's own, raised something else or returned no paths.
    """
    from advdiff_sumo.export import EXPORTERS  # late, as above

    name = f"{type(exporter).__module__}:{type(exporter).__qualname__}"
    try:
        files: object = exporter.write(scene, folder)  # by a user's own, anything
    except (AdvdiffError, OSError):
        raise
    except Exception as error:  # a user's exporter may raise anything; a traceback shows faults of our own
        if EXPORTERS.is_builtin(name):
            raise
        told = f"{described(error)}{raised_at(error, exporter)}"
        raise ConfigError(f"format '{name}' raised {told}; correct it") from error
    if isinstance(files, tuple | list) and all(isinstance(file, Path) for file in files):
        return files
    raise ConfigError(f"format '{name}' returned {files!r} from write; it must return a tuple of paths")


def scene_of(folder: Path, episode: int | None) -> ExportScene:
    """Return an episode of the run or sweep in *folder* with its net.

    Raises:
        FileError: the folder holds no run or no such episode, or the episode failed before its first instant.
        NetError: the net of the run no longer exists.
        ConfigError: no episode was given.
    """
    from advdiff_sumo.export import ExportScene  # late, as above
    from advdiff_sumo.maps import RoadMap
    from advdiff_sumo.report.folder import FinishedRun
    from advdiff_sumo.report.nets import net_path

    finished = FinishedRun.read(folder)
    if episode is None:
        raise ConfigError(f"say which episode with --episode; {folder} has {finished.numbers_text}")
    row = finished.row(episode)
    states = finished.states(episode)
    if states is None:
        raise FileError(folder, f"episode {episode} failed before its first instant", "choose another one")
    net = str(row.get("net") or finished.options.get("net", ""))
    path = net_path(net, folder)
    if path is None:
        raise NetError(net or folder, "the net of the run is no longer there", f"put it into {folder}")
    return ExportScene(f"{stem_of(folder)}-{episode:04d}", states.tracks, states.target, RoadMap.read(path))


def stem_of(folder: Path) -> str:
    """Return the first part of the names of files that are exported from *folder*."""
    return re.sub(r"[^\w.-]+|^[^A-Za-z0-9]+", "-", folder.resolve().name).lstrip("-._") or "run"
