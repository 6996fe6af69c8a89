"""Centre lines of lanelets, computed by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from advdiff_sumo.maps.convert.sources.lanelet_centre import lanelet_centre


def test_points_on_one_side_are_joined_with_the_nearest_on_the_other() -> None:
    """The point at x = 5 is 5.4 m from (0, 2), the one at x = 10 is 10.2 m from (0, 0); then the sides are swapped."""
    left, right = np.array([(0.0, 2.0), (10.0, 2.0)]), np.array([(0.0, 0.0), (5.0, 0.0), (10.0, 0.0)])
    assert lanelet_centre(left, right).tolist() == [[0.0, 1.0], [2.5, 1.0], [7.5, 1.0], [10.0, 1.0]]
    mirrored = lanelet_centre(right[::-1], left[::-1])
    assert mirrored.tolist() == [[10.0, 1.0], [7.5, 1.0], [2.5, 1.0], [0.0, 1.0]]


def test_equal_boundaries_of_a_bend() -> None:
    """Points at the same angles are nearest, so every second point lies on the circle in the middle."""
    angles = np.radians(np.arange(0.0, 91.0, 10.0))
    ring = np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    centre = lanelet_centre(8.0 * ring, 12.0 * ring)
    assert np.hypot(*centre[::2].T) == pytest.approx(10.0)
    chord = 0.5 * math.hypot(8.0 * math.cos(math.radians(10.0)) + 12.0, 8.0 * math.sin(math.radians(10.0)))
    assert np.hypot(*centre[1::2].T) == pytest.approx(chord)


def test_no_step_crosses_a_boundary() -> None:
    """The nearest point of the other side lies behind a spur of it."""
    left = np.array([(0.0, 4.0), (4.0, 4.0), (5.0, 0.5), (6.0, 4.0), (10.0, 4.0)])
    right = np.array([(0.0, 0.0), (10.0, 0.0)])
    centre = lanelet_centre(left, right)
    assert centre[0].tolist() == [0.0, 2.0]
    assert centre[-1].tolist() == [10.0, 2.0]
    assert [5.0, 0.25] not in centre.tolist()
    assert (centre[:, 0][1:] >= centre[:, 0][:-1]).all()


def test_lanelets_that_begin_in_a_point() -> None:
    left, right = np.array([(0.0, 0.0), (10.0, 1.0)]), np.array([(0.0, 0.0), (10.0, -1.0)])
    assert lanelet_centre(left, right).tolist() == [[0.0, 0.0], [10.0, 0.0]]
