"""Arc-length operations on a bent line, computed by hand."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert import polyline

BENT = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]])


def test_cut_in_the_middle_keeps_the_corner() -> None:
    np.testing.assert_allclose(polyline.cut(BENT, 1.0, 5.0), [[1.0, 0.0], [3.0, 0.0], [3.0, 2.0]])
    assert polyline.cut(BENT, 0.0, 7.0) is BENT


def test_project_is_signed_to_the_left() -> None:
    s, aside = polyline.project(BENT, np.array([[1.0, 0.5], [1.0, -0.5], [4.0, 3.0]]))
    np.testing.assert_allclose(s, [1.0, 1.0, 6.0])
    np.testing.assert_allclose(aside, [0.5, -0.5, -1.0])


def test_join_shares_the_common_point() -> None:
    joined = polyline.join([BENT[:2], BENT[1:]])
    np.testing.assert_array_equal(joined, BENT)


@given(a=st.floats(0.0, 7.0), b=st.floats(0.0, 7.0))
def test_parts_add_up(a: float, b: float) -> None:
    first, last = sorted((a, b))
    if last - first > 1e-3:
        assert abs(line_length_m(polyline.cut(BENT, first, last)) - (last - first)) < 1e-5
