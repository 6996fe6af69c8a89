"""Distances and speeds of speed profiles, worked by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S, SpeedProfile, drive_profiles


def at(seconds: float) -> int:
    return int(np.flatnonzero(np.isclose(CHECK_TIMES_S, seconds))[0])


def test_a_stop_takes_the_braking_distance() -> None:
    driven, speed = drive_profiles(np.array([12.0]), [SpeedProfile(then_mps2=-6.0)])
    assert speed[0, at(1.0)] == pytest.approx(6.0)
    assert driven[0, at(2.0)] == pytest.approx(12.0)  # v² / 2b
    assert driven[0, -1] == pytest.approx(12.0)
    assert speed[0, -1] == 0.0


def test_the_second_acceleration_begins_at_its_time() -> None:
    driven, speed = drive_profiles(np.array([10.0]), [SpeedProfile(0.0, 1.0, -5.0)])
    assert speed[0, at(1.0)] == pytest.approx(10.0)
    assert speed[0, at(2.0)] == pytest.approx(5.0)
    assert driven[0, at(3.0)] == pytest.approx(20.0)


def test_bounds_hold_and_a_speed_beyond_them_is_kept() -> None:
    profiles = [
        SpeedProfile(2.0, 9.0, 0.0, highest_mps=13.0),
        SpeedProfile(-4.0, 9.0, 0.0, lowest_mps=3.0),
        SpeedProfile(2.0, 9.0, 0.0, highest_mps=13.0),
    ]
    _, speed = drive_profiles(np.array([10.0, 10.0, 15.0]), profiles)
    assert speed[:, -1] == pytest.approx([13.0, 3.0, 15.0])


@given(st.floats(0.0, 40.0), st.floats(-9.0, 3.0), st.floats(0.0, 6.0), st.floats(-9.0, 3.0))
def test_no_vehicle_drives_backwards(speed: float, first: float, switch: float, then: float) -> None:
    driven, speeds = drive_profiles(np.array([speed]), [SpeedProfile(first, switch, then)])
    assert (np.diff(driven[0], prepend=0.0) >= 0.0).all()
    assert (speeds >= 0.0).all()
