"""Estimates how long a bench will take, from short trial episodes of each background."""

from __future__ import annotations

from dataclasses import dataclass

from advdiff_sumo.experiments.bench.cells import BenchCell, BenchCells
from advdiff_sumo.sweep.executors import ProcessExecutor, outcome_of
from advdiff_sumo.sweep.fingerprint import file_digest, net_files
from advdiff_sumo.sweep.job_plan import Job
from advdiff_sumo.sweep.tasks import EpisodeTask, SceneTask, WorkerLimits

_SHORT_TRIAL_S, _LONG_TRIAL_S = 3.0, 9.0  # lawful attacks, which cost most, begin after 3 s
_TRACE_S = 0.4
MIN_EPISODES = 40
"""Fewer episodes are not worth an estimate."""


@dataclass(frozen=True)
class TimeForecast:
    """Expected time of the remaining work, on one worker.

    Attributes:
        scenes_s: for the seed scenes.
        episodes_s: for the episodes and what is computed from them.
        by_background: seconds for one episode, by ``BenchCell.like`` or row.
    """

    scenes_s: float
    episodes_s: float
    by_background: dict[str, float]

    def total_s(self, workers: int) -> float:
        """Return the wall-clock time on this number of workers with a core each."""
        return (self.scenes_s + self.episodes_s) / workers


def forecast(
    cells: BenchCells, remaining_jobs: tuple[Job, ...], horizon_s: float, limits: WorkerLimits
) -> TimeForecast | None:
    """Run three trial episodes of each background and extrapolate their times.

    The first trial loads the networks and is not used. The others have two lengths.

    Returns:
        The forecast; None if few episodes are left, or if no seed scene can be made.
    """
    remaining = {job.key for job in remaining_jobs}
    jobs_by_kind: dict[str, list[tuple[BenchCell, Job]]] = {}
    for cell, job in cells.jobs():
        if job.key in remaining:
            jobs_by_kind.setdefault(cell.like or cell.row, []).append((cell, job))
    if len(remaining) < MIN_EPISODES:
        return None
    with ProcessExecutor(1, limits) as executor:
        batch = cells.plan.batches[remaining_jobs[0].batch]
        net = file_digest(*net_files(batch.options.net))
        outcome = outcome_of(SceneTask(**vars(batch), net_digest=net), executor)
        if outcome.failed is not None:
            return None
        episode_s = {}
        for name, jobs in jobs_by_kind.items():
            options = cells.plan.options(jobs[0][1]).model_copy(update={"net": batch.options.net})
            wall_s = list[float]()
            for k, length_s in enumerate((_SHORT_TRIAL_S, _SHORT_TRIAL_S, _LONG_TRIAL_S)):
                trial_options = options.model_copy(update={"horizon_s": min(length_s, horizon_s)})
                key = f"{name}-{k}".replace("/", "_")
                wall_s.append(
                    outcome_of(EpisodeTask(key, trial_options, k, outcome.product[0], net), executor).wall_s
                )
            episode_s[name] = _extrapolated(wall_s[1], wall_s[2], horizon_s) + _TRACE_S
    batches = len({job.batch for job in remaining_jobs})
    total_s = sum(episode_s[name] * len(jobs) for name, jobs in jobs_by_kind.items())
    return TimeForecast(outcome.wall_s * batches, total_s, episode_s)


def _extrapolated(short_s: float, long_s: float, horizon_s: float) -> float:
    """Return the time of an episode of *horizon_s*, extrapolated linearly from the times of the two trials."""
    rest_s = max(horizon_s - _LONG_TRIAL_S, 0.0)
    return long_s + max(long_s - short_s, 0.0) / (_LONG_TRIAL_S - _SHORT_TRIAL_S) * rest_s
