"""``advdiff-sumo planner-kit``: write the files that a planner in a separate environment needs."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from advdiff_sumo.cli.terminal import terminal


def planner_kit(
    folder: Annotated[Path, typer.Argument(help="New folder, which pip install takes.")],
) -> None:
    """Write the Python kit that serves a planner, and the protocol for other languages, into a folder.

    advdiff-sumo planner-kit kit, then in the planner's environment: pip install ./kit
    """
    from advdiff_sumo.planners.remote.write_kit import write_kit  # late: not for --help

    written = write_kit(folder)
    proto = next(path for path in written if path.suffix == ".proto")
    console = terminal(highlight=False, soft_wrap=True)
    place = shlex.quote(str(folder.absolute()))
    console.print(f"{folder}: {len(written)} files; in the planner's environment: pip install {place}")
    console.print(f"other languages: {proto}")
