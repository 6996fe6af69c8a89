"""Makes the samples of the closed-loop tables' cells from finished episodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.experiments.bench.episode_results import EpisodeResult
from advdiff_sumo.experiments.bench.intervals import Divergence, Ratio, Sample, aligned_samples

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
        cumulated = np.cumsum(times[:, order], axis=1)
        median_index = (cumulated >= 0.5 * cumulated[:, -1:]).argmax(axis=1)
        return np.asarray(1.0 / self.plan_s[order][median_index])

    def rows(self, rows: IntArray) -> Rates:
        """Return the sample of the scenes at *rows*."""
        return Rates(tuple(self.scenes[k] for k in rows.tolist()), self.plan_s[rows])


def collision_samples(results: Sequence[EpisodeResult]) -> dict[str, Sample]:
    """Return the samples of collision rate, speed at contact, comfort, fault, solvability and visibility."""
    collisions = [result for result in results if result.row["target_collision"]]
    return {
        "collision_rate": _rate(results, lambda row: bool(row["target_collision"])),
        "collision_mps": _mean(collisions, "relative_speed_mps"),
        "accel_mps2": _mean(results, "accel_max_mps2"),
        "jerk_mps3": _mean(results, "jerk_max_mps3"),
        "fault_rate": _rate(collisions, lambda row: row["at_fault"] == "target"),
        "solvable_rate": _shares([(result.scene, result.trace.solvable) for result in collisions]),
        "seen_rate": _rate(
            [result for result in collisions if result.row["collision_partner"] is not None],
            lambda row: row["attacker_visible"] is not False,
        ),
    }


def background_samples(
    results: Sequence[EpisodeResult], natural: Sequence[EpisodeResult], plans: bool = True
) -> dict[str, Sample]:
    """Return the samples of the background's plausibility and of its plans per second.

    Args:
        results: its episodes.
        natural: episodes of the same scenes in SUMO's traffic.
        plans: whether the background plans anything.
    """
    scenes = tuple(result.scene for result in results)
    vehicles = np.array([result.trace.vehicles for result in results], dtype=np.float64)
    collided = np.array([result.trace.hit for result in results], dtype=np.float64)
    has_moved = np.array([result.trace.off_road is not None for result in results], dtype=np.bool_)
    counts = has_moved | (not plans)  # a policy is not rated by episodes in which it moved no vehicle
    samples: dict[str, Sample] = {
        "veh_rate": Ratio(scenes, np.where(counts, collided, 0.0), np.where(counts, vehicles, 0.0), rate=True)
    }
    if has_moved.any():
        off_road = np.array([result.trace.off_road or 0 for result in results], dtype=np.float64)
        samples["env_rate"] = Ratio(scenes, off_road, np.where(has_moved, vehicles, 0.0), rate=True)
    nats = np.array([result.trace.nats for result in results])
    samples["nats"] = Ratio(scenes, nats, np.array([result.trace.seconds for result in results]))
    if natural and natural is not results:
        samples["jsd"] = divergence_from_natural(results, natural)
    planned = [(result.scene, result.plan_s) for result in results if result.plan_s is not None and plans]
    if planned:
        samples["hz"] = Rates(
            tuple(scene for scene, _ in planned), np.array([plan_s for _, plan_s in planned])
        )
    return samples


def divergence_from_natural(results: Sequence[EpisodeResult], natural: Sequence[EpisodeResult]) -> Divergence:
    """Return the divergence of speeds, accelerations and times to collision from those of *natural* traffic."""
    observed, reference = aligned_samples(_histograms(results), _histograms(natural))
    assert isinstance(observed, Divergence) and isinstance(reference, Divergence)  # noqa: S101, PT018 - for mypy
    return Divergence(observed.scenes, observed.counts, reference.counts)


def _histograms(results: Sequence[EpisodeResult]) -> Divergence:
    counts = tuple(
        np.array([getattr(result.trace, name) for result in results], dtype=np.float64)
        for name in _HISTOGRAMS
    )
    return Divergence(tuple(result.scene for result in results), counts)


def _rate(results: Sequence[EpisodeResult], happened: Callable[[Any], bool]) -> Ratio:
    flags = np.array([happened(result.row) for result in results], dtype=np.float64)
    return Ratio(tuple(result.scene for result in results), flags, np.ones(len(flags)), rate=True)


def _shares(values: Sequence[tuple[str, bool | None]]) -> Ratio:
    judged = [(scene, flag) for scene, flag in values if flag is not None]
    flags = np.array([flag for _, flag in judged], dtype=np.float64)
    return Ratio(tuple(scene for scene, _ in judged), flags, np.ones(len(flags)), rate=True)


def _mean(results: Sequence[EpisodeResult], column: str) -> Ratio:
    with_value = [result for result in results if result.row[column] is not None]
    values = np.array([float(result.row[column]) for result in with_value])
    return Ratio(tuple(result.scene for result in with_value), values, np.ones(len(values)))
