"""Policies adapted to a planner: warm-up of Q (ours), or the planner as the rivals' surrogate."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from advdiff_sumo.core.errors import ConfigError, EpisodeFailure
from advdiff_sumo.core.plug_in_source import crashed_at
from advdiff_sumo.experiments.bench.reporter import ProgressReporter
from advdiff_sumo.experiments.bench.scene_list import TUNING_SEED
from advdiff_sumo.maps.shipped_nets import SHIPPED_NETS
from advdiff_sumo.models.model_options import MODEL_STEP_S
from advdiff_sumo.models.reward import save_reward
from advdiff_sumo.planners.planner_registry import TARGETS
from advdiff_sumo.sim.run_episodes import RunOptions
from advdiff_sumo.sweep.executors import ProcessExecutor, outcomes
from advdiff_sumo.sweep.tasks import CallTask, Outcome, WorkerLimits

Marks = tuple[int, ...]


@dataclass(frozen=True)
class Adaptation:
    """One warm-up.

    Attributes:
        target: what is met, as registered.
        target_options: of it.
        seed: number of the warm-up; it also decides on which shipped net, in turn.
        marks: plans after which what was learnt is kept.
        horizon_s: of its episodes.
        background_options: of the policy that is warmed up.
    """

    target: str
    target_options: Mapping[str, Any]
    seed: int
    marks: Marks
    horizon_s: float
    background_options: Mapping[str, Any] = field(default_factory=dict)

    def path(self, folder: Path, mark: int) -> Path:
        """Return where what was learnt in *mark* plans lies: Q, under a licence the belief about encounters."""
        options = (*sorted(self.target_options.items()), *sorted(self.background_options.items()))
        extra = "".join(f"-{key}={value}" for key, value in options)
        name = f"{self.target}{extra}-h{self.horizon_s:g}-s{self.seed}-{mark:04d}.safetensors"
        return folder / name.replace("/", "_")

    def missing(self, folder: Path) -> bool:
        """Return whether it is still to be made."""
        return not all(self.path(folder, mark).is_file() for mark in self.marks)


def adapt(
    wanted: Sequence[Adaptation], folder: Path, workers: int, limits: WorkerLimits, teller: ProgressReporter
) -> None:
    """Make the warm-ups that *folder* lacks, on seed scenes that no table uses.

    Args:
        wanted: all of them.
        folder: where what is learnt lies.
        workers: processes.
        limits: of an episode; a warm-up may take as long as the episodes that it is made of.
        teller: hears how far it is.

    Raises:
        InputError: a target cannot be made.
        EpisodeFailure: it fails again and again, ends its process, or takes too long.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lacking = list({one.path(folder, one.marks[-1]): one for one in wanted if one.missing(folder)}.values())
    teller.begin("warm-ups", len(wanted), len(wanted) - len(lacking))
    episodes = max(map(_episodes, lacking), default=1)
    longer = replace(limits, timeout_s=episodes * limits.timeout_s)
    tasks = [CallTask(str(k), partial(_warm_up, one, folder)) for k, one in enumerate(lacking)]
    with ProcessExecutor(workers, longer) as executor:
        for outcome in outcomes(tasks, executor):
            _must_be_made(lacking[int(outcome.key)], outcome)
            teller.step()


def _episodes(one: Adaptation) -> int:
    """Return how many episodes a warm-up is made of at least, and one more."""
    return 1 + math.ceil(sum(one.marks) * MODEL_STEP_S / one.horizon_s)


def _must_be_made(one: Adaptation, outcome: Outcome) -> None:
    failed = outcome.failed
    if failed is None:
        return
    kind = ConfigError if failed.is_unusable else EpisodeFailure
    stuck_at = crashed_at(failed.log_tail)
    raise kind(f"warm-up of {one.target}, number {one.seed}: {failed.message}{stuck_at}")


def surrogate_options(source: str) -> dict[str, Any]:
    """Return the option by which AdvSim and Strive expect *source* as their target."""
    return {"surrogate": source if source == "lane_graph" else TARGETS.builtins.get(source, source)}


def _warm_up(one: Adaptation, folder: Path) -> bytes:
    """Write what is learnt into *folder*; there is nothing else to return."""
    options = RunOptions(
        net=SHIPPED_NETS[one.seed % len(SHIPPED_NETS)],
        target=one.target,
        target_options=dict(one.target_options),
        background="diffusion",
        background_options=dict(one.background_options),
        seed=TUNING_SEED + 1 + one.seed,
        horizon_s=one.horizon_s,
    )
    if one.background_options.get("licence") != "reckless":
        _learn_failures(one, options, folder)
        return b""
    from advdiff_sumo.experiments.warmup_run import description, warm_up  # late: the worker alone needs it

    kept = {}
    done = warm_up(options, one.marks[-1], lambda _: None, one.marks, lambda mark, q: kept.update({mark: q}))
    header = description(options, done)
    for mark in one.marks:
        save_reward(kept[mark], one.path(folder, mark), {**header, "steps": mark})
    return b""


def _learn_failures(one: Adaptation, options: RunOptions, folder: Path) -> None:
    """Learn under a licence in which encounters the target fails; each mark begins anew with the same episodes."""
    from advdiff_sumo.experiments.failure_warmup import EPISODE_S, header, warm_up_failures  # late: as above
    from advdiff_sumo.models.failure_predictor import save_failures

    options = options.model_copy(update={"horizon_s": min(one.horizon_s, EPISODE_S)})
    for mark in one.marks:
        done = warm_up_failures(options, mark, lambda _: None)
        save_failures(done.predictor, one.path(folder, mark), header(options, done))
