"""The training example: statistics of returns against values worked by hand, and one tiny run."""

from __future__ import annotations

import csv
import importlib
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

pytest.importorskip("stable_baselines3", reason="pip install 'advdiff-sumo[rl]'")

EXAMPLE = Path(__file__).parents[2] / "examples/train_target.py"


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(EXAMPLE.parent)
    return importlib.import_module("train_target")


@pytest.fixture
def ended(example: ModuleType) -> Callable[..., Any]:
    """Return a function (step, return) → finished episode."""
    return lambda step, reward: example.EpisodeReturn(step, reward, 10, "horizon")


def test_the_first_and_the_last_tenth(example: ModuleType, ended: Callable[..., Any]) -> None:
    episodes = [ended(step, 0.0) for step in (10, 100, 101, 900, 901, 1000)]
    first, last = example.tenths(episodes, 1000)
    assert [episode.step for episode in first] == [10, 100]
    assert [episode.step for episode in last] == [901, 1000]


def test_a_mean_and_its_interval_by_hand(example: ModuleType, ended: Callable[..., Any]) -> None:
    mean, half = example.mean_interval([ended(1, reward) for reward in (1.0, 2.0, 3.0, 6.0)])
    assert mean == 3.0
    assert half == pytest.approx(1.96 * (14.0 / 3.0) ** 0.5 / 2.0)


@pytest.mark.nightly
@pytest.mark.slow
def test_a_tiny_training_leaves_policy_tables_and_curve(tmp_path: Path) -> None:
    words = ("--steps", "64", "--workers", "2", "--net", "motorway", "--evaluate", "2", "--out", "out")
    done = subprocess.run(
        [sys.executable, EXAMPLE, *words], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "64 steps: mean return" in done.stdout
    assert (tmp_path / "out/policy.zip").stat().st_size > 10_000
    assert (tmp_path / "out/curve.png").read_bytes().startswith(b"\x89PNG")
    with (tmp_path / "out/evaluation.csv").open() as file:
        assert [row["policy"] for row in csv.DictReader(file)] == ["random"] * 2 + ["trained"] * 2
