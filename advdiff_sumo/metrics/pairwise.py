"""Least time to collision (TTC) of each agent with any other, and its histogram for the benches."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.boxes import axis_gaps
from advdiff_sumo.metrics.criticality import TTC_HORIZON_S, meeting_s

#: Edges of the bins: every half second up to the horizon. :func:`ttc_counts` adds a bin for longer times.
TTC_BINS_S = np.arange(0.0, TTC_HORIZON_S + 0.25, 0.5)


def least_ttc(
    xy_m: FloatArray, yaw_rad: FloatArray, velocity_mps: FloatArray, size_m: FloatArray, present: BoolArray
) -> FloatArray:
    """Return (…, A) seconds until each agent's box first meets another one, at constant velocity and heading.

    inf if it meets none within ``TTC_HORIZON_S``, 0 if it overlaps one already, NaN if it is absent. The method is that
    of :func:`advdiff_sumo.metrics.criticality.time_to_collision`, which is for one target.

    Args:
        xy_m: (…, A, 2) centres.
        yaw_rad: (…, A) headings.
        velocity_mps: (…, A, 2) velocities.
        size_m: (…, A, 2) lengths and widths.
        present: (…, A) whether the agent is present.
    """
    size_m = np.broadcast_to(size_m, xy_m.shape)
    seconds = np.full(present.shape, np.inf)
    i, j = np.triu_indices(present.shape[-1], k=1)
    offset = xy_m[..., j, :] - xy_m[..., i, :]
    closing = velocity_mps[..., j, :] - velocity_mps[..., i, :]
    reach = 0.5 * (np.linalg.norm(size_m[..., i, :], axis=-1) + np.linalg.norm(size_m[..., j, :], axis=-1))
    with np.errstate(invalid="ignore"):
        near = np.linalg.norm(offset, axis=-1) <= reach + TTC_HORIZON_S * np.linalg.norm(closing, axis=-1)
    pairs = np.nonzero(near & present[..., i] & present[..., j])
    if len(pairs[0]):
        a, b = (*pairs[:-1], i[pairs[-1]]), (*pairs[:-1], j[pairs[-1]])
        pair_s = _meeting_s(offset[pairs], closing[pairs], (yaw_rad[a], yaw_rad[b]), (size_m[a], size_m[b]))
        np.minimum.at(seconds, a, pair_s)
        np.minimum.at(seconds, b, pair_s)
    return np.where(present, seconds, np.nan)


def ttc_counts(seconds: FloatArray) -> FloatArray:
    """Return the counts of *seconds* in ``TTC_BINS_S`` and, last, the count of longer ones; NaN is left out."""
    known = seconds[~np.isnan(seconds)]
    within_horizon = known[known <= TTC_HORIZON_S]
    counts = np.histogram(within_horizon, TTC_BINS_S)[0].astype(np.float64)
    return np.append(counts, float(len(known) - len(within_horizon)))


def _meeting_s(
    offset: FloatArray,
    closing: FloatArray,
    yaw: tuple[FloatArray, FloatArray],
    size: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Return (P,) when the boxes of P pairs meet; inf if they do not."""
    gaps, along, axes = axis_gaps(offset, yaw[0], 0.5 * size[0], yaw[1], 0.5 * size[1])
    rate = np.einsum("pic,pc->pi", axes, closing)
    return meeting_s(gaps, along, rate)
