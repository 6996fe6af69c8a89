"""``advdiff-sumo replay``: repeat one episode of a sweep or a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from advdiff_sumo.cli import run_flags as flags
from advdiff_sumo.cli.terminal import terminal
from advdiff_sumo.cli.worker_flags import end_as_by_ctrl_c
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
    sweep: flags.OfSweep = None,
    run: flags.OfRun = None,
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
    end_as_by_ctrl_c()
    one_thread_for_good()
    from advdiff_sumo.report.page import write_report  # late: --help is quick
    from advdiff_sumo.sim.free_folder import free_folder
    from advdiff_sumo.sweep.repeat import repeat, settings_for
    from advdiff_sumo.sweep.run_folder import RunFolder

    flags.check_display(gui)
    original = original_episode(key, run, sweep)
    repetition = repeat(original, gui)
    folder = RunFolder.create(
        out or free_folder("replay", original.name), settings_for(original.job, repetition.run), resume=False
    )
    folder.add(original.job.number, repetition.part)
    folder.consolidate(finished=True)
    write_report(folder.path)
    name = key if run else original.job.key
    terminal().print(
        f"{name}: {_outcome(repetition.part)}  ·  look at {folder.path / 'report.html'}", soft_wrap=True
    )
    if repetition.part.failed is not None:
        terminal().print(repetition.part.failed.message, style="red", soft_wrap=True)
        if tail := repetition.part.failed.log_tail.strip():
            terminal().print(tail, markup=False, highlight=False, soft_wrap=True)
    _print_whether_same(repetition.same, "run" if run else "sweep", gui, _outcome(original.part))


def original_episode(key: str, run: Path | None, sweep: Path | None) -> Before:
    """Return the stored episode *key* of *run* or *sweep*; if both are None, of the sweep in ``runs/`` that has it.

    Raises:
        InputError: there is no such episode, or both a run and a sweep are given.
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
    """Return the outcome of an episode in a word; "" if nothing of it is stored."""
    if part is None or not part.tables:
        return ""
    (row,) = part.tables["episodes"].to_pylist()
    return str(row["collision_type"] if row["target_collision"] else row["end"])


def _print_whether_same(same: bool | None, source: str, gui: bool, outcome: str) -> None:
    """Print whether the repetition equals the original; exit with code 1 if not, except in the GUI.

    Args:
        same: whether it does; None: the original has no result.
        source: "run" or "sweep", from which the original comes.
        gui: whether it was watched in sumo-gui.
        outcome: that of the original.
    """
    console = terminal()
    if same is None:
        console.print(f"the {source} has no result of it to compare with")
    elif same:
        console.print(f"the same as in the {source}")
    elif not gui:
        console.print(
            f"not the same as in the {source} ({outcome}): the planner's code has changed, another version, or a "
            "planner with a memory",
            style="red",
            soft_wrap=True,
        )
        raise typer.Exit(_DIFFERS)
