"""Derivatives of known motions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.metrics.comfort import comfort


def along(car, speed):
    """Return *car* with positions that fit *speed* (T,)."""
    x = np.concatenate(([0.0], np.cumsum(0.05 * (speed[1:] + speed[:-1]))))
    return replace(car, xy_m=np.stack((x, np.zeros_like(x)), axis=-1), speed_mps=speed)


def test_quadratic_speed_gives_its_acceleration_and_jerk_exactly(straight, record_of) -> None:
    t = 0.1 * np.arange(41)
    speed = 5.0 + 2.0 * t - 0.5 * t**2  # a = 2 - t, j = -1
    ride = comfort(record_of(along(straight("ego", (0, 0), 0, 5), speed)).tracks, 0)
    assert ride.accel_max_mps2 == pytest.approx(2.0)
    assert ride.brake_max_mps2 == pytest.approx(2.0)
    assert ride.accel_mean_mps2 == pytest.approx(np.abs(2.0 - t).mean())
    assert ride.jerk_mean_mps3 == pytest.approx(1.0)
    assert ride.jerk_max_mps3 == pytest.approx(1.0)
    assert ride.lateral_max_mps2 == pytest.approx(0.0, abs=1e-9)


def test_circle_gives_lateral_acceleration(straight, record_of) -> None:
    t = 0.1 * np.arange(121)
    yaw = 3.0 + 0.4 * t  # 10 m/s on a radius of 25 m: 4 m/s^2; the heading wraps on the way
    xy = 25.0 * np.stack((np.sin(yaw), -np.cos(yaw)), axis=-1)
    wrapped = np.angle(np.exp(1j * yaw))
    car = replace(straight("ego", (0, 0), 0, 10, steps=121), xy_m=xy, yaw_rad=wrapped)
    ride = comfort(record_of(car).tracks, 0)
    assert ride.yaw_rate_max_radps == pytest.approx(0.4)
    assert ride.lateral_mean_mps2 == pytest.approx(4.0)
    assert ride.accel_max_mps2 == pytest.approx(0.0, abs=1e-9)


def test_a_step_of_the_heading_is_smoothed(straight, record_of) -> None:
    car = straight("ego", (0, 0), 0, 10)
    car.yaw_rad[20:] += 0.1  # the difference quotient would be 1 rad/s and 10 m/s^2
    ride = comfort(record_of(car).tracks, 0)
    assert ride.yaw_rate_max_radps == pytest.approx(0.136, abs=0.002)


def test_an_instantaneous_lane_change_divides_the_record(straight, record_of) -> None:
    car = straight("ego", (0, 0), 0, 10)
    car.xy_m[20:, 1] += 3.2
    car.yaw_rad[20:] += 0.1
    ride = comfort(record_of(car).tracks, 0)
    assert ride.yaw_rate_max_radps == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("dt_s", [0.05, 0.1, 0.2, 0.5])
def test_the_step_does_not_matter(straight, record_of, dt_s: float) -> None:
    """Two seconds at 8 m/s²: a window of eleven instants, half a second apart, would give 5 m/s²."""
    t = dt_s * np.arange(round(6.0 / dt_s) + 1)
    speed = np.clip(20.0 - 8.0 * (t - 2.0), 4.0, 20.0)
    car = replace(straight("ego", (0, 0), 0, 10, steps=len(t)), speed_mps=speed)
    tracks = replace(record_of(car).tracks, dt_s=dt_s)
    assert comfort(tracks, 0).brake_max_mps2 == pytest.approx(8.0, abs=0.1)


def test_too_short_a_record_has_no_comfort(straight, record_of) -> None:
    ride = comfort(record_of(straight("ego", (0, 0), 0, 10, steps=4)).tracks, 0)
    assert set(vars(ride).values()) == {None}
    assert comfort(
        record_of(straight("ego", (0, 0), 0, 10, steps=5)).tracks, 0
    ).accel_max_mps2 == pytest.approx(0)
