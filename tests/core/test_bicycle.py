"""The bicycle model: arcs of known radius, steps of any length, stops and limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.core.bicycle import Limits, clip_controls, rollout, step, wheelbase_m
from advdiff_sumo.core.frames import wrap_angle

SPEED, ACCEL, BEND, YAW = (
    st.floats(0.0, 40.0),
    st.floats(-9.0, 4.0),
    st.floats(-0.2, 0.2),
    st.floats(-3.14, 3.14),
)


def drive(
    speed: float, accel: float, bend: float, dt: float, steps: int = 1, yaw: float = 0.0
) -> tuple[np.ndarray, float, float]:
    state = np.zeros(2), np.asarray(yaw), np.asarray(speed)
    for _ in range(steps):
        state = step(*state, np.asarray(accel), np.asarray(bend), dt)
    return state[0], float(state[1]), float(state[2])


def test_straight_ahead_by_hand() -> None:
    xy, yaw, speed = drive(10.0, 2.0, 0.0, 3.0, yaw=np.pi / 2)
    np.testing.assert_allclose(xy, (0.0, 39.0), atol=1e-12)  # 10·3 + ½·2·9
    assert (yaw, speed) == (pytest.approx(np.pi / 2), 16.0)


def test_a_quarter_of_a_circle_by_hand() -> None:
    radius = 20.0
    xy, yaw, _ = drive(5.0, 0.0, 1 / radius, 0.5 * np.pi * radius / 5.0)
    np.testing.assert_allclose(xy, (radius, radius), atol=1e-9)
    assert yaw == pytest.approx(np.pi / 2)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_whole_circle_stays_on_its_radius(side: float) -> None:
    radius, steps = 15.0, 100
    dt = 2 * np.pi * radius / 6.0 / steps
    xy, yaw, _ = rollout(
        np.zeros(2), np.asarray(0.0), np.asarray(6.0), np.zeros(steps), np.full(steps, side / radius), dt
    )
    np.testing.assert_allclose(np.hypot(xy[:, 0], xy[:, 1] - side * radius), radius, atol=1e-9)
    np.testing.assert_allclose(xy[-1], 0.0, atol=1e-9)
    assert abs(wrap_angle(yaw[-1])) < 1e-9


@given(SPEED, ACCEL, BEND, YAW)
def test_one_step_equals_five(speed: float, accel: float, bend: float, yaw: float) -> None:
    one, five = drive(speed, accel, bend, 0.5, 1, yaw), drive(speed, accel, bend, 0.1, 5, yaw)
    np.testing.assert_allclose(one[0], five[0], atol=1e-9)
    assert abs(wrap_angle(one[1] - five[1])) < 1e-9
    assert one[2] == pytest.approx(five[2], abs=1e-9)


def test_braking_stops_and_stays() -> None:
    xy, _, speed = drive(4.0, -8.0, 0.0, 2.0)
    np.testing.assert_allclose(xy, (1.0, 0.0), atol=1e-12)  # v²/2a
    assert speed == 0.0
    still, _, speed = drive(0.0, -8.0, 0.1, 2.0)
    assert (still.tolist(), speed) == ([0.0, 0.0], 0.0)


@given(SPEED, ACCEL, BEND, st.floats(0.01, 2.0))
def test_it_never_reverses_and_never_outruns_its_arc(
    speed: float, accel: float, bend: float, dt: float
) -> None:
    xy, yaw, after = drive(speed, accel, bend, dt)
    assert after >= 0.0
    arc = 0.5 * (speed + after) * dt if after > 0.0 or accel >= 0.0 else speed**2 / (2 * -accel)
    assert np.hypot(*xy) <= arc + 1e-9
    assert -np.pi <= yaw <= np.pi


def test_batches_are_their_rows() -> None:
    rng = np.random.default_rng(0)
    xy, yaw, speed = rng.normal(size=(4, 3, 2)), rng.normal(size=(4, 3)), rng.uniform(0, 9, (4, 3))
    accel, bend = rng.normal(size=(2, 4, 3))
    whole = step(xy, yaw, speed, accel, bend, 0.5)
    row = step(xy[1, 2], yaw[1, 2], speed[1, 2], accel[1, 2], bend[1, 2], 0.5)
    for part, single in zip(whole, row, strict=True):
        np.testing.assert_array_equal(part[1, 2], single)


def test_limits_by_hand() -> None:
    limits, length = Limits(), np.asarray(5.0)  # wheelbase 3 m
    assert wheelbase_m(5.0) == pytest.approx(3.0)
    tightest = np.tan(0.6) / 3.0
    accel, bend = clip_controls(np.asarray(2.0), np.asarray(9.0), np.asarray(9.0), length, limits)
    assert (accel, bend) == (4.0, pytest.approx(tightest))
    accel, bend = clip_controls(np.asarray(20.0), np.asarray(-30.0), np.asarray(-1.0), length, limits)
    assert (accel, bend) == (-9.0, pytest.approx(-6.0 / 400.0))
    accel, _ = clip_controls(np.asarray(60.0), np.asarray(1.0), np.asarray(0.0), length, limits)
    assert accel == 0.0


@given(SPEED, st.floats(-100, 100), st.floats(-10, 10), st.floats(2.0, 20.0))
def test_clipped_controls_are_within_every_limit(
    speed: float, accel: float, bend: float, length: float
) -> None:
    limits = Limits()
    a, k = clip_controls(np.asarray(speed), np.asarray(accel), np.asarray(bend), np.asarray(length), limits)
    assert -limits.brake_mps2 <= a <= limits.accel_mps2
    assert abs(k) * speed**2 <= limits.lateral_mps2 + 1e-9
    assert abs(np.arctan(k * wheelbase_m(length))) <= limits.steer_rad + 1e-9
    if (
        -9 <= accel <= 4
        and abs(bend) * max(speed, 0.1) ** 2 <= 6
        and abs(bend) <= np.tan(0.6) / wheelbase_m(length)
    ):
        assert (a, k) == (accel, bend)
