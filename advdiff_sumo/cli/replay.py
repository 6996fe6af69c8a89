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
        str, typer.Argument(help="Key of an episode of a sweep, or how it begins.", show_default=False)
    ],
    sweep: Annotated[
        Path | None, typer.Option(help="Folder of the sweep.", show_default="the one in runs/ that has it")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the episode.", show_default="runs/replay-KEY")
    ] = None,
    gui: Annotated[bool, typer.Option("--gui", help="Watch in sumo-gui (needs a display).")] = False,
) -> None:
    """Run one episode of a sweep again, exactly, and draw its report.

    advdiff-sumo replay 53dd5b1d77f3 --sweep runs/planners

    Says whether the result is that of the sweep; exit code 1 where it is not. A planner that hangs or crashes does
    so here, too, in this process, where a debugger reaches it.
    """
    one_thread_for_good()
    from advdiff_sumo.metrics.metric_rows import collision_rows, episode_row  # late: --help is quick
    from advdiff_sumo.report import write_report
    from advdiff_sumo.sim.run_store import RunFolder
    from advdiff_sumo.sweep.repeat import repeat, settings_for, sweep_with

    if gui and sys.platform == "linux" and not os.environ.get("DISPLAY"):
        raise ConfigError("--gui needs a display; set DISPLAY, or leave --gui out")
    store, plan, job = sweep_with(key, sweep, _RUNS)
    path = out or _free(job.key)
    done = repeat(store, plan, job, gui)
    folder = RunFolder.create(path, settings_for(job, done.run), resume=False)
    row = episode_row(done.record, done.run.road)
    folder.add(done.record, row, collision_rows(done.record, done.run.road), done.timing)
    folder.consolidate(finished=True)
    write_report(folder.path)
    console = terminal()
    what = row["collision_type"] if row["target_collision"] else row["end"]
    console.print(f"{job.key}: {what}  ·  look at {folder.path / 'report.html'}", soft_wrap=True)
    if done.same is None:
        console.print("the sweep has no result of it to compare with")
    elif done.same:
        console.print("the same as in the sweep")
    elif not gui:
        console.print("[red]not the same as in the sweep: another version, or a planner with a memory[/red]")
        raise typer.Exit(_DIFFERS)


def _free(key: str) -> Path:
    path, number = _RUNS / f"replay-{key}", 2
    while path.exists():
        path, number = _RUNS / f"replay-{key}-{number}", number + 1
    return path
