"""Oriented boxes: corners, overlap and clearance, for arrays of pairs.

A box is given by its four corners or, for faster computation, by pose and size (:func:`axis_gaps`).
"""

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

    By the separating-axis theorem, two convex shapes are apart exactly if some edge normal separates their
    projections. For boxes that are apart this is a lower bound of the distance. NaN gives NaN.
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


def axis_gaps(
    offset_m: FloatArray,
    yaw_a_rad: FloatArray,
    half_a_m: FloatArray,
    yaw_b_rad: FloatArray,
    half_b_m: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the gaps of two boxes along the four separating axes, without computing corners.

    The largest of the four gaps is :func:`separation`. If negative, it is minus the least translation that separates
    the boxes. See Gottschalk, Lin and Manocha (1996), "OBBTree", doi:10.1145/237170.237244.

    Args:
        offset_m: (…, 2) centre of b minus centre of a.
        yaw_a_rad: (…,) heading of a.
        half_a_m: (…, 2) half length and half width of a.
        yaw_b_rad: (…,) heading of b.
        half_b_m: (…, 2) half length and half width of b.

    Returns:
        (…, 4) gaps, (…, 4) signed projections of the offset, and (…, 4, 2) unit axes: along a, across a, along b,
        across b.
    """
    cos, sin = np.cos((yaw_a_rad, yaw_b_rad)), np.sin((yaw_a_rad, yaw_b_rad))  # (2, …)
    x, y = offset_m[..., 0], offset_m[..., 1]
    axes = np.stack((cos[0], sin[0], -sin[0], cos[0], cos[1], sin[1], -sin[1], cos[1]), axis=-1)
    axes = axes.reshape(*axes.shape[:-1], 4, 2)
    along = axes[..., 0] * x[..., None] + axes[..., 1] * y[..., None]
    same = np.abs(cos[0] * cos[1] + sin[0] * sin[1])
    cross = np.abs(sin[1] * cos[0] - cos[1] * sin[0])
    la, wa, lb, wb = half_a_m[..., 0], half_a_m[..., 1], half_b_m[..., 0], half_b_m[..., 1]
    reach = np.stack(
        (
            la + lb * same + wb * cross,
            wa + lb * cross + wb * same,
            lb + la * same + wa * cross,
            wb + la * cross + wa * same,
        ),
        axis=-1,
    )
    return np.abs(along) - reach, along, axes


def overlap(corners_a_m: FloatArray, corners_b_m: FloatArray) -> BoolArray:
    """Return whether two boxes (…, 4, 2) share area; touching boxes and NaN do not."""
    return np.asarray(separation(corners_a_m, corners_b_m) < 0.0)


def distance(corners_a_m: FloatArray, corners_b_m: FloatArray) -> FloatArray:
    """Return the Euclidean distance (…,) between two boxes (…, 4, 2); 0 if they overlap, NaN for NaN.

    Two disjoint convex polygons are nearest at a corner of one of them, so corner-to-edge distances suffice.
    """
    gap = np.minimum(_corners_to_edges(corners_a_m, corners_b_m), _corners_to_edges(corners_b_m, corners_a_m))
    return np.where(overlap(corners_a_m, corners_b_m), 0.0, gap)


def _corners_to_edges(points: FloatArray, box: FloatArray) -> FloatArray:
    """Return the least distance (…,) of the corners *points* to the edges of *box*, both (…, 4, 2)."""
    start = box[..., None, :, :]  # (…, 1, edge, 2)
    edge = np.roll(box, -1, axis=-2)[..., None, :, :] - start
    delta = points[..., :, None, :] - start  # (…, corner, edge, 2)
    squared_length = np.maximum((edge**2).sum(-1), 1e-18)
    share = np.clip((delta * edge).sum(-1) / squared_length, 0.0, 1.0)
    gap = np.linalg.norm(delta - share[..., None] * edge, axis=-1)
    return np.asarray(gap.min(axis=(-2, -1)))
