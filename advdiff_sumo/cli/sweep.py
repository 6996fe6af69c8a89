"""``advdiff-sumo sweep``: run many episodes in parallel."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from advdiff_sumo.cli import sweep_flags as flags
from advdiff_sumo.cli import worker_flags as worker
from advdiff_sumo.cli.interruption import explains_how_to_continue
from advdiff_sumo.cli.run import tell_changed_code
from advdiff_sumo.cli.run_flags import Json, Quiet, RetryFailed, check_retry
from advdiff_sumo.cli.terminal import Bars, print_json, terminal
from advdiff_sumo.core.errors import ConfigError, FileError, UnknownNameError
from advdiff_sumo.core.threads import one_thread_for_good
from advdiff_sumo.core.wording import counted

if TYPE_CHECKING:
    from advdiff_sumo.sweep.condition import Condition
    from advdiff_sumo.sweep.executors import Executor
    from advdiff_sumo.sweep.job_plan import SweepPlan
    from advdiff_sumo.sweep.sweep_runner import RemainingJobs
    from advdiff_sumo.sweep.sweep_store import Store
    from advdiff_sumo.sweep.tasks import WorkerLimits

_DRY_RUN_INTERRUPTED = "interrupted; a dry run keeps nothing"


def sweep(
    file: flags.File = None,
    target: flags.Target = None,
    workers: worker.Workers = None,
    executor: flags.Executor = flags.ExecutorName.process,
    ray_address: flags.RayAddress = None,
    out: flags.Out = None,
    resume: flags.Resume = None,
    timeout: worker.Timeout = 300.0,
    limit: flags.Limit = None,
    diverse: flags.Diverse = False,
    plan_timeout: worker.PlanTimeout = worker.PLAN_TIMEOUT_S,
    memory: worker.Memory = worker.MEMORY_MB,
    retries: flags.Retries = 2,
    retry_failed: RetryFailed = False,
    dry_run: flags.DryRun = False,
    report: flags.Report = True,
    junit: flags.JUnit = None,
    fail_if: flags.FailIf = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Run many episodes in parallel: nets × seed scenes × targets × backgrounds × seeds.

    advdiff-sumo sweep scenarios/sweeps/thorough.toml --target my_planner:MyPlanner --workers 8

    A worker that crashes, hangs or eats memory loses one episode, which is recorded as failed. Ctrl-C, a kill or
    a power cut lose the episodes in flight: advdiff-sumo sweep --resume DIR runs what is missing.
    """
    one_thread_for_good()
    from advdiff_sumo.cli.sweep_results import check_junit, condition_of  # late: --help needs no simulator
    from advdiff_sumo.sweep.sweep_runner import RemainingJobs, open_store

    worker.end_as_by_ctrl_c()
    check_retry(retry_failed, resume is not None)
    resumed = _resumed_store(resume, out, dry_run)
    console, condition = terminal(quiet=quiet or as_json), condition_of(fail_if)
    slots = workers or worker.cores()
    with ExitStack() as stack:
        if dry_run:
            stack.enter_context(explains_how_to_continue(lambda: None, _DRY_RUN_INTERRUPTED))
        plan = _plan(console, file, resumed, diverse, target or [])
        limits = worker.limits_of(stack, timeout, plan_timeout, memory)
        if dry_run:
            jobs = RemainingJobs.of(plan, resumed, limit, retry_failed)
            _print_estimate(console, plan, jobs, slots, limits)
            return
        check_junit(junit)
        task_executor = _executor(executor, workers if ray_address else slots, ray_address, plan, limits)
        _print_changed_code(plan, resumed)
        folder = resume or out or _new_folder(console, file)
        store = open_store(folder, plan, task_executor.slots, resume is not None)
        stack.enter_context(explains_how_to_continue(lambda: _resume_command(store.path)))
        remaining = RemainingJobs.of(plan, store, limit, retry_failed)
        missing = _run_episodes(console, plan, store, remaining, task_executor, retries)
    _report(console, store.path, report, remaining.done < remaining.total)
    _conclude(console, store, plan, missing, condition, junit, as_json)


def _resumed_store(resume: Path | None, out: Path | None, dry_run: bool) -> Store | None:
    """Return the sweep to resume; None if a new one is begun, or would be by *dry_run*.

    Raises:
        ConfigError: *out* names another folder than *resume*, or *resume* is an option.
        FileError: a new sweep is to be written into *out*, which is in use.
    """
    from advdiff_sumo.sweep.sweep_store import Store, must_be_free

    if out is not None and resume is None and not dry_run:
        must_be_free(out)
    if resume is not None and resume.name.startswith("--") and not resume.exists():
        raise ConfigError(f"--resume takes the folder, not {resume}: advdiff-sumo sweep --resume DIR")
    if resume is not None and out is not None and out.resolve() != resume.resolve():
        raise ConfigError(f"--resume {resume} goes on in that folder; leave --out {out} out")
    return None if resume is None else Store.open(resume)


def _print_changed_code(plan: SweepPlan, resumed: Store | None) -> None:
    """Print which planners and policies have changed since the stored episodes were run."""
    from advdiff_sumo.sweep.sweep_runner import settings_of

    if resumed is not None:
        tell_changed_code(settings_of(plan)["made_by"], resumed.made_by())


def _resume_command(folder: Path) -> str:
    """Return the command that continues the sweep in *folder*."""
    return f"advdiff-sumo sweep --resume {shlex.quote(str(folder))}"


def _report(console: Console, folder: Path, is_wanted: bool, has_new_episodes: bool) -> None:
    """Write the report if *is_wanted*; otherwise note if an existing report lacks new episodes."""
    from advdiff_sumo.cli.summary import note_old_report

    if is_wanted:
        _draw_report(console, folder)
    elif has_new_episodes:
        note_old_report(console, folder)


def _conclude(
    console: Console,
    store: Store,
    plan: SweepPlan,
    missing: int,
    condition: Condition | None,
    junit: Path | None,
    as_json: bool,
) -> None:
    """Print the results and, with *as_json*, the object of the sweep; exit with code 1 if *condition* holds."""
    from advdiff_sumo.cli.summary import run_object
    from advdiff_sumo.cli.sweep_results import conclude
    from advdiff_sumo.experiments.folder_rows import rows_of_sweep

    if as_json:
        print_json({**run_object(store.path), "missing": missing})
    conclude(console, rows_of_sweep(store, plan, missing), condition, junit)


def _draw_report(console: Console, folder: Path) -> None:
    """Write the report; if it cannot be written, print why, since the results of the sweep are complete anyway."""
    from advdiff_sumo.report.page import write_report

    try:
        console.print(f"look at {write_report(folder)}", soft_wrap=True)
    except FileError as error:
        console.print(f"no report: {error}", style="red", soft_wrap=True)


def _spec(file: Path | None, store: Store | None, diverse: bool, targets: Sequence[str]) -> Any:
    """Return the specification of the sweep, from its file or from the sweep to resume.

    Raises:
        ConfigError: there is neither, or ``--diverse``, ``--target`` or the file contradicts the sweep to resume.
    """
    from advdiff_sumo.sweep.spec import SweepSpec
    from advdiff_sumo.sweep.sweep_store import must_equal

    stored = None if store is None else store.spec()
    if file is None and stored is None:
        raise ConfigError("no sweep file was given; scenarios/sweeps/quick.toml is a small one")
    if stored is not None and diverse and not stored.diverse:
        raise ConfigError("that sweep was begun without --diverse; leave it out, or choose a new --out")
    if file is None and targets:
        raise ConfigError(
            "that sweep has its targets; leave --target out, or give the sweep file and a new --out"
        )
    if file is None:
        return stored
    spec = SweepSpec.read(file)
    if targets:
        spec = spec.with_targets(targets)
    if diverse or (stored is not None and stored.diverse):
        spec = spec.model_copy(update={"diverse": True})
    if store is not None and stored is not None:
        must_equal(store.path, stored, spec)
    return spec


def _plan(
    console: Console, file: Path | None, resumed: Store | None, diverse: bool, targets: Sequence[str]
) -> SweepPlan:
    """Return the plan of all episodes, and print notes, such as which parts of logs are left out."""
    from advdiff_sumo.cli.run import print_notes
    from advdiff_sumo.sweep.job_plan import plan_sweep, sweep_notes

    spec = _spec(file, resumed, diverse, targets)
    try:
        plan = plan_sweep(spec, places=True)
    except (ConfigError, UnknownNameError) as error:
        if file is None or str(file) in str(error):
            raise
        raise ConfigError(f"{file}: {error}") from error
    print_notes(console, sweep_notes(plan))
    return plan


def _new_folder(console: Console, file: Path | None) -> Path:
    """Return a new folder named after *file*; print a note if a sweep of this name exists already."""
    from advdiff_sumo.data.run_tables import SWEEP_SETTINGS
    from advdiff_sumo.sim.free_folder import RUNS, free_folder

    name = file.stem if file is not None else "sweep"
    folder = free_folder(name)
    if folder.name != name and (RUNS / name / SWEEP_SETTINGS).exists():
        older = RUNS / name
        note = f"{shlex.quote(str(older))} is there already ({_resume_command(older)} goes on with it)"
        console.print(f"{note}: this one goes to {folder}", soft_wrap=True)
    return folder


def _executor(
    name: flags.ExecutorName, workers: int | None, address: str | None, plan: SweepPlan, limits: WorkerLimits
) -> Executor:
    """Return the executor *name* with *workers* workers; *address* is that of a Ray cluster."""
    from advdiff_sumo.sweep.executors import ProcessExecutor, SerialExecutor

    if address is not None and name is not flags.ExecutorName.ray:
        raise ConfigError("--ray-address goes with --executor ray; add it, or leave the address out")
    if name is flags.ExecutorName.serial:
        return SerialExecutor()
    if name is flags.ExecutorName.process:
        return ProcessExecutor(workers or 1, limits)
    from advdiff_sumo.sweep.job_plan import needed_nets
    from advdiff_sumo.sweep.on_ray import RayExecutor

    return RayExecutor(address, workers, limits, needed_nets(plan))


def _run_episodes(
    console: Console,
    plan: SweepPlan,
    store: Store,
    remaining: RemainingJobs,
    executor: Executor,
    retries: int,
) -> int:
    """Run the *remaining* episodes with a progress bar; return how many are missing afterwards."""
    from advdiff_sumo.sweep.sweep_runner import EpisodeCount, run_sweep

    with Bars(console) as bars:
        bars.begin("episodes", remaining.total, remaining.done)
        return run_sweep(plan, store, remaining, executor, retries, EpisodeCount(bars.step).on_episode)


def _print_estimate(
    console: Console, plan: SweepPlan, remaining: RemainingJobs, workers: int, limits: WorkerLimits
) -> None:
    """Print the number of *remaining* episodes, and how long they will take, measured on a few of them."""
    from advdiff_sumo.cli.sweep_results import duration
    from advdiff_sumo.sweep.executors import ProcessExecutor
    from advdiff_sumo.sweep.time_estimate import estimate

    size = f"{counted(plan.episode_count, 'episode')} in {counted(len(plan.cells), 'run')}"
    console.print(f"{size}; {remaining.total - remaining.done} to do")
    with ProcessExecutor(1, limits) as executor:
        expected = estimate(plan, remaining.ahead(plan), executor)
    if expected is not None:
        console.print(
            f"about {duration(expected.total_s(workers))} on {counted(workers, 'worker')} with a core each: "
            f"{expected.batches} × {expected.scene_s:.1f} s for seed scenes, "
            f"{expected.episodes} × {expected.episode_s:.1f} s for episodes (measured just now)",
            soft_wrap=True,
        )
