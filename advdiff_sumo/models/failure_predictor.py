"""Probability that a planner fails validly in an encounter: Bayesian logistic regression.

All planners share a Gaussian prior of the coefficients, which has been estimated on planted defects
(``tools/failure_prior.py``). The encounters of one planner update the coefficients of that planner (Laplace
approximation, Bishop 2006, Sec. 4.5); directions that they say nothing about stay at the prior.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import WeightsError
from advdiff_sumo.models.stored import read_stored, write_stored

FORMAT = "advdiff-failures-1"
_NEWTON_STEPS, _CONVERGED = 100, 1e-9
_MISSING, _REMEDY = "make it with advdiff-sumo warmup --licence lawful", "give a file of such a warm-up"


@dataclass(frozen=True)
class FailurePredictor:
    """Gaussian distribution of a planner's coefficients; D features.

    Attributes:
        mean: (D,) expected coefficients.
        covariance: (D, D) of the coefficients.
        typical: (K, D) mean features of encounters of each kind, in the order of the kinds among the features.
    """

    mean: FloatArray
    covariance: FloatArray
    typical: FloatArray

    def probability(self, features: FloatArray) -> FloatArray:
        """Return (C,) probabilities of a valid failure in encounters with *features* (C, D), at the mean coefficients.

        Averaging over their uncertainty would rate unseen encounters half as likely to fail as ones that have failed.
        """
        return sigmoid(features @ self.mean)

    def adapted(self, features: FloatArray, outcomes: FloatArray) -> FailurePredictor:
        """Return the predictor updated by *outcomes* (N,), 0 to 1, of encounters with *features* (N, D)."""
        mean, covariance = posterior(self.mean, self.covariance, features, outcomes)
        return replace(self, mean=mean, covariance=covariance)


def sigmoid(logit: FloatArray) -> FloatArray:
    """Return the logistic function, without overflow."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * logit)))


def posterior(
    mean: FloatArray, covariance: FloatArray, features: FloatArray, outcomes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return mode (D,) and covariance (D, D) of the coefficients after N encounters.

    Newton's method on the log posterior, which is concave; the covariance is the inverse of its curvature there.

    Args:
        mean: (D,) of the Gaussian prior.
        covariance: (D, D) of it, positive definite.
        features: (N, D).
        outcomes: (N,) 1: failed, 0: resolved with ease; between: a near miss.
    """
    precision = np.linalg.inv(covariance)
    mode = mean.copy()
    for _ in range(_NEWTON_STEPS):
        share = sigmoid(features @ mode)
        curvature = precision + (features.T * (share * (1.0 - share))) @ features
        step = np.linalg.solve(curvature, features.T @ (outcomes - share) - precision @ (mode - mean))
        mode = mode + step / max(1.0, float(np.abs(step).max()))  # at most 1 a step: far steps overshoot
        if float(np.abs(step).max()) < _CONVERGED:
            break
    share = sigmoid(features @ mode)
    curvature = precision + (features.T * (share * (1.0 - share))) @ features
    return mode, np.asarray(np.linalg.inv(curvature))


def save_failures(predictor: FailurePredictor, path: Path, extra: Mapping[str, Any] | None = None) -> None:
    """Write *predictor* to *path*, a ".safetensors" file; *extra* goes into its header as JSON."""
    write_stored(path, vars(predictor), {"format": FORMAT, "extra": dict(extra or {})})


def load_failures(path: Path, features: int) -> FailurePredictor:
    """Read what :func:`save_failures` wrote, for encounters of D *features*.

    Raises:
        WeightsError: no such file, another format, or for other features.
    """
    _, arrays = read_stored(path, FORMAT, _MISSING, _REMEDY, "np")
    shapes = {name: value.shape for name, value in arrays.items()}
    typical = shapes.pop("typical", ())
    if shapes != {"mean": (features,), "covariance": (features, features)} or typical[1:] != (features,):
        raise WeightsError(path, "is for other features of encounters", "warm up again with this version")
    return FailurePredictor(**arrays)
