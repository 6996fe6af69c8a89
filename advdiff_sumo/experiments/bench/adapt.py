"""Adapts policies to a planner: by a warm-up (ours), or with the planner as the rivals' surrogate."""

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
        target: the tested planner, as registered.
        target_options: of it.
        seed: number of the warm-up; it also selects the shipped net, in turn.
        marks: numbers of plans after which the result is saved.
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
        """Return the file of the result after *mark* plans: Q, or under a licence the failure predictor."""
        options = (*sorted(self.target_options.items()), *sorted(self.background_options.items()))
        suffix = "".join(f"-{key}={value}" for key, value in options)
        name = f"{self.target}{suffix}-h{self.horizon_s:g}-s{self.seed}-{mark:04d}.safetensors"
        return folder / name.replace("/", "_")

    def missing(self, folder: Path) -> bool:
        """Return whether a result is missing in *folder*."""
        return not all(self.path(folder, mark).is_file() for mark in self.marks)


def adapt(
    adaptations: Sequence[Adaptation],
    folder: Path,
    workers: int,
    limits: WorkerLimits,
    reporter: ProgressReporter,
) -> None:
    """Run the warm-ups that *folder* lacks, on seed scenes that no table uses.

    Args:
        adaptations: all of them.
        folder: of the results.
        workers: number of processes.
        limits: of an episode; a warm-up may take as long as the episodes it consists of.
        reporter: shows the progress.

    Raises:
        InputError: a target cannot be made.
        EpisodeFailure: a target fails in several episodes in a row, ends its process, or takes too long.
    """
    folder.mkdir(parents=True, exist_ok=True)
    missing = [adaptation for adaptation in adaptations if adaptation.missing(folder)]
    missing = list(
        {adaptation.path(folder, adaptation.marks[-1]): adaptation for adaptation in missing}.values()
    )
    reporter.begin("warm-ups", len(adaptations), len(adaptations) - len(missing))
    episodes = max(map(_episodes, missing), default=1)
    warm_up_limits = replace(limits, timeout_s=episodes * limits.timeout_s)
    tasks = [CallTask(str(k), partial(_warm_up, adaptation, folder)) for k, adaptation in enumerate(missing)]
    with ProcessExecutor(workers, warm_up_limits) as executor:
        for outcome in outcomes(tasks, executor):
            _raise_failure(missing[int(outcome.key)], outcome)
            reporter.step()


def _episodes(adaptation: Adaptation) -> int:
    """Return one more than the least number of episodes of a warm-up."""
    return 1 + math.ceil(sum(adaptation.marks) * MODEL_STEP_S / adaptation.horizon_s)


def _raise_failure(adaptation: Adaptation, outcome: Outcome) -> None:
    failed = outcome.failed
    if failed is None:
        return
    kind = ConfigError if failed.is_unusable else EpisodeFailure
    stuck_at = crashed_at(failed.log_tail)
    raise kind(f"warm-up of {adaptation.target}, number {adaptation.seed}: {failed.message}{stuck_at}")


def surrogate_options(source: str) -> dict[str, Any]:
    """Return the option that makes AdvSim and Strive plan against *source*."""
    return {"surrogate": source if source == "lane_graph" else TARGETS.builtins.get(source, source)}


def _warm_up(adaptation: Adaptation, folder: Path) -> bytes:
    """Run a warm-up and write its results into *folder*; the returned bytes are empty."""
    options = RunOptions(
        net=SHIPPED_NETS[adaptation.seed % len(SHIPPED_NETS)],
        target=adaptation.target,
        target_options=dict(adaptation.target_options),
        background="diffusion",
        background_options=dict(adaptation.background_options),
        seed=TUNING_SEED + 1 + adaptation.seed,
        horizon_s=adaptation.horizon_s,
    )
    if adaptation.background_options.get("licence") != "reckless":
        _learn_failures(adaptation, options, folder)
        return b""
    from advdiff_sumo.experiments.warmup_run import description, warm_up  # late: the worker alone needs it

    marks = adaptation.marks
    models = {}
    result = warm_up(options, marks[-1], lambda _: None, marks, lambda mark, q: models.update({mark: q}))
    header = description(options, result)
    for mark in marks:
        save_reward(models[mark], adaptation.path(folder, mark), {**header, "steps": mark})
    return b""


def _learn_failures(adaptation: Adaptation, options: RunOptions, folder: Path) -> None:
    """Learn under a licence in which encounters the target fails; each mark starts again with the same episodes."""
    from advdiff_sumo.experiments.failure_warmup import EPISODE_S, header, warm_up_failures  # late: as above
    from advdiff_sumo.models.failure_predictor import save_failures

    options = options.model_copy(update={"horizon_s": min(adaptation.horizon_s, EPISODE_S)})
    for mark in adaptation.marks:
        result = warm_up_failures(options, mark, lambda _: None)
        save_failures(result.predictor, adaptation.path(folder, mark), header(options, result))
