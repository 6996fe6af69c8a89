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
    from advdiff_sumo.sweep.stored_episode import StoredEpisode

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
    write_report(folder.path)
    terminal().print(
        f"{key if run else before.job.key}: {_outcome(done.part)}  ·  look at {folder.path / 'report.html'}",
        soft_wrap=True,
    )
    if done.part.failed is not None:
        terminal().print(done.part.failed.message, style="red", soft_wrap=True)
        if tail := done.part.failed.log_tail.strip():
            terminal().print(tail, markup=False, highlight=False, soft_wrap=True)
    _say_whether_same(done.same, "run" if run else "sweep", gui, _outcome(before.part))


def _before(key: str, run: Path | None, sweep: Path | None) -> Before:
    """Return the episode that is asked for.

    Raises:
        InputError: there is none such.
    """
    from advdiff_sumo.data.run_tables import RUN_SETTINGS, RunTables
    from advdiff_sumo.sim.free_folder import RUNS
    from advdiff_sumo.sweep.repeat import of_run, of_sweep  # late, as above

    if run is not None and sweep is not None:
        raise ConfigError("--run and --sweep cannot go together; name the folder of one")
    folder = run or sweep
    if folder is None or RunTables(folder).is_sweep:
        return of_sweep(key, folder, RUNS)
    is_run = run is not None or (folder / RUN_SETTINGS).is_file()
    return of_run(key, folder) if is_run else of_sweep(key, folder, RUNS)


def _outcome(part: StoredEpisode | None) -> str:
    """Return what came of an episode in a word; "" where nothing is kept."""
    if part is None or not part.tables:
        return ""
    (row,) = part.tables["episodes"].to_pylist()
    return str(row["collision_type"] if row["target_collision"] else row["end"])


def _say_whether_same(same: bool | None, before: str, gui: bool, outcome: str) -> None:
    console = terminal()
    if same is None:
        console.print(f"the {before} has no result of it to compare with")
    elif same:
        console.print(f"the same as in the {before}")
    elif not gui:
        console.print(
            f"not the same as in the {before} ({outcome}): the planner's code has changed, another version, or a "
            "planner with a memory",
            style="red",
            soft_wrap=True,
        )
        raise typer.Exit(_DIFFERS)
