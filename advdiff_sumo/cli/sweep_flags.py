"""The options of ``advdiff-sumo sweep`` and ``results``, except those of workers."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, TypeAlias

import typer


class ExecutorName(StrEnum):
    """Executors that can run the episodes."""

    serial = "serial"
    process = "process"
    ray = "ray"


File: TypeAlias = Annotated[
    Path | None, typer.Argument(help="Sweep file; may be left out with --resume.", show_default=False)
]
Target: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        help="Target in place of those in the file, with default options; may be given several times.",
        show_default="those in the file",
    ),
]
Executor: TypeAlias = Annotated[
    ExecutorName, typer.Option(help="This process (to debug), processes, or a Ray cluster.")
]
RayAddress: TypeAlias = Annotated[
    str | None, typer.Option(help="Ray cluster, HOST:PORT or auto; without it one is started here.")
]
Out: TypeAlias = Annotated[
    Path | None, typer.Option(help="Folder for the results.", show_default="runs/NAME-OF-FILE")
]
Resume: TypeAlias = Annotated[
    Path | None, typer.Option(help="Go on in this folder: run only what is missing or damaged.")
]
Limit: TypeAlias = Annotated[int | None, typer.Option(min=1, help="Only the first N episodes.")]
Diverse: TypeAlias = Annotated[
    bool,
    typer.Option("--diverse", help="Choose attacks and seed scenes, in rounds, for encounters not met yet."),
]
Retries: TypeAlias = Annotated[
    int, typer.Option(min=0, help="How often to try an episode again after its worker died.")
]
DryRun: TypeAlias = Annotated[
    bool, typer.Option("--dry-run", help="Check everything, count, measure a few episodes, write nothing.")
]
Report: TypeAlias = Annotated[bool, typer.Option("--report/--no-report", help="Draw report.html at the end.")]
JUnit: TypeAlias = Annotated[Path | None, typer.Option(help="Write JUnit XML here, for CI.")]
FailIf: TypeAlias = Annotated[
    str | None, typer.Option(help='Exit with code 1 if so, for example "valid_failures > 0 or failures > 0".')
]
