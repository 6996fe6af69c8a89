"""Estimate how long a sweep takes, by running some of its episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.sweep.executors import Executor, outcome_of
from advdiff_sumo.sweep.fingerprint import canonical_json, file_digest, net_files
from advdiff_sumo.sweep.job_plan import Job, SweepPlan
from advdiff_sumo.sweep.tasks import EpisodeTask, SceneTask

_PROBES = 6  # episodes that are run, at most


@dataclass(frozen=True)
class TimeEstimate:
    """Durations on one worker.

    Attributes:
        scene_s: mean time for the seed scenes of one batch.
        episode_s: mean time of one episode.
        batches: number of batches needed.
        episodes: number of episodes.
    """

    scene_s: float
    episode_s: float
    batches: int
    episodes: int

    def total_s(self, workers: int) -> float:
        """Return the wall-clock time with so many *workers*, each on a core of its own."""
        return (self.scene_s * self.batches + self.episode_s * self.episodes) / workers


def estimate(plan: SweepPlan, jobs: Sequence[Job], executor: Executor) -> TimeEstimate | None:
    """Run up to six episodes of different kinds, with their seed scenes; None if there are no *jobs*.

    Args:
        plan: the sweep.
        jobs: the episodes to estimate.
        executor: executor with one worker, already started.

    Raises:
        ConfigError: a seed scene cannot be made.
    """
    if not jobs:
        return None
    probes = _spread(list({_kind(plan, job): job for job in reversed(jobs)}.values()))
    scene_s: list[float] = []
    episode_s: list[float] = []
    scenes: dict[str, tuple[bytes, ...]] = {}
    for job in probes:
        options = plan.options(job)
        net = file_digest(*net_files(options.net))
        if job.batch not in scenes:
            batch = plan.batches[job.batch]
            outcome = outcome_of(SceneTask(**vars(batch), net_digest=net), executor)
            if outcome.failed is not None:
                raise ConfigError(f"{options.net}: {outcome.failed.message}")
            scenes[job.batch] = outcome.product
            scene_s.append(outcome.wall_s)
        if job.scene_index < len(scenes[job.batch]):
            task = EpisodeTask(job.key, options, job.number, scenes[job.batch][job.scene_index], net)
            outcome = outcome_of(task, executor)
            episode_s.append(outcome.wall_s)
    batches = len({job.batch for job in jobs})
    return TimeEstimate(_mean(scene_s), _mean(episode_s), batches, len(jobs))


def _kind(plan: SweepPlan, job: Job) -> str:
    """Return a text that is equal for episodes of the same net, target and background."""
    options = plan.options(job)
    names = (options.net, options.target, options.background)
    return canonical_json([*names, options.target_options, options.background_options])


def _spread(jobs: list[Job]) -> list[Job]:
    """Return up to six of *jobs*, evenly spaced."""
    jobs.sort(key=lambda job: job.index)
    step = max(1.0, len(jobs) / _PROBES)
    return [jobs[int(k * step)] for k in range(min(_PROBES, len(jobs)))]


def _mean(values: list[float]) -> float:
    return sum(values) / len(values) if values else 0.0
