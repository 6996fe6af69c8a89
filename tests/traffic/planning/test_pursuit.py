"""Pure pursuit of lanes, and the search for the segment of a line, also beyond its ends."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.traffic.planning.pursuit import Lines, in_a_row, pursue, segments


def straight(count: int = 30) -> Lines:
    """Return two lines along x, 10 m of segments of 1 m, then one of *count*."""
    s = np.concatenate((np.arange(10.0), np.arange(float(count))))
    along = np.tile((1.0, 0.0), (len(s), 1))
    first, last = np.array([0, 10]), np.array([9, 9 + count])
    xy = np.stack((s, np.zeros_like(s)), axis=-1)
    return Lines(xy, along, np.zeros_like(s), s, first, last, np.zeros(2), np.array([10.0, 8.0]))


@pytest.mark.parametrize(
    ("s", "found"), [(-5.0, 10), (0.0, 10), (0.99, 10), (1.0, 11), (12.5, 22), (99.0, 39)]
)
def test_segments_are_found_also_beyond_the_ends(s: float, found: int) -> None:
    lines = straight()
    row = in_a_row(lines)
    assert segments(lines, row, np.array([3.5, s])).tolist() == [3, found]
    assert segments(lines, row, np.array([[s, s], [0.0, 0.0]]))[:, 1].tolist() == [found, 10]


def test_a_vehicle_beside_its_lane_returns_and_reaches_the_limit() -> None:
    states = np.array([[0.0, 1.0, 0.1, 6.0], [0.0, 0.0, 0.0, 12.0]])
    made = pursue(straight(), states, np.full(2, 0.3), 6.0, 0.25, 24)
    assert abs(made[0, -1, 1]) < 0.1
    np.testing.assert_allclose(made[:, -1, 3], (10.0, 8.0), atol=0.02)
    np.testing.assert_allclose(made[1, :, 1:3], 0.0, atol=1e-12)


def test_a_vehicle_drives_the_same_alone_and_among_others() -> None:
    states = np.array([[0.0, 1.0, 0.1, 6.0], [0.0, 0.5, 0.0, 12.0]])
    lines = straight()
    alone = Lines(*(part[:10] for part in lines[:4]), *(part[:1] for part in lines[4:]))
    both = pursue(lines, states, np.full(2, 0.3), 6.0, 0.25, 24)
    one = pursue(alone, states[:1], np.full(1, 0.3), 6.0, 0.25, 24)
    np.testing.assert_array_equal(one[0], both[0])
