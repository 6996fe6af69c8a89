"""The prior over planners, fitted to an invented population with known variances."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.models.failure_predictor import sigmoid

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from failure_prior import fit_prior


def population(planners: int, seed: int = 0) -> list[tuple[FloatArray, FloatArray]]:
    """Return encounters of planners that differ only in the third feature: half of them fail if it is 1."""
    rng = np.random.default_rng(seed)
    met = []
    for number in range(planners):
        flags = np.eye(2)[rng.integers(0, 2, 40)]
        x = np.column_stack((flags, rng.integers(0, 2, 40), rng.normal(size=40)))
        logit = -3.0 + (6.0 * x[:, 2] if number % 2 else 0.0)
        met.append((x, (rng.random(40) < sigmoid(logit)).astype(float)))
    return met


def test_the_feature_in_which_planners_differ_has_the_largest_variance() -> None:
    prior = fit_prior(population(30), 2, -3.0)
    assert np.argmax(np.diag(prior.covariance)) == 2
    assert prior.mean[:2] == pytest.approx([-3.0, -3.0], abs=1.0)


def test_one_encounter_tells_which_planner_it_is() -> None:
    """An encounter with the third feature changes predictions for all kinds, but only for that feature."""
    prior = fit_prior(population(30), 2, -3.0)
    met, like, unlike = (np.array([row]) for row in ([1.0, 0, 1, 0], [0.0, 1, 1, 0], [1.0, 0, 0, 0]))
    failed, resolved = prior.adapted(met, np.ones(1)), prior.adapted(met, np.zeros(1))
    assert 0.35 < prior.probability(like)[0] < 0.6  # half of the planners
    assert failed.probability(like)[0] > 1.25 * prior.probability(like)[0]
    assert resolved.probability(like)[0] < 0.75 * prior.probability(like)[0]
    assert failed.probability(unlike)[0] < 0.2


def test_the_mean_encounter_of_each_kind() -> None:
    x = np.array([[1.0, 0.0, 0.0, 4.0], [1.0, 0.0, 1.0, 2.0]])
    prior = fit_prior([(x, np.zeros(2))], 2, -3.0)
    assert prior.typical.tolist() == [[1.0, 0.0, 0.5, 3.0], [0.0, 1.0, 0.5, 3.0]]


def test_the_same_encounters_give_the_same_bytes() -> None:
    first, second = (fit_prior(population(5), 2, -3.0) for _ in range(2))
    assert first.covariance.tobytes() == second.covariance.tobytes()


def test_nothing_to_learn_from() -> None:
    with pytest.raises(ValueError, match="no encounter"):
        fit_prior([], 2, -3.0)
