"""How far two judges agree."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from advdiff_sumo.core.arrays import BoolArray


def cohens_kappa(first: BoolArray, second: BoolArray, confidence: float = 0.95) -> tuple[float, float, float]:
    """Return Cohen's kappa of two judges' answers (N,) to the same questions, and its interval.

    The interval is that of large samples (Fleiss, Cohen and Everitt 1969, doi 10.1037/h0028106, Eq. 13).

    Raises:
        ValueError: there are no answers, or both judges always give the same one, which leaves chance nothing.
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
    same = float((np.diag(share) * (1.0 - (rows + columns) * (1.0 - kappa)) ** 2).sum())
    off = share * (columns[:, None] + rows[None, :]) ** 2
    apart = (1.0 - kappa) ** 2 * float(off.sum() - np.trace(off))
    spread = same + apart - (kappa - chance * (1.0 - kappa)) ** 2
    half = float(ndtri(0.5 + 0.5 * confidence)) * (max(spread, 0.0) / count) ** 0.5 / (1.0 - chance)
    return kappa, kappa - half, kappa + half
