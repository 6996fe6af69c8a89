"""Oriented boxes: corners, overlap and clearance, for whole arrays of pairs."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray

_SIGNS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])


def corners(xy_m: FloatArray, yaw_rad: FloatArray, size_m: FloatArray) -> FloatArray:
    """Return corners (…, 4, 2): front left, front right, rear right, rear left.

    Args:
        xy_m: (…, 2) centres.
        yaw_rad: (…,) headings.
        size_m: (…, 2) length and width.
    """
    cos, sin = np.cos(yaw_rad)[..., None], np.sin(yaw_rad)[..., None]
    half = 0.5 * size_m[..., None, :] * _SIGNS  # (…, 4, 2)
    x, y = half[..., 0], half[..., 1]
    return np.stack((cos * x - sin * y, sin * x + cos * y), axis=-1) + xy_m[..., None, :]


def separation(corners_a_m: FloatArray, corners_b_m: FloatArray) -> FloatArray:
    """Return the largest gap (…,) over the four separating axes of two boxes; negative: they overlap by that.

    The separating-axis theorem: two convex shapes are apart exactly when some edge normal separates their
    projections. For boxes that are apart this is a lower bound of the distance. NaN in, NaN out.
    """
    axes = np.concatenate(
        (
            corners_a_m[..., :2, :] - corners_a_m[..., 1:3, :],
            corners_b_m[..., :2, :] - corners_b_m[..., 1:3, :],
        ),
        axis=-2,
    )  # (…, 4, 2)
    norm = np.maximum(np.linalg.norm(axes, axis=-1, keepdims=True), 1e-12)
    axes = axes / norm
    a = np.einsum("...ck,...ak->...ac", corners_a_m, axes)  # (…, axis, corner)
    b = np.einsum("...ck,...ak->...ac", corners_b_m, axes)
    gap = np.maximum(b.min(-1) - a.max(-1), a.min(-1) - b.max(-1))
    return np.asarray(gap.max(-1))


def overlap(corners_a_m: FloatArray, corners_b_m: FloatArray) -> BoolArray:
    """Return whether two boxes (…, 4, 2) share area; touching boxes and NaN do not."""
    return np.asarray(separation(corners_a_m, corners_b_m) < 0.0)


def distance(corners_a_m: FloatArray, corners_b_m: FloatArray) -> FloatArray:
    """Return the Euclidean distance (…,) between two boxes (…, 4, 2); 0 when they overlap, NaN for NaN.

    Two disjoint convex polygons are nearest at a corner of one of them, so corner-to-edge distances suffice.
    """
    gap = np.minimum(_corners_to_edges(corners_a_m, corners_b_m), _corners_to_edges(corners_b_m, corners_a_m))
    return np.where(overlap(corners_a_m, corners_b_m), 0.0, gap)


def _corners_to_edges(points: FloatArray, box: FloatArray) -> FloatArray:
    start = box[..., None, :, :]  # (…, 1, edge, 2)
    along = np.roll(box, -1, axis=-2)[..., None, :, :] - start
    delta = points[..., :, None, :] - start  # (…, corner, edge, 2)
    squared = np.maximum((along**2).sum(-1), 1e-18)
    share = np.clip((delta * along).sum(-1) / squared, 0.0, 1.0)
    gap = np.linalg.norm(delta - share[..., None] * along, axis=-1)
    return np.asarray(gap.min(axis=(-2, -1)))
