"""Polylines: hand-worked values, then properties."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from advdiff_sumo.core.polylines import Polyline, concatenate, distances_m

CORNER = Polyline.of(np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 5.0]]))

points = arrays(np.float64, st.tuples(st.integers(2, 8), st.just(2)), elements=st.floats(-50.0, 50.0))


def test_arc_length_and_interpolation():
    np.testing.assert_allclose(CORNER.s_m, [0.0, 10.0, 15.0])
    xy, yaw = CORNER.at(np.array([4.0, 10.0, 12.0]), np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(xy, [[4.0, 0.0], [10.0, 0.0], [9.0, 2.0]])
    np.testing.assert_allclose(yaw, [0.0, np.pi / 2, np.pi / 2])


def test_projection():
    s, d = CORNER.project(np.array([[4.0, 1.0], [4.0, -2.0], [9.0, 3.0], [13.0, -4.0], [10.0, 8.0]]))
    np.testing.assert_allclose(s, [4.0, 4.0, 13.0, 10.0, 15.0])
    np.testing.assert_allclose(d, [1.0, -2.0, 1.0, -5.0, 3.0])


def test_distances_of_each_point_from_each_other():
    origin_and_east = np.array([[0.0, 0.0], [3.0, 0.0]])
    np.testing.assert_allclose(distances_m(origin_and_east, np.array([[0.0, 4.0]])), [[4.0], [5.0]])


def test_ends():
    np.testing.assert_allclose(CORNER.at(-3.0)[0], [0.0, 0.0])
    np.testing.assert_allclose(CORNER.at(-3.0, extrapolate=True)[0], [-3.0, 0.0])
    np.testing.assert_allclose(CORNER.at(17.0, extrapolate=True)[0], [10.0, 7.0])
    s, d = CORNER.project(np.array([-3.0, 4.0]))
    assert (s, d) == (0.0, 5.0)
    s, d = CORNER.project(np.array([-3.0, 1.0]), extrapolate=True)
    assert (s, d) == (-3.0, 1.0)


def test_odd_input():
    assert Polyline.of(np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0], [1.0, 0.0]])).length_m == 1.0
    for bad in (np.zeros((0, 2)), np.zeros((1, 2)), np.zeros((3, 2)), np.zeros((2, 3))):
        with pytest.raises(ValueError, match="polyline needs"):
            Polyline.of(bad)
    with pytest.raises(ValueError, match="finite"):
        Polyline.of(np.array([[0.0, 0.0], [np.nan, 1.0]]))
    assert np.isnan(CORNER.project(np.array([np.nan, 0.0]))).all()
    assert np.isnan(CORNER.at(np.nan)[0]).all()
    assert np.isnan(CORNER.at(np.nan)[1])
    assert CORNER.project(np.zeros((0, 2)))[0].shape == (0,)
    assert CORNER.at(np.zeros(0))[0].shape == (0, 2)
    with pytest.raises(ValueError, match="no polylines"):
        concatenate([])


def test_curvature_of_a_circle():
    angle = np.linspace(0.0, np.pi, 200)
    circle = Polyline.of(20.0 * np.stack((np.cos(angle), np.sin(angle)), axis=-1))
    np.testing.assert_allclose(circle.curvature_1pm[1:-1], 0.05, rtol=1e-3)
    assert circle.length_m == pytest.approx(20.0 * np.pi, rel=1e-4)


def test_offset_mitres_the_corner():
    np.testing.assert_allclose(CORNER.offset(1.0).xy_m, [[0.0, 1.0], [9.0, 1.0], [9.0, 5.0]])
    np.testing.assert_allclose(CORNER.offset(-1.0).xy_m, [[0.0, -1.0], [11.0, -1.0], [11.0, 5.0]])


def test_slice_and_join():
    part = CORNER.slice(8.0, 12.0)
    np.testing.assert_allclose(part.xy_m, [[8.0, 0.0], [10.0, 0.0], [10.0, 2.0]])
    whole = concatenate([CORNER.slice(0.0, 8.0), part, CORNER.slice(12.0, 99.0)])
    assert whole.length_m == pytest.approx(15.0)
    with pytest.raises(ValueError, match="nothing of the line"):
        CORNER.slice(20.0, 30.0)


def test_resample():
    assert len(CORNER.resample(spacing_m=2.0).s_m) == 9
    np.testing.assert_allclose(CORNER.resample(count=4).xy_m, [[0, 0], [5, 0], [10, 0], [10, 5]])
    for bad in ({}, {"spacing_m": 1.0, "count": 3}, {"spacing_m": 0.0}, {"count": 1}):
        with pytest.raises(ValueError, match=r"spacing_m|count"):
            CORNER.resample(**bad)


@given(xy=points, share=st.floats(0.0, 1.0))
def test_points_of_the_line_project_onto_it(xy, share):
    assume(np.ptp(xy, axis=0).max() > 1e-3)
    line = Polyline.of(xy)
    place, _ = line.at(share * line.length_m)
    s, d = line.project(place)
    assert abs(d) < 1e-6
    np.testing.assert_allclose(line.at(s)[0], place, atol=1e-6)


@given(xy=points, x=st.floats(-100.0, 100.0), y=st.floats(-100.0, 100.0))
def test_projection_is_nearest(xy, x, y):
    """No sampled point of the line is nearer than the projection says."""
    assume(np.ptp(xy, axis=0).max() > 1e-3)
    line = Polyline.of(xy)
    s, d = line.project(np.array([x, y]))
    samples, _ = line.at(np.linspace(0.0, line.length_m, 100))
    assert abs(d) <= np.hypot(*(samples - [x, y]).T).min() + 1e-6
    assert np.hypot(*(line.at(s)[0] - [x, y])) == pytest.approx(abs(float(d)), abs=1e-6)


@given(xy=points, cut=st.floats(0.05, 0.95))
def test_cutting_keeps_the_length(xy, cut):
    assume(np.ptp(xy, axis=0).max() > 1e-1)
    line = Polyline.of(xy)
    at = cut * line.length_m
    parts = line.slice(0.0, at).length_m + line.slice(at, line.length_m).length_m
    assert parts == pytest.approx(line.length_m, rel=1e-9, abs=1e-7)
