"""Fit the prior over planners of ``models.failure_predictor``: hierarchical logistic regression by EM."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.models.failure_predictor import FailurePredictor, posterior

ROUNDS = 60
"""Iterations of EM; the prior has converged by then."""
_VARIANCE, _PSEUDO_PLANNERS = 9.0, 18.0
"""Prior variance of a coefficient among planners, and the number of planners that this variance counts for."""
_MEAN_VARIANCE = 4.0
"""Prior variance of the mean coefficients."""


def fit_prior(
    met: Sequence[tuple[FloatArray, FloatArray]], kinds: int, intercepts: float
) -> FailurePredictor:
    """Return the prior fitted to the encounters of P planners.

    The coefficients of each planner are drawn from one Gaussian. EM estimates it, with Laplace's approximation in the
    E-step (Breslow and Clayton 1993, doi:10.1080/01621459.1993.10594284). A conjugate prior on mean and covariance
    makes few planners sufficient. The result is deterministic.

    Args:
        met: features (N, D) and outcomes (N,) of each planner.
        kinds: number of flags for the kind of encounter, which are the first features.
        intercepts: prior mean of the coefficients of these flags.

    Raises:
        ValueError: there are no encounters.
    """
    features = np.concatenate([x for x, _ in met]) if met else np.zeros((0, 0))
    if not len(features):
        raise ValueError("no encounter to learn from")
    count = features.shape[1]
    centre = np.where(np.arange(count) < kinds, intercepts, 0.0)
    mean, covariance = centre, _VARIANCE * np.eye(count)
    for _ in range(ROUNDS):
        posteriors = [posterior(mean, covariance, x, y) for x, y in met]
        precision = np.linalg.inv(covariance)
        prior_precision = np.eye(count) / _MEAN_VARIANCE
        modes = np.array([mode for mode, _ in posteriors])
        mean = np.linalg.solve(
            len(posteriors) * precision + prior_precision,
            precision @ modes.sum(axis=0) + prior_precision @ centre,
        )
        spread = sum((c + np.outer(m - mean, m - mean) for m, c in posteriors), np.zeros((count, count)))
        prior_spread = _PSEUDO_PLANNERS * _VARIANCE * np.eye(count)
        covariance = (spread + prior_spread) / (len(posteriors) + _PSEUDO_PLANNERS)
    return FailurePredictor(mean, covariance, _typical(features, kinds))


def _typical(features: FloatArray, kinds: int) -> FloatArray:
    """Return (K, D) the mean features of each kind; for a kind without encounters, those of all encounters."""
    masks = [features[:, k] == 1.0 for k in range(kinds)]
    means = [features[mask].mean(axis=0) if mask.any() else features.mean(axis=0) for mask in masks]
    typical = np.array(means)
    typical[:, :kinds] = np.eye(kinds)
    return typical
