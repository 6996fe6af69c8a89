"""The belief about a planner's failures: worked by hand in one dimension, and what must hold in any."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.core.errors import WeightsError
from advdiff_sumo.models.failure_predictor import (
    FailurePredictor,
    load_failures,
    posterior,
    save_failures,
    sigmoid,
)
from advdiff_sumo.models.stored import write_stored

ONE = np.ones((1, 1))


def predictor(mean: list[float], variance: float = 1.0) -> FailurePredictor:
    count = len(mean)
    return FailurePredictor(np.array(mean), variance * np.eye(count), np.eye(1, count))


def test_one_failure_in_one_dimension() -> None:
    """Prior N(0, 1), one failure: the mode solves m = 1 − σ(m), m = 0.4011; curvature 1 + σ(m)(1 − σ(m)) = 1.2402."""
    mode, covariance = posterior(np.zeros(1), ONE, ONE, np.ones(1))
    assert mode[0] == pytest.approx(0.40106, abs=1e-5)
    assert covariance[0, 0] == pytest.approx(1.0 / 1.24021, abs=1e-5)


def test_an_outcome_that_was_expected_moves_nothing() -> None:
    mode, covariance = posterior(np.zeros(1), ONE, ONE, np.array([0.5]))
    assert mode[0] == pytest.approx(0.0, abs=1e-12)
    assert covariance[0, 0] == pytest.approx(0.8)  # 1 / (1 + 0.25): it is surer all the same


def test_what_is_not_known_does_not_count() -> None:
    """Logit 2: σ(2) = 0.8808, however sure it is."""
    for variance in (1e-12, 9.0):
        assert predictor([2.0], variance).probability(ONE)[0] == pytest.approx(0.88080, abs=1e-5)


def test_a_lasting_failure_converges() -> None:
    """A hundred failures where none was expected: far from the prior, the gradient still vanishes."""
    x, y = np.ones((100, 1)), np.ones(100)
    mode, _ = posterior(np.array([-8.0]), ONE, x, y)
    assert (100.0 * (1.0 - sigmoid(mode)) - (mode + 8.0))[0] == pytest.approx(0.0, abs=1e-6)


@given(st.lists(st.tuples(*[st.floats(-2.0, 2.0)] * 3), min_size=1, max_size=6), st.integers(0, 5))
def test_a_failure_makes_failures_of_its_kind_likelier(rows: list[tuple[float, ...]], which: int) -> None:
    """And a calm answer less likely; other encounters have their prior where they share no feature."""
    features = np.array(rows)
    calm, failed = np.zeros(len(features)), np.zeros(len(features))
    failed[which % len(features)] = 1.0
    prior = predictor([-1.0, 0.5, 0.0])
    at = features[which % len(features)]
    after = [prior.adapted(features, came).mean @ at for came in (calm, failed)]
    assert after[0] <= after[1] + 1e-9
    aside = prior.adapted(features * np.array([1.0, 1.0, 0.0]), failed)
    assert aside.mean[2] == pytest.approx(0.0, abs=1e-9)


def test_the_order_of_encounters_does_not_matter() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(8, 3)), (rng.random(8) < 0.5).astype(float)
    prior = predictor([-1.0, 0.0, 1.0])
    assert prior.adapted(x, y).mean == pytest.approx(prior.adapted(x[::-1], y[::-1]).mean, abs=1e-9)


def test_a_file_and_back(tmp_path: Path) -> None:
    first, second = tmp_path / "a.safetensors", tmp_path / "b.safetensors"
    kept = predictor([1.0, -2.0])
    for path in (first, second):
        save_failures(kept, path, {"target": "x", "net": "y"})
    assert first.read_bytes() == second.read_bytes()
    again = load_failures(first, 2)
    assert all(np.array_equal(getattr(again, name), value) for name, value in vars(kept).items())


def test_files_that_are_none_of_it(tmp_path: Path) -> None:
    path = tmp_path / "p.safetensors"
    with pytest.raises(WeightsError, match="no such file"):
        load_failures(path, 2)
    save_failures(predictor([1.0, -2.0]), path)
    with pytest.raises(WeightsError, match="for other features of encounters; warm up again"):
        load_failures(path, 3)
    save_failures(replace(predictor([1.0, -2.0]), typical=np.eye(3)), path)
    with pytest.raises(WeightsError, match="for other features"):
        load_failures(path, 2)
    write_stored(path, {}, {"format": "advdiff-reward-1"})
    with pytest.raises(WeightsError, match="is not of the format advdiff-failures-1"):
        load_failures(path, 2)
