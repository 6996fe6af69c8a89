"""How long a bench will take: each background is tried for some seconds before the first episode counts."""

from __future__ import annotations

from dataclasses import dataclass

from advdiff_sumo.experiments.bench.cells import BenchCell, BenchCells
from advdiff_sumo.sweep.executors import ProcessExecutor, outcome_of
from advdiff_sumo.sweep.fingerprint import file_digest, net_files
from advdiff_sumo.sweep.job_plan import Job
from advdiff_sumo.sweep.tasks import EpisodeTask, SceneTask, WorkerLimits

_SHORT_S, _LONG_S = 3.0, 9.0  # lawful attacks, which cost most, begin after 3 s
_TRACE_S = 0.4
FEW = 40
"""So few episodes are not worth an estimate."""


@dataclass(frozen=True)
class TimeForecast:
    """Expected time of what is left, on one worker.

    Attributes:
        scenes_s: for the seed scenes.
        episodes_s: for the episodes, and what is computed from them.
        by_background: seconds an episode, by ``Contest.like`` or row.
    """

    scenes_s: float
    episodes_s: float
    by_background: dict[str, float]

    def total_s(self, workers: int) -> float:
        """Return the wall-clock on so many workers with a core each."""
        return (self.scenes_s + self.episodes_s) / workers


def forecast(
    cells: BenchCells, todo: tuple[Job, ...], horizon_s: float, limits: WorkerLimits
) -> TimeForecast | None:
    """Try short episodes of each background, of which the first loads its networks; from two lengths follows the rest.

    Returns:
        None where there is too little left, or where no seed scene can be made.
    """
    left = {job.key for job in todo}
    kinds: dict[str, list[tuple[BenchCell, Job]]] = {}
    for cell, job in cells.jobs():
        if job.key in left:
            kinds.setdefault(cell.like or cell.row, []).append((cell, job))
    if len(left) < FEW:
        return None
    with ProcessExecutor(1, limits) as executor:
        batch = cells.plan.batches[todo[0].batch]
        net = file_digest(*net_files(batch.options.net))
        outcome = outcome_of(SceneTask(**vars(batch), net_digest=net), executor)
        if outcome.failed is not None:
            return None
        episode_s = {}
        for name, jobs in kinds.items():
            options = cells.plan.options(jobs[0][1]).model_copy(update={"net": batch.options.net})
            tried_s = list[float]()
            for k, length_s in enumerate((_SHORT_S, _SHORT_S, _LONG_S)):
                trial = options.model_copy(update={"horizon_s": min(length_s, horizon_s)})
                key = f"{name}-{k}".replace("/", "_")
                tried_s.append(
                    outcome_of(EpisodeTask(key, trial, k, outcome.product[0], net), executor).wall_s
                )
            episode_s[name] = _extrapolated(tried_s[1], tried_s[2], horizon_s) + _TRACE_S
    batches = len({job.batch for job in todo})
    total = sum(episode_s[name] * len(jobs) for name, jobs in kinds.items())
    return TimeForecast(outcome.wall_s * batches, total, episode_s)


def _extrapolated(short_s: float, long_s: float, horizon_s: float) -> float:
    """Return the time of an episode of *horizon_s* by those of the two trials; the rest goes on as the long one did."""
    rest = max(horizon_s - _LONG_S, 0.0)
    return long_s + max(long_s - short_s, 0.0) / (_LONG_S - _SHORT_S) * rest
