"""The prior over planners of ``models.failure_predictor``: hierarchical logistic regression, by EM."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.models.failure_predictor import FailurePredictor, posterior

ROUNDS = 60
"""Of EM; the prior has settled by then."""
_VARIANCE, _WORTH = 9.0, 18.0
"""Variance of a coefficient among planners where nothing is known, and how many planners that counts for."""
_MEAN_VARIANCE = 4.0
"""Variance of the mean coefficients."""


def fit_prior(
    met: Sequence[tuple[FloatArray, FloatArray]], kinds: int, intercepts: float
) -> FailurePredictor:
    """Return the prior that explains what P planners did.

    Each has its own coefficients, from one Gaussian; EM with Laplace's approximation in its E-step (Breslow and
    Clayton 1993, doi:10.1080/01621459.1993.10594284), and a conjugate prior on mean and covariance, so that few
    planners suffice. Deterministic.

    Args:
        met: features (N, D) and outcomes (N,) of each planner.
        kinds: the first so many features are flags of kinds.
        intercepts: expected coefficient of these flags where nothing is known.

    Raises:
        ValueError: nobody met anything.
    """
    features = np.concatenate([x for x, _ in met]) if met else np.zeros((0, 0))
    if not len(features):
        raise ValueError("no encounter to learn from")
    count = features.shape[1]
    centre = np.where(np.arange(count) < kinds, intercepts, 0.0)
    mean, covariance = centre, _VARIANCE * np.eye(count)
    for _ in range(ROUNDS):
        own = [posterior(mean, covariance, x, y) for x, y in met]
        precision = np.linalg.inv(covariance)
        lead = np.eye(count) / _MEAN_VARIANCE
        modes = np.array([mode for mode, _ in own])
        mean = np.linalg.solve(len(own) * precision + lead, precision @ modes.sum(axis=0) + lead @ centre)
        spread = sum((c + np.outer(m - mean, m - mean) for m, c in own), np.zeros((count, count)))
        covariance = (spread + _WORTH * _VARIANCE * np.eye(count)) / (len(own) + _WORTH)
    return FailurePredictor(mean, covariance, _typical(features, kinds))


def _typical(features: FloatArray, kinds: int) -> FloatArray:
    """Return (K, D) mean features of each kind; of one that nobody met, those of all."""
    rows = [features[:, k] == 1.0 for k in range(kinds)]
    means = [features[of].mean(axis=0) if of.any() else features.mean(axis=0) for of in rows]
    out = np.array(means)
    out[:, :kinds] = np.eye(kinds)
    return out
