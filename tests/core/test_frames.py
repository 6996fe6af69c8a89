"""Angles and frames: hand-worked values, and conversions that are reversed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.core import frames

ANGLES = st.floats(-50.0, 50.0)
METRES = st.floats(-1e4, 1e4)
PI = np.pi


@pytest.mark.parametrize(
    ("sumo_deg", "yaw"),
    [
        (90.0, 0.0),
        (0.0, PI / 2),
        (270.0, PI),
        (180.0, -PI / 2),
        (45.0, PI / 4),
        (120.0, -PI / 6),
        (360.0, PI / 2),
    ],
)
def test_sumo_counts_clockwise_from_north(sumo_deg: float, yaw: float) -> None:
    assert frames.yaw_from_sumo(sumo_deg) == pytest.approx(yaw, abs=1e-12)
    assert frames.sumo_from_yaw(yaw) == pytest.approx(sumo_deg % 360.0, abs=1e-9)


@pytest.mark.parametrize(
    ("angle", "wrapped"),
    [(0.0, 0.0), (PI, PI), (-PI, PI), (3 * PI, PI), (-3 * PI, PI), (2 * PI, 0.0), (1.5 * PI, -0.5 * PI),
     (7.0, 7.0 - 2 * PI)],
)  # fmt: skip
def test_wrapping_by_hand(angle: float, wrapped: float) -> None:
    assert frames.wrap_angle(angle) == pytest.approx(wrapped, abs=1e-12)


def test_nan_stays_nan() -> None:
    assert np.isnan(frames.wrap_angle(np.array((np.nan, 1.0)))).tolist() == [True, False]


@given(ANGLES)
def test_wrapping_keeps_the_direction(angle: float) -> None:
    wrapped = float(frames.wrap_angle(angle))
    assert -PI < wrapped <= PI
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-9)


@given(ANGLES)
def test_yaw_to_sumo_and_back(yaw: float) -> None:
    degrees = float(frames.sumo_from_yaw(yaw))
    assert 0.0 <= degrees < 360.0
    assert abs(frames.wrap_angle(frames.yaw_from_sumo(degrees) - yaw)) < 1e-9


def test_the_bumper_is_half_a_length_ahead() -> None:
    centre = np.array(((1.0, 2.0), (1.0, 2.0)))
    bumper = frames.bumper_from_centre(centre, np.array((0.0, PI / 2)), np.array((5.0, 4.0)))
    np.testing.assert_allclose(bumper, ((3.5, 2.0), (1.0, 4.0)), atol=1e-12)


@given(METRES, METRES, ANGLES, st.floats(0.1, 30.0))
def test_bumper_and_back(x: float, y: float, yaw: float, length: float) -> None:
    centre = np.array((x, y))
    bumper = frames.bumper_from_centre(centre, np.asarray(yaw), np.asarray(length))
    assert np.hypot(*(bumper - centre)) == pytest.approx(0.5 * length, abs=1e-6)
    np.testing.assert_allclose(
        frames.centre_from_bumper(bumper, np.asarray(yaw), np.asarray(length)), centre, atol=1e-9
    )


def test_local_coordinates_by_hand() -> None:
    origin, yaw = np.array((10.0, 20.0)), PI / 2  # x ahead is north, y left is west
    local = frames.local_from_world(np.array(((10.0, 23.0), (6.0, 20.0))), origin, yaw)
    np.testing.assert_allclose(local, ((3.0, 0.0), (0.0, 4.0)), atol=1e-12)


@given(METRES, METRES, METRES, METRES, ANGLES)
def test_local_and_back(x: float, y: float, x0: float, y0: float, yaw: float) -> None:
    point, origin = np.array((x, y)), np.array((x0, y0))
    local = frames.local_from_world(point, origin, yaw)
    assert np.hypot(*local) == pytest.approx(np.hypot(*(point - origin)), rel=1e-9, abs=1e-9)
    back = local[0] * frames.unit(yaw) + local[1] * frames.unit(yaw + PI / 2)
    np.testing.assert_allclose(origin + back, point, atol=1e-7)
