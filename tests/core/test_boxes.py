"""Boxes: hand-worked values, then comparison with shapely."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from advdiff_sumo.core.boxes import axis_gaps, corners, distance, overlap, separation

SIZE = np.array([4.0, 2.0])


def box(x: float, y: float, yaw: float, size: object = SIZE) -> np.ndarray:
    """Return the corners (4, 2) of one box."""
    return corners(np.array([x, y]), np.array(yaw), np.asarray(size))


def test_corners_go_round_from_the_front_left() -> None:
    assert box(1, 2, 0).tolist() == [[3, 3], [3, 1], [-1, 1], [-1, 3]]
    turned = box(0, 0, math.pi / 2)
    np.testing.assert_allclose(turned, [[-1, 2], [1, 2], [1, -2], [-1, -2]], atol=1e-12)


def test_worked_gaps() -> None:
    assert separation(box(0, 0, 0), box(5, 0, 0)) == pytest.approx(1.0)
    assert distance(box(0, 0, 0), box(5, 0, 0)) == pytest.approx(1.0)
    assert distance(box(0, 0, 0), box(7, 6, 0)) == pytest.approx(5.0)  # corner to corner: 3 and 4
    assert separation(box(0, 0, 0), box(3.5, 0, 0)) == pytest.approx(-0.5)
    assert distance(box(0, 0, 0), box(3.5, 0, 0)) == 0.0
    # the corner of a square turned by 45 degrees points at the face: 5 - 2 - sqrt 2
    assert distance(box(0, 0, 0), box(5, 0, math.pi / 4, (2.0, 2.0))) == pytest.approx(3 - math.sqrt(2))


def test_touching_boxes_and_nan_do_not_overlap() -> None:
    assert not overlap(box(0, 0, 0), box(4, 0, 0))
    assert not overlap(box(0, 0, 0), box(math.nan, 0, 0))
    assert math.isnan(float(distance(box(0, 0, 0), box(math.nan, 0, 0))))


def test_one_box_within_another_overlaps() -> None:
    assert overlap(box(0, 0, 0), box(0.2, 0.1, 0.5, (0.5, 0.5)))
    assert distance(box(0, 0, 0), box(0.2, 0.1, 0.5, (0.5, 0.5))) == 0.0


poses = st.tuples(
    st.floats(-8, 8), st.floats(-8, 8), st.floats(-4, 4), st.tuples(st.floats(0.3, 12), st.floats(0.3, 3))
)


@settings(max_examples=200, deadline=None)
@given(poses, poses)
def test_agrees_with_shapely(first, second) -> None:
    a, b = box(*first), box(*second)
    one, other = shapely.Polygon(a), shapely.Polygon(b)
    assert float(distance(a, b)) == pytest.approx(one.distance(other), abs=1e-9)
    shared = shapely.intersection(one, other).area
    if overlap(a, b):
        depth = -float(separation(a, b))
        assert shared > 0.0 or depth < 1e-9
    else:
        assert shared < 1e-9


@settings(max_examples=200, deadline=None)
@given(poses, poses)
def test_gaps_from_poses_equal_those_from_corners(first, second) -> None:
    gaps, along, axes = axis_gaps(
        np.array(second[:2]) - np.array(first[:2]),
        np.array(first[2]),
        0.5 * np.array(first[3]),
        np.array(second[2]),
        0.5 * np.array(second[3]),
    )
    assert float(gaps.max()) == pytest.approx(float(separation(box(*first), box(*second))), abs=1e-9)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=-1), 1.0)
    np.testing.assert_allclose(along, axes @ (np.array(second[:2]) - np.array(first[:2])), atol=1e-9)


@settings(max_examples=100, deadline=None)
@given(poses, poses)
def test_minus_the_separation_is_the_least_translation_that_parts_them(first, second) -> None:
    a, b = box(*first), box(*second)
    if not overlap(a, b):
        return
    gaps, along, axes = axis_gaps(
        np.array(second[:2]) - np.array(first[:2]),
        np.array(first[2]),
        0.5 * np.array(first[3]),
        np.array(second[2]),
        0.5 * np.array(second[3]),
    )
    best = int(np.argmax(gaps))
    way = np.copysign(1.0, along[best]) * axes[best]
    assert shapely.Polygon(a).intersection(shapely.Polygon(b - (float(gaps[best]) - 1e-9) * way)).area < 1e-6
