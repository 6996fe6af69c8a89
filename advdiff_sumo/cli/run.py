"""``advdiff-sumo run``: run episodes of a target in traffic."""

from __future__ import annotations

import logging
import math
import shlex
import sys
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console

from advdiff_sumo.cli import run_flags as flags
from advdiff_sumo.cli.interruption import explains_how_to_continue
from advdiff_sumo.cli.terminal import print_json, progress_bar, terminal
from advdiff_sumo.cli.worker_flags import (
    MEMORY_MB,
    PLAN_TIMEOUT_S,
    Memory,
    PlanTimeout,
    end_as_by_ctrl_c,
    limits_of,
)
from advdiff_sumo.config import read_toml, set_dotted
from advdiff_sumo.core.errors import ConfigError, FileError
from advdiff_sumo.core.threads import one_thread_for_good
from advdiff_sumo.core.wording import counted

if TYPE_CHECKING:
    from advdiff_sumo.sim.run_episodes import Run, RunOptions
    from advdiff_sumo.sweep.run_folder import RunFolder
    from advdiff_sumo.sweep.tasks import Failed, WorkerLimits

_FAILED = 1
_NEW_OR_RESUME = "choose a new --out, or add --resume to go on with it"


def run(
    net: flags.Net = None,
    target: flags.Target = None,
    background: flags.Background = None,
    episodes: flags.Episodes = None,
    horizon: flags.Horizon = None,
    seed: flags.Seed = None,
    demand: flags.Demand = None,
    scenes: flags.Scenes = None,
    licence: flags.Licence = None,
    strength: flags.Strength = None,
    attackers: flags.Attackers = None,
    attack: flags.Attack = None,
    guide: flags.Guide = None,
    weights: flags.Weights = None,
    reward: flags.Reward = None,
    device: flags.Device = None,
    out: flags.Out = None,
    config: flags.Config = None,
    assign: flags.Assign = None,
    defect: flags.Defect = None,
    plan_timeout: PlanTimeout = PLAN_TIMEOUT_S,
    memory: Memory = MEMORY_MB,
    gui: flags.Gui = False,
    resume: flags.Resume = False,
    retry_failed: flags.RetryFailed = False,
    check: flags.Check = False,
    no_report: flags.NoReport = False,
    quiet: flags.Quiet = False,
    as_json: flags.Json = False,
) -> None:
    """Run episodes of a target in traffic, and write what happened.

    Without options: ten episodes of SUMO's IDM driver in the shipped downtown. Another example:

    advdiff-sumo run --net city.net.xml --target lane_graph --background diffusion --attack cut-in --check

    The folder of results holds run.toml (repeats the run: advdiff-sumo run --config run.toml), report.html, and
    tables such as episodes.parquet and, where episodes failed, failures.parquet. A planner or SUMO that crashes,
    hangs or eats memory costs its episode, never the run.

    Exit code 0: some episodes came to their end; 1: every one failed; 2: something given cannot be used.
    """
    one_thread_for_good()
    end_as_by_ctrl_c()
    chosen: dict[str, Any] = {"net": net, "target": target, "background": background, "episodes": episodes}
    chosen |= {"demand": demand and str(demand), "scenes": scenes and str(scenes), "horizon_s": horizon}
    policy: dict[str, Any] = {"licence": licence, "strength": strength, "attackers": attackers}
    policy |= {"attack": attack, "guide": guide, "weights": flags.weights_of(weights), "device": device}
    policy["reward"] = reward and str(reward.resolve())
    resumed = _settings_to_resume(out, resume, retry_failed)
    options = options_given(config or resumed, chosen | {"seed": seed}, policy, assign or [], defect)
    prepared, notes = _prepared(options, gui)
    console = terminal(quiet=quiet or as_json)
    with ExitStack() as stack:
        folder = _resumed_or_new(stack, console, prepared, notes, out, resumed)
        stack.enter_context(explains_how_to_continue(lambda: _resume_command(folder)))
        limits = limits_of(stack, math.inf, plan_timeout, memory)
        stack.callback(_draw_report, folder.path, not no_report)
        count = _run_episodes(prepared, folder, console, limits, quiet, retry_failed)
    _print_outcome(console, folder, prepared, count, check, as_json, resume and no_report)


def _resumed_or_new(
    stack: ExitStack,
    console: Console,
    prepared: Run,
    notes: Iterable[str],
    out: Path | None,
    resumed: Path | None,
) -> RunFolder:
    """Return the folder of the run, and print *notes*; until *stack* is left no other run may write into it.

    It is that of the settings file *resumed*, with a note if code has changed since; None: a new folder.
    """
    from advdiff_sumo.sweep.sole_writer import sole_writer  # late, as above

    if resumed:
        stack.enter_context(sole_writer(resumed.parent))
    before = read_toml(resumed).get("run", {}) if resumed else {}
    folder = _folder(prepared, out, resumed is not None)
    if not resumed:
        stack.enter_context(sole_writer(folder.path))
    else:
        tell_changed_code(read_toml(resumed)["run"], before)
    print_notes(console, notes)
    return folder


def _prepared(options: RunOptions, gui: bool) -> tuple[Run, list[str]]:
    """Return the checked run, and notes on its net, log and demand; workers start at the same time."""
    flags.check_display(gui)
    if not gui:
        _start_workers(options)
    from advdiff_sumo.sim.run_episodes import Run  # late: workers import what they need meanwhile

    prepared = Run.prepare(options, gui)
    return prepared, prepared.notes()  # before a folder is made: if the log cannot be read, no folder is left


def _start_workers(options: RunOptions) -> None:
    """Let workers import the modules of target and background while this process imports its own."""
    from advdiff_sumo.planners.planner_registry import TARGETS
    from advdiff_sumo.sweep.executors import prepare_workers  # late: --help needs neither SUMO nor plots
    from advdiff_sumo.traffic.policy_registry import POLICIES

    modules = TARGETS.builtin_module(options.target), POLICIES.builtin_module(options.background)
    prepare_workers(module for module in modules if module is not None)


def _folder(prepared: Run, out: Path | None, resume: bool) -> RunFolder:
    """Return the folder *out* of the run; None: a new one, named after the run."""
    from advdiff_sumo.sim.free_folder import free_folder, run_words  # late, as above
    from advdiff_sumo.sweep.run_engine import run_settings
    from advdiff_sumo.sweep.run_folder import RunFolder

    words = run_words(prepared.settings["options"]["net"], *prepared.names, prepared.options.seed)
    return RunFolder.create(out or free_folder(*words), run_settings(prepared), resume, _NEW_OR_RESUME)


def _resume_command(folder: RunFolder) -> str | None:
    """Return the command that continues the run; None if nothing had finished, so that its folder was removed."""
    exists = (folder.path / "run.toml").exists()
    return f"advdiff-sumo run --resume --out {shlex.quote(str(folder.path))}" if exists else None


def _print_outcome(
    console: Console,
    folder: RunFolder,
    prepared: Run,
    count: int,
    check: bool,
    as_json: bool,
    keeps_old_report: bool,
) -> None:
    """Print the results of the *count* episodes; exit with code 1 if all failed.

    Args:
        console: receives the text.
        folder: the run's folder.
        prepared: the run.
        count: number of its episodes.
        check: whether to print implausible behaviour of background vehicles.
        as_json: whether to print one JSON object.
        keeps_old_report: whether to note that the report is older than the results.
    """
    from advdiff_sumo.cli.check_run import print_check  # late: --help needs neither SUMO nor plots
    from advdiff_sumo.cli.summary import note_old_report, print_summary, run_object

    if keeps_old_report:
        note_old_report(console, folder.path)
    failures = folder.failures()
    print_summary(console, folder.path, prepared.options.episodes - count, failures)
    if check:
        print_check(console, folder.path, prepared.road)
    if as_json:
        print_json(run_object(folder.path))
    if len(failures) == count:
        raise typer.Exit(_FAILED)


def tell_changed_code(now: Mapping[str, Any], before: Mapping[str, Any]) -> None:
    """Print which planners and policies have changed since the stored episodes were run.

    Args:
        now: versions and digests of the present code.
        before: those of the code with which the folder was begun.
    """
    from advdiff_sumo.sweep.code_digests import changed_code  # late, as above

    names = changed_code(now, before)
    if names:
        files = f"the file of {names[0]} has" if len(names) == 1 else f"the files of {', '.join(names)} have"
        terminal(stderr=True).print(
            f"note: {files} changed since this was begun, and what had finished then stays; "
            "choose a new --out to have all of one code",
            style="yellow",
            soft_wrap=True,
        )


def print_notes(console: Console, notes: Iterable[str]) -> None:
    """Print *notes* on nets, logs and demand."""
    for note in notes:
        console.print(f"note: {note}", soft_wrap=True)


def _run_episodes(
    prepared: Run, folder: RunFolder, console: Console, limits: WorkerLimits, quiet: bool, retry_failed: bool
) -> int:
    """Run the episodes missing in *folder* with a progress bar; return how many the run has."""
    from advdiff_sumo.report.attack_words import out_of_position
    from advdiff_sumo.sweep.executors import ProcessExecutor, SerialExecutor
    from advdiff_sumo.sweep.run_engine import run_into

    executor = SerialExecutor(prepared) if prepared.gui else ProcessExecutor(1, limits)
    collisions = failed = 0
    with progress_bar(console) as progress:
        done = len(folder.done(retry_failed))
        task = progress.add_task("episodes", total=prepared.options.episodes, completed=done)

        def on_episode(row: Mapping[str, Any] | None, failure: Failed | None) -> None:
            nonlocal collisions, failed
            collisions += bool(row and row["target_collision"])
            failed += failure is not None
            text = f"episodes · {counted(collisions, 'collision')}" + (
                f" · {failed} failed" if failed else ""
            )
            progress.update(task, advance=1, description=text)
            attack = out_of_position(row or {})
            if row and attack is not None:
                console.print(f"episode {row['episode']}: no one was in a position to {attack}")

        is_silent = quiet and not logging.getLogger("advdiff_sumo").isEnabledFor(logging.INFO)

        def on_output(line: str) -> None:
            if not is_silent:  # with -v, the lines include logs
                sys.stderr.write(f"{line}\n")  # Rich prints it above the progress bar

        return run_into(prepared, folder, executor, on_episode, on_output, retry_failed=retry_failed)


def _draw_report(folder: Path, is_wanted: bool) -> None:
    """Write the report of the run in *folder* if *is_wanted* and the run has tables."""
    if not is_wanted or not (folder / "episodes.parquet").exists():
        return
    from advdiff_sumo.report.page import write_report  # late, as above

    write_report(folder)


def _settings_to_resume(out: Path | None, resume: bool, retry_failed: bool) -> Path | None:
    """Return the settings file of the run in *out* to resume; None without ``--resume``.

    Raises:
        ConfigError: ``--resume`` lacks ``--out``, or ``--retry-failed`` lacks ``--resume``.
        FileError: *out* holds no run.
    """
    flags.check_retry(retry_failed, resume)
    if not resume:
        return None
    if out is None:
        raise ConfigError("--resume does not say which run; add its folder with --out")
    settings = out / "run.toml"
    if not settings.is_file():
        raise FileError(out, "holds no run to go on with", "name the folder of one, or leave --resume out")
    return settings


def options_given(
    config: Path | None,
    cli_options: Mapping[str, Any],
    policy: Mapping[str, Any],
    assignments: list[str],
    defects: list[str] | None = None,
    base: Mapping[str, Any] = MappingProxyType({}),
) -> RunOptions:
    """Return the options of a run; ``--set`` overrides the command line, which overrides the file, and that *base*.

    Args:
        config: TOML file of options; None: no file.
        cli_options: options of the command line by name; None: not given.
        policy: options of the background, which a file has in the table ``background_options``.
        assignments: NAME=VALUE of ``--set``.
        defects: defects to plant in the target, which a file has in the table ``target_options``.
        base: options that hold where none is given.

    Raises:
        FileError: the file cannot be read.
        ConfigError: an option is unknown or unusable.
    """
    from advdiff_sumo.sim.run_episodes import RunOptions  # late, as above

    values: dict[str, Any] = {}
    if config is not None:
        content = read_toml(config)
        values = content.get("options", {}) if "options" in content else content
        if not isinstance(values, dict):
            raise ConfigError(f"{config}: [options] is not a table")
        if values.keys() & {"grid", "cases"}:
            raise ConfigError(f"{config}: is the file of a sweep; give it to advdiff-sumo sweep")
    values = {**base, **values, **{key: value for key, value in cli_options.items() if value is not None}}
    policy_options = {key: value for key, value in policy.items() if value is not None}
    if policy_options:
        _add_to(values, "background_options", policy_options)
    if defects:
        _add_to(values, "target_options", {"defects": defects})
    for assignment in assignments:
        set_dotted(values, assignment)
    return RunOptions.parse(values, str(config) if config else "options")


def _add_to(values: dict[str, Any], group: str, added: Mapping[str, Any]) -> None:
    """Add options to the table *group* of *values*, in place.

    If *group* is no table, it stays as it is; it is refused when all options are checked.
    """
    existing = values.get(group, {})
    if isinstance(existing, Mapping):
        values[group] = {**existing, **added}
