"""From finished episodes to what the cells of the closed-loop tables are computed from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.experiments.bench.episode_results import EpisodeResult
from advdiff_sumo.experiments.bench.intervals import Divergence, Ratio, Sample, aligned

_HISTOGRAMS = ("speed", "accel", "ttc")


@dataclass(frozen=True)
class Rates:
    """Plans per second, from the median over the episodes' median times of a plan.

    Attributes:
        scenes: keys.
        plan_s: (S,) median time of a plan of the background.
    """

    scenes: tuple[str, ...]
    plan_s: FloatArray

    @property
    def n(self) -> int:
        """Number of episodes."""
        return len(self.scenes)

    def at(self, times: FloatArray) -> FloatArray:
        """Return plans per second for each draw."""
        order = np.argsort(self.plan_s, kind="stable")
        reached = np.cumsum(times[:, order], axis=1)
        middle = (reached >= 0.5 * reached[:, -1:]).argmax(axis=1)
        return np.asarray(1.0 / self.plan_s[order][middle])

    def rows(self, rows: IntArray) -> Rates:
        """Return the sample of the scenes at *rows*."""
        return Rates(tuple(self.scenes[k] for k in rows.tolist()), self.plan_s[rows])


def collision_samples(results: Sequence[EpisodeResult]) -> dict[str, Sample]:
    """Return collision rate, speed at contact, comfort, and whose fault and how visible collisions were."""
    hits = [one for one in results if one.row["target_collision"]]
    return {
        "collision_rate": _rate(results, lambda row: bool(row["target_collision"])),
        "collision_mps": _mean(hits, "relative_speed_mps"),
        "accel_mps2": _mean(results, "accel_max_mps2"),
        "jerk_mps3": _mean(results, "jerk_max_mps3"),
        "fault_rate": _rate(hits, lambda row: row["at_fault"] == "target"),
        "solvable_rate": _shares([(one.scene, one.trace.solvable) for one in hits]),
        "seen_rate": _rate(
            [one for one in hits if one.row["collision_partner"] is not None],
            lambda row: row["attacker_visible"] is not False,
        ),
    }


def background_samples(
    results: Sequence[EpisodeResult], natural: Sequence[EpisodeResult], plans: bool = True
) -> dict[str, Sample]:
    """Return how plausible the background was, and how fast it planned.

    Args:
        results: its episodes.
        natural: the same scenes' traffic without a policy.
        plans: whether it plans anything.
    """
    scenes = tuple(one.scene for one in results)
    vehicles = np.array([one.trace.vehicles for one in results], dtype=np.float64)
    hit = np.array([one.trace.hit for one in results], dtype=np.float64)
    moved = np.array([one.trace.off_road is not None for one in results], dtype=np.bool_)
    own = moved | (not plans)  # what SUMO's vehicles do where a policy moved nobody is not its doing
    samples: dict[str, Sample] = {
        "veh_rate": Ratio(scenes, np.where(own, hit, 0.0), np.where(own, vehicles, 0.0), rate=True)
    }
    if moved.any():
        off = np.array([one.trace.off_road or 0 for one in results], dtype=np.float64)
        samples["env_rate"] = Ratio(scenes, off, np.where(moved, vehicles, 0.0), rate=True)
    nats = np.array([one.trace.nats for one in results])
    samples["nats"] = Ratio(scenes, nats, np.array([one.trace.seconds for one in results]))
    if natural and natural is not results:
        samples["jsd"] = against(results, natural)
    times = [(one.scene, one.plan_s) for one in results if one.plan_s is not None and plans]
    if times:
        samples["hz"] = Rates(tuple(scene for scene, _ in times), np.array([s for _, s in times]))
    return samples


def against(results: Sequence[EpisodeResult], natural: Sequence[EpisodeResult]) -> Divergence:
    """Return the divergence of speeds, accelerations and times to collision from those of *natural*."""
    own, reference = aligned(_histograms(results), _histograms(natural))
    assert isinstance(own, Divergence) and isinstance(reference, Divergence)  # noqa: S101, PT018 - for mypy
    return Divergence(own.scenes, own.counts, reference.counts)


def _histograms(results: Sequence[EpisodeResult]) -> Divergence:
    counts = tuple(
        np.array([getattr(one.trace, name) for one in results], dtype=np.float64) for name in _HISTOGRAMS
    )
    return Divergence(tuple(one.scene for one in results), counts)


def _rate(results: Sequence[EpisodeResult], happened: Callable[[Any], bool]) -> Ratio:
    flags = np.array([happened(one.row) for one in results], dtype=np.float64)
    return Ratio(tuple(one.scene for one in results), flags, np.ones(len(flags)), rate=True)


def _shares(values: Sequence[tuple[str, bool | None]]) -> Ratio:
    known = [(scene, flag) for scene, flag in values if flag is not None]
    flags = np.array([flag for _, flag in known], dtype=np.float64)
    return Ratio(tuple(scene for scene, _ in known), flags, np.ones(len(flags)), rate=True)


def _mean(results: Sequence[EpisodeResult], column: str) -> Ratio:
    known = [one for one in results if one.row[column] is not None]
    values = np.array([float(one.row[column]) for one in known])
    return Ratio(tuple(one.scene for one in known), values, np.ones(len(values)))
