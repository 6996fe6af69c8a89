"""Runs a warm-up in a process of its own, so that a planner that crashes, hangs or exits gives a clear error."""

from __future__ import annotations

import contextlib
import json
import shlex
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from statistics import fmean

from advdiff_sumo.core.errors import EpisodeFailure
from advdiff_sumo.core.plug_in_source import crashed_at
from advdiff_sumo.core.wording import counted
from advdiff_sumo.sim.run_episodes import RunOptions
from advdiff_sumo.sweep.executors import call_in_worker
from advdiff_sumo.sweep.tasks import WorkerLimits
from advdiff_sumo.sweep.worker_sandbox import end_after

ProgressListener = Callable[[int], None]
_POLL_S = 0.5  # interval between readings of the number of plans


def warm_up_in_worker(
    options: RunOptions,
    steps: int,
    out: Path,
    licence: str | None,
    limits: WorkerLimits,
    episode_s: float,
    on_progress: ProgressListener,
    on_output: Callable[[str], None],
) -> list[str]:
    """Run a warm-up, write its result to *out*, and return a summary as lines of text.

    Args:
        options: of a run, with its background.
        steps: number of plans to learn from.
        out: the file.
        licence: "reckless": the reward model is refitted. Others: the encounters in which the target fails are learnt.
        limits: of the worker.
        episode_s: longest wall-clock time of one episode; may be infinite.
        on_progress: called repeatedly with the number of plans so far.
        on_output: called with what the planner printed.

    Raises:
        InputError: the target or background cannot be made, or the background has nothing to learn.
        EpisodeFailure: the planner fails in several episodes in a row, ends its process, or takes too long.
    """
    count_file = limits.logs / "plans"
    learn = _refit_reward if licence == "reckless" else _learn_failures
    call = partial(_learn_in_process, learn, options, steps, out, count_file, episode_s)
    with _progress_polled(count_file, on_progress):
        outcome = call_in_worker("warm-up", call, limits, on_output)
    failed = outcome.failed
    if failed is None:
        lines: list[str] = json.loads(outcome.product[0])
        return lines
    problem = f"an episode took longer than {episode_s:g} s" if failed.kind == "timeout" else failed.message
    raise EpisodeFailure(f"warm-up of {options.target}: {problem}{crashed_at(failed.log_tail)}")


@contextlib.contextmanager
def _progress_polled(count_file: Path, on_progress: ProgressListener) -> Iterator[None]:
    """Within the ``with`` block, call *on_progress* with the number that a worker writes to *count_file*."""
    is_over = threading.Event()

    def poll() -> None:
        while not is_over.wait(_POLL_S):
            with contextlib.suppress(OSError, ValueError):  # not there yet, or just being written
                on_progress(int(count_file.read_text()))

    thread = threading.Thread(target=poll, daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


def _learn_in_process(
    learn: Callable[[RunOptions, int, Path, ProgressListener], list[str]],
    options: RunOptions,
    steps: int,
    out: Path,
    count_file: Path,
    episode_s: float,
) -> bytes:
    """Run the warm-up in this process, which prints its stack and exits if an episode takes longer than *episode_s*."""

    def on_progress(plans: int) -> None:
        count_file.write_text(str(plans))
        end_after(episode_s)

    on_progress(0)
    return json.dumps(learn(options, steps, out, on_progress)).encode()


def _learn_failures(options: RunOptions, steps: int, out: Path, on_progress: ProgressListener) -> list[str]:
    from advdiff_sumo.experiments.failure_warmup import (
        failure_probabilities,
        header,
        warm_up_failures,
    )  # late: the worker's
    from advdiff_sumo.models.failure_predictor import save_failures

    result = warm_up_failures(options, steps, on_progress)
    save_failures(result.predictor, out, header(options, result))
    encounters = f"{counted(len(result.outcomes), 'encounter')}, {counted(result.failures, 'valid failure')}"
    probabilities = ", ".join(
        f"{kind} {share:.0%}" for kind, share in failure_probabilities(result.predictor).items()
    )
    return [
        f"{counted(result.plans, 'plan')} in {counted(result.episodes, 'episode')}, {encounters}",
        f"expected to fail in: {probabilities}",
        f"use it with run --background {options.background} --reward {shlex.quote(str(out))}",
    ]


def _refit_reward(options: RunOptions, steps: int, out: Path, on_progress: ProgressListener) -> list[str]:
    from advdiff_sumo.experiments.warmup_run import description, warm_up  # late: the worker's
    from advdiff_sumo.models.reward import save_reward

    result = warm_up(options, steps, on_progress)
    save_reward(result.reward, out, description(options, result))
    half = len(result.losses) // 2
    early_losses, late_losses = result.losses[:half], result.losses[half:]
    plans = f"{counted(result.steps, 'plan')} in {counted(result.episodes, 'episode')}"
    return [
        f"{plans}, {counted(result.contacts, 'collision')}; "
        f"loss {fmean(early_losses or late_losses):.4f} → {fmean(late_losses):.4f}",
        f"reward model: {out}  ·  use it with run --background diffusion --licence reckless "
        f"--reward {shlex.quote(str(out))}",
    ]
