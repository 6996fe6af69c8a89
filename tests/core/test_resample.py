"""Resampling: worked by hand, then what must hold for any tracks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from advdiff_sumo.core.frames import unit, wrap_angle
from advdiff_sumo.core.resample import resample
from advdiff_sumo.core.scene import Tracks


def tracks(xy: object, yaw: object, speed: object, dt_s: float = 0.5, t0_s: float = 0.0) -> Tracks:
    """Return tracks (A, T) whose NaN headings are invalid."""
    yaw_rad = np.atleast_2d(np.asarray(yaw, dtype=np.float64))
    agents, steps = yaw_rad.shape
    return Tracks(
        ids=tuple(f"v{i}" for i in range(agents)),
        classes=np.zeros(agents, dtype=np.int64),
        size_m=np.tile([4.5, 1.8], (agents, 1)),
        xy_m=np.asarray(xy, dtype=np.float64).reshape(agents, steps, 2),
        yaw_rad=yaw_rad,
        speed_mps=np.asarray(speed, dtype=np.float64).reshape(agents, steps),
        valid=np.isfinite(yaw_rad),
        t0_s=t0_s,
        dt_s=dt_s,
    )


def test_constant_acceleration_is_followed_exactly() -> None:
    t, fine = np.arange(5) * 0.5, np.arange(21) * 0.1
    x, v = 3.0 * t + t**2, 3.0 + 2.0 * t
    got = resample(tracks(np.column_stack((x, 0 * t)), 0 * t, v, t0_s=-1.0), 0.1)
    assert (got.t0_s, got.dt_s, got.steps) == (-1.0, 0.1, 21)
    np.testing.assert_allclose(got.xy_m[0, :, 0], 3.0 * fine + fine**2, atol=1e-12)
    np.testing.assert_allclose(got.speed_mps[0], 3.0 + 2.0 * fine, atol=1e-12)


def test_a_circle_stays_within_a_centimetre() -> None:
    radius, t, fine = 10.0, np.arange(9) * 0.5, np.arange(41) * 0.1
    angle = 0.5 * t  # 5 m/s
    arc = radius * np.column_stack((np.cos(angle), np.sin(angle)))
    got = resample(tracks(arc, wrap_angle(angle + np.pi / 2), np.full(9, 5.0)), 0.1)
    np.testing.assert_allclose(np.linalg.norm(got.xy_m[0], axis=-1), radius, atol=0.01)
    np.testing.assert_allclose(wrap_angle(got.yaw_rad[0] - 0.5 * fine - np.pi / 2), 0.0, atol=1e-9)
    np.testing.assert_allclose(got.speed_mps[0], 5.0, atol=0.05)


def test_the_heading_takes_the_short_way_round() -> None:
    got = resample(tracks(np.zeros((2, 2)), [3.0, -3.0], [0.0, 0.0]), 0.25)
    assert abs(wrap_angle(got.yaw_rad[0, 1] - np.pi)) < 1e-9


def test_a_parked_car_does_not_jitter() -> None:
    noise = np.array([[0.0, 0.0], [0.05, 0.02], [0.05, 0.02], [0.0, 0.04]])
    got = resample(tracks(noise, np.zeros(4), np.zeros(4)), 0.1)
    assert np.ptp(got.xy_m[0, 5:11], axis=0).max() == 0.0
    assert (np.diff(got.xy_m[0, :6], axis=0) >= 0.0).all()


def test_a_car_that_stops_does_not_roll_past() -> None:
    x = np.array([0.0, 3.0, 3.1, 3.1])
    got = resample(tracks(np.column_stack((x, 0 * x)), 0 * x, [8.0, 4.0, 0.1, 0.0]), 0.1)
    assert (np.diff(got.xy_m[0, :, 0]) >= -1e-12).all()
    assert got.xy_m[0, :, 0].max() <= 3.1 + 1e-12
    assert got.speed_mps.min() >= -1e-12


def test_a_car_that_reverses_faces_forward() -> None:
    x = -1.0 * np.arange(4)
    got = resample(tracks(np.column_stack((x, 0 * x)), 0 * x, np.full(4, -2.0)), 0.1)
    np.testing.assert_allclose(got.speed_mps, -2.0)
    np.testing.assert_array_equal(got.yaw_rad, 0.0)


def test_a_pedestrian_whose_box_lies_across_walks_straight() -> None:
    y = 0.7 * np.arange(4)
    got = resample(tracks(np.column_stack((0 * y, y)), 0 * y, np.zeros(4)), 0.1)
    np.testing.assert_allclose(np.diff(got.xy_m[0, :, 1]), 0.14)


def test_gaps_are_left_open_unless_bridged() -> None:
    x = 2.5 * np.arange(5.0)
    x[2] = np.nan
    yaw = np.where(np.isnan(x), np.nan, 0.0)
    logged = tracks(np.column_stack((x, 0 * x)), yaw, np.where(np.isnan(x), np.nan, 5.0))
    got = resample(logged, 0.1)
    assert got.valid[0].tolist() == [True] * 6 + [False] * 9 + [True] * 6
    bridged = resample(logged, 0.1, max_gap_s=1.0)
    assert bridged.valid.all()
    np.testing.assert_allclose(bridged.xy_m[0, :, 0], 0.5 * np.arange(21))


def test_another_clock_and_length() -> None:
    x = np.column_stack((5.0 * np.arange(3), np.zeros(3)))
    got = resample(tracks(x, np.zeros(3), np.full(3, 10.0)), 0.2, t0_s=-0.2, steps=8)
    assert got.valid[0].tolist() == [False] + [True] * 6 + [False]
    np.testing.assert_allclose(got.xy_m[0, 1:7, 0], 2.0 * np.arange(6), atol=1e-12)


def test_empty_and_absent() -> None:
    assert resample(Tracks.empty(steps=3), 0.1).xy_m.shape == (0, 11, 2)
    absent = tracks(np.full((3, 2), np.nan), np.full(3, np.nan), np.full(3, np.nan))
    assert not resample(absent, 0.1).valid.any()
    with pytest.raises(ValueError, match="dt_s=0"):
        resample(absent, 0.0)


def _random(seed: int, steps: int, scale: float, gap: float) -> Tracks:
    rng = np.random.default_rng(seed)
    yaw = rng.uniform(-np.pi, np.pi, (3, steps))
    yaw[rng.random((3, steps)) < gap] = np.nan
    there = np.isfinite(yaw)
    xy = np.where(there[..., None], rng.normal(0.0, scale, (3, steps, 2)).cumsum(1), np.nan)
    return tracks(xy, yaw, np.where(there, rng.normal(0.0, 2 * scale, (3, steps)), np.nan), t0_s=-2.0)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**31), st.integers(1, 12), st.sampled_from([0.001, 0.3, 6.0]), st.sampled_from([0, 0.3])
)
def test_any_tracks(seed: int, steps: int, scale: float, gap: float) -> None:
    logged = _random(seed, steps, scale, gap)
    got = resample(logged, 0.1)
    # exact at the keyframes
    np.testing.assert_array_equal(got.xy_m[:, ::5], logged.xy_m)
    np.testing.assert_array_equal(got.yaw_rad[:, ::5], logged.yaw_rad)
    # valid exactly between valid neighbours, finite exactly where valid
    between = logged.valid[:, 1:] & logged.valid[:, :-1]
    for k in range(1, 5):
        np.testing.assert_array_equal(got.valid[:, k::5], between)
    for values in (got.xy_m[..., 0], got.xy_m[..., 1], got.yaw_rad, got.speed_mps):
        np.testing.assert_array_equal(np.isfinite(values), got.valid)
    # no overshoot along a chord, and never further aside than Fritsch-Carlson slopes allow
    for row, k in np.argwhere(between):
        chord = logged.xy_m[row, k + 1] - logged.xy_m[row, k]
        length = np.linalg.norm(chord)
        along = (got.xy_m[row, 5 * k : 5 * k + 6] - logged.xy_m[row, k]) @ chord / length
        assert (np.diff(along) >= -1e-9).all()
        assert np.abs(got.yaw_rad[row, 5 * k : 5 * k + 6]).max() <= np.pi
    # the way back gives the same keyframes
    back = resample(got, 0.5)
    np.testing.assert_array_equal(back.valid, logged.valid)
    np.testing.assert_array_equal(back.xy_m, logged.xy_m)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([0.05, 1.0, 8.0]))
def test_speed_is_the_derivative_and_has_no_jump(seed: int, scale: float) -> None:
    got = resample(_random(seed, 6, scale, 0.0), 0.01)
    velocity = (got.xy_m[:, 2:] - got.xy_m[:, :-2]) / 0.02
    along = (velocity * unit(got.yaw_rad[:, 1:-1])).sum(-1)
    bound = 0.02 * max(1.0, np.abs(np.diff(velocity, axis=1)).max() / 0.01)
    assert np.abs(along - got.speed_mps[:, 1:-1]).max() <= bound
    jump = np.linalg.norm(np.diff(velocity, axis=1), axis=-1)
    smooth = np.linalg.norm(velocity, axis=-1).max() * 0.25
    assert jump.max() <= smooth + 1e-9
