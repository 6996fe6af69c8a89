"""Probability that a planner fails validly in an encounter: logistic regression with a Gaussian belief about it.

Planners share a Gaussian prior over the coefficients of the regression, which has been estimated on planted defects
(``tools/failure_prior.py``). What one planner did in a few encounters moves its own coefficients alone (Laplace
approximation, Bishop 2006, Sec. 4.5): the prior keeps all that these encounters say nothing about.
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
    """What is believed of a planner; D features.

    Attributes:
        mean: (D,) expected coefficients.
        covariance: (D, D) of the coefficients.
        typical: (K, D) features of the mean encounter of each kind, in the order of the kinds among the features.
    """

    mean: FloatArray
    covariance: FloatArray
    typical: FloatArray

    def probability(self, features: FloatArray) -> FloatArray:
        """Return (C,) probabilities of a valid failure in encounters with *features* (C, D), as is expected.

        Averaged over the uncertain ones, what nobody has met would look half as likely as what has failed.
        """
        return sigmoid(features @ self.mean)

    def adapted(self, features: FloatArray, outcomes: FloatArray) -> FailurePredictor:
        """Return what is believed once *outcomes* (N,), 0 to 1, of encounters with *features* (N, D) are known."""
        mean, covariance = posterior(self.mean, self.covariance, features, outcomes)
        return replace(self, mean=mean, covariance=covariance)


def sigmoid(logit: FloatArray) -> FloatArray:
    """Return the logistic function, without overflow."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * logit)))


def posterior(
    mean: FloatArray, covariance: FloatArray, features: FloatArray, outcomes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return mode (D,) and covariance (D, D) of the coefficients after N encounters.

    Newton's method on the log posterior, which is concave; the covariance is that of its curvature at the mode.

    Args:
        mean: (D,) of the Gaussian prior.
        covariance: (D, D) of it, positive definite.
        features: (N, D).
        outcomes: (N,) 0: answered calmly, 1: failed; between: a share of a failure.
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
