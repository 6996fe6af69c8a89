"""A warm-up in a process of its own, so that a planner that crashes, hangs or leaves is told so."""

from __future__ import annotations

import contextlib
import json
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

Tell = Callable[[int], None]
_LOOK_S = 0.5  # between looks at how many plans are made


def warm_up_in_worker(
    options: RunOptions,
    steps: int,
    out: Path,
    licence: str | None,
    limits: WorkerLimits,
    episode_s: float,
    tell: Tell,
    hear: Callable[[str], None],
) -> list[str]:
    """Write what a warm-up learns to *out*, and return what there is to say of it, a line each.

    Args:
        options: of a run, with its background.
        steps: plans to learn from.
        out: the file.
        licence: "reckless" refits the reward model; else it is learnt which encounters break the target.
        limits: of the worker.
        episode_s: longest time for one episode, in seconds of the clock; may be infinite.
        tell: called with the plans made, now and then.
        hear: called with what the planner printed.

    Raises:
        InputError: the target or background cannot be made, or the background has nothing to learn.
        EpisodeFailure: the planner fails again and again, ends its process, or takes too long.
    """
    count = limits.logs / "plans"
    learn = _refit_reward if licence == "reckless" else _learn_failures
    call = partial(_learnt, learn, options, steps, out, count, episode_s)
    with _told(count, tell):
        outcome = call_in_worker("warm-up", call, limits, hear)
    failed = outcome.failed
    if failed is None:
        lines: list[str] = json.loads(outcome.product[0])
        return lines
    problem = f"an episode took longer than {episode_s:g} s" if failed.kind == "timeout" else failed.message
    raise EpisodeFailure(f"warm-up of {options.target}: {problem}{crashed_at(failed.log_tail)}")


@contextlib.contextmanager
def _told(count: Path, tell: Tell) -> Iterator[None]:
    """Tell for a block what a worker writes to *count*."""
    over = threading.Event()

    def look() -> None:
        while not over.wait(_LOOK_S):
            with contextlib.suppress(OSError, ValueError):  # not there yet, or just being written
                tell(int(count.read_text()))

    thread = threading.Thread(target=look, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _learnt(
    learn: Callable[[RunOptions, int, Path, Tell], list[str]],
    options: RunOptions,
    steps: int,
    out: Path,
    count: Path,
    episode_s: float,
) -> bytes:
    """Warm up in this process, which ends itself, and says where it is stuck, once an episode takes too long."""

    def tell(plans: int) -> None:
        count.write_text(str(plans))
        end_after(episode_s)

    tell(0)
    return json.dumps(learn(options, steps, out, tell)).encode()


def _learn_failures(options: RunOptions, steps: int, out: Path, tell: Tell) -> list[str]:
    from advdiff_sumo.experiments.failure_warmup import (
        header,
        failure_probabilities,
        warm_up_failures,
    )  # late: the worker's
    from advdiff_sumo.models.failure_predictor import save_failures

    done = warm_up_failures(options, steps, tell)
    save_failures(done.predictor, out, header(options, done))
    met = f"{counted(len(done.outcomes), 'encounter')}, {counted(done.failures, 'valid failure')}"
    likely = ", ".join(f"{kind} {share:.0%}" for kind, share in failure_probabilities(done.predictor).items())
    return [
        f"{counted(done.plans, 'plan')} in {counted(done.episodes, 'episode')}, {met}",
        f"expected to fail in: {likely}",
        f"use it with run --background {options.background} --reward {out}",
    ]


def _refit_reward(options: RunOptions, steps: int, out: Path, tell: Tell) -> list[str]:
    from advdiff_sumo.experiments.warmup_run import description, warm_up  # late: the worker's
    from advdiff_sumo.models.reward import save_reward

    done = warm_up(options, steps, tell)
    save_reward(done.reward, out, description(options, done))
    early, late = done.losses[: len(done.losses) // 2], done.losses[len(done.losses) // 2 :]
    return [
        f"{counted(done.steps, 'plan')} in {counted(done.episodes, 'episode')}, {counted(done.contacts, 'collision')}; "
        f"loss {fmean(early or late):.4f} → {fmean(late):.4f}",
        f"reward model: {out}  ·  use it with run --background diffusion --licence reckless --reward {out}",
    ]
