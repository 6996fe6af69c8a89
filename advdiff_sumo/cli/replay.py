"""``advdiff-sumo replay``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from advdiff_sumo.cli import run_flags as flags
from advdiff_sumo.cli.terminal import terminal
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.threads import one_thread_for_good

if TYPE_CHECKING:
    from advdiff_sumo.sweep.repeat import Before

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
    from advdiff_sumo.report.page import write_report  # late: --help is quick
    from advdiff_sumo.sim.free_folder import free_folder
    from advdiff_sumo.sweep.repeat import repeat, settings_for
    from advdiff_sumo.sweep.run_folder import RunFolder

    flags.check_display(gui)
    before = _before(key, run, sweep)
    done = repeat(before, gui)
    folder = RunFolder.create(
        out or free_folder("replay", before.name), settings_for(before.job, done.run), resume=False
    )
    folder.add(before.job.number, done.part)
    folder.consolidate(finished=True)
    (row,) = done.part.tables["episodes"].to_pylist()
    write_report(folder.path)
    outcome = row["collision_type"] if row["target_collision"] else row["end"]
    terminal().print(
        f"{key if run else before.job.key}: {outcome}  ·  look at {folder.path / 'report.html'}",
        soft_wrap=True,
    )
    _say_whether_same(done.same, "run" if run else "sweep", gui)


def _before(key: str, run: Path | None, sweep: Path | None) -> Before:
    """Return the episode that is asked for.

    Raises:
        InputError: there is none such.
    """
    from advdiff_sumo.sim.free_folder import RUNS
    from advdiff_sumo.sweep.repeat import of_run, of_sweep  # late, as above

    if run is not None and sweep is not None:
        raise ConfigError("--run and --sweep cannot go together; name the folder of one")
    return of_sweep(key, sweep, RUNS) if run is None else of_run(key, run)


def _say_whether_same(same: bool | None, before: str, gui: bool) -> None:
    console = terminal()
    if same is None:
        console.print(f"the {before} has no result of it to compare with")
    elif same:
        console.print(f"the same as in the {before}")
    elif not gui:
        console.print(
            f"not the same as in the {before}: another version, or a planner with a memory", style="red"
        )
        raise typer.Exit(_DIFFERS)
