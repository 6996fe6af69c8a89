"""Warm-ups of benches, of planners that end their process, never come back, or cannot be made."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.core.errors import AdvdiffError, ConfigError, EpisodeFailure
from advdiff_sumo.experiments.bench.adapt import Adaptation, adapt
from advdiff_sumo.experiments.bench.reporter import Silent
from advdiff_sumo.sweep.tasks import WorkerLimits

PLANNERS = """
import os
import time


class Leaves:
    def __init__(self):
        os._exit(3)

    def start(self, road, scene, rng):
        return None

    def plan(self, road, scene, memory, rng):
        raise AssertionError


class NeverComesBack(Leaves):
    def __init__(self):
        time.sleep(3600.0)


class WantsMore(Leaves):
    def __init__(self):
        raise ValueError("no map of the moon")
"""


@pytest.mark.parametrize(
    ("kind", "timeout_s", "error", "words"),
    [
        ("Leaves", 600.0, EpisodeFailure, r"the worker ended with exit code 3"),
        ("NeverComesBack", 0.5, EpisodeFailure, r"not finished after 1 s"),
        ("WantsMore", 600.0, ConfigError, r".*no map of the moon"),
    ],
)
def test_a_planner_that_does_not_last_is_named_with_its_warm_up(
    kind: str,
    timeout_s: float,
    error: type[AdvdiffError],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An episode is enough for its one plan, and one more may be needed: twice the time of an episode."""
    (tmp_path / "short_lived_planners.py").write_text(PLANNERS)
    monkeypatch.syspath_prepend(tmp_path)
    limits = WorkerLimits(timeout_s, 0, 250, 0.5, tmp_path)
    target = f"short_lived_planners:{kind}"
    wanted = [Adaptation(target, {}, 2, (1,), 3.0, {"licence": "reckless"})]
    with pytest.raises(error, match=rf"warm-up of {target}, number 2: {words}"):
        adapt(wanted, tmp_path / "adapted", 1, limits, Silent())
