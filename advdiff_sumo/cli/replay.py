"""``advdiff-sumo replay``."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from advdiff_sumo.cli.terminal import terminal
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.threads import one_thread_for_good

_RUNS = Path("runs")
_DIFFERS = 1


def replay(
    key: Annotated[
        str,
        typer.Argument(
            help="Key of an episode of a sweep, or how it begins; with --run its number.", show_default=False
        ),
    ],
    sweep: Annotated[
        Path | None, typer.Option(help="Folder of the sweep.", show_default="the one in runs/ that has it")
    ] = None,
    run: Annotated[Path | None, typer.Option(help="Folder of a run, in place of a sweep.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the episode.", show_default="runs/replay-KEY")
    ] = None,
    gui: Annotated[bool, typer.Option("--gui", help="Watch in sumo-gui (needs a display).")] = False,
) -> None:
    """Run one episode of a sweep or a run again, exactly, and draw its report.

    advdiff-sumo replay 53dd5b1d77f3 --sweep runs/planners

    advdiff-sumo replay 4 --run runs/first

    Says whether the result is the same as before; exit code 1 where it is not. A planner that hangs or crashes does
    so here, too, in this process, where a debugger reaches it.
    """
    one_thread_for_good()
    from advdiff_sumo.report import write_report  # late: --help is quick
    from advdiff_sumo.sweep.repeat import repeat, run_with, settings_for, sweep_with
    from advdiff_sumo.sweep.run_folder import RunFolder

    if run is not None and sweep is not None:
        raise ConfigError("--run and --sweep cannot go together; name the folder of one")

    if gui and sys.platform == "linux" and not os.environ.get("DISPLAY"):
        raise ConfigError("--gui needs a display; set DISPLAY, or leave --gui out")
    if run is not None:
        begun, plan, job = run_with(key, run)
        before, name = "run", f"{run.resolve().name}-{job.number}"
        store, stored = begun.store, begun.part(job.number)
    else:
        store, plan, job = sweep_with(key, sweep, _RUNS)
        before, name, stored = "sweep", job.key, store.read(job.key)
    done = repeat(store, plan, job, stored, gui)
    folder = RunFolder.create(out or _free(name), settings_for(job, done.run), resume=False)
    folder.add(job.number, done.part)
    folder.consolidate(finished=True)
    (row,) = done.part.tables["episodes"].to_pylist()
    write_report(folder.path)
    console = terminal()
    what = row["collision_type"] if row["target_collision"] else row["end"]
    console.print(
        f"{key if run else job.key}: {what}  ·  look at {folder.path / 'report.html'}", soft_wrap=True
    )
    if done.same is None:
        console.print(f"the {before} has no result of it to compare with")
    elif done.same:
        console.print(f"the same as in the {before}")
    elif not gui:
        console.print(
            f"[red]not the same as in the {before}: another version, or a planner with a memory[/red]"
        )
        raise typer.Exit(_DIFFERS)


def _free(key: str) -> Path:
    path, number = _RUNS / f"replay-{key}", 2
    while path.exists():
        path, number = _RUNS / f"replay-{key}-{number}", number + 1
    return path
