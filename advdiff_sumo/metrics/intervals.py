"""Confidence intervals of rates."""

from __future__ import annotations

from scipy.stats import binomtest


def wilson(count: int, total: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return the Wilson score interval of *count* successes in *total* trials (doi 10.2307/2276774).

    Raises:
        ValueError: *total* is 0 or *count* is not in [0, total].
    """
    if not 0 <= count <= total or total == 0:
        raise ValueError(f"{count} of {total} is no rate")
    interval = binomtest(count, total).proportion_ci(confidence, method="wilson")
    return float(interval.low), float(interval.high)
