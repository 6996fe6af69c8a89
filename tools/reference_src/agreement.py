"""Measure the agreement of two judges."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from advdiff_sumo.core.arrays import BoolArray


def cohens_kappa(first: BoolArray, second: BoolArray, confidence: float = 0.95) -> tuple[float, float, float]:
    """Return Cohen's kappa of two judges' answers (N,) to the same questions, and its interval.

    The interval holds for large samples (Fleiss, Cohen and Everitt 1969, doi 10.1037/h0028106, Eq. 13).

    Raises:
        ValueError: there are no answers, or both judges always give the same answer, so that kappa is undefined.
    """
    table = np.histogram2d(first, second, bins=2, range=((0, 1), (0, 1)))[0]
    count = float(table.sum())
    if not count:
        raise ValueError("no answers to compare")
    share = table / count
    rows, columns = share.sum(axis=1), share.sum(axis=0)
    chance = float(rows @ columns)
    if chance >= 1.0:
        raise ValueError("both judges always give the same answer")
    kappa = (float(np.trace(share)) - chance) / (1.0 - chance)
    diagonal = float((np.diag(share) * (1.0 - (rows + columns) * (1.0 - kappa)) ** 2).sum())
    weighted = share * (columns[:, None] + rows[None, :]) ** 2
    off_diagonal = (1.0 - kappa) ** 2 * float(weighted.sum() - np.trace(weighted))
    variance = diagonal + off_diagonal - (kappa - chance * (1.0 - kappa)) ** 2
    half_width = float(ndtri(0.5 + 0.5 * confidence)) * (max(variance, 0.0) / count) ** 0.5 / (1.0 - chance)
    return kappa, kappa - half_width, kappa + half_width
