"""Series of the charts, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.report.charts import charts_of
from advdiff_sumo.report.series import difference_quotient, nearest_gap, series_of


def _tracks(x_m: list[list[float]], y_m: list[float], speed_mps: list[float]) -> Tracks:
    """Return cars of 5 m by 2 m that head east; NaN in *x_m* where one is absent."""
    x = np.array(x_m)
    there = np.isfinite(x)
    y = np.where(there, np.array(y_m)[:, None], np.nan)
    return Tracks(
        ids=tuple("abcdef"[: len(x)]),
        classes=np.zeros(len(x), dtype=np.int64),
        size_m=np.tile((5.0, 2.0), (len(x), 1)),
        xy_m=np.stack((x, y), axis=-1),
        yaw_rad=np.where(there, 0.0, np.nan),
        speed_mps=np.where(there, np.array(speed_mps)[:, None], np.nan),
        valid=there,
        t0_s=0.0,
        dt_s=0.1,
    )


def test_gap_is_that_of_the_boxes() -> None:
    nan = float("nan")
    tracks = _tracks([[0, 1, 2, 3], [20, 20, 4, nan], [0, nan, 2, nan]], [0.0, 0.0, 6.0], [10.0, 0.0, 10.0])
    # instant 0: c stands 6 m to the left, 2 m wide: 4 m; 1: b is 19 m ahead, 5 m long; 2: overlap; 3: alone
    assert nearest_gap(tracks, 0) == pytest.approx([4.0, 14.0, 0.0, np.nan], nan_ok=True)


def test_nearest_centre_need_not_be_the_nearest_box() -> None:
    tracks = _tracks([[0.0], [9.0], [0.0]], [0.0, 0.0, 8.0], [0.0, 0.0, 0.0])
    assert nearest_gap(tracks, 0) == pytest.approx([4.0])  # b: 9 − 5, although c's centre is nearer (gap 6)


def test_acceleration_is_that_of_the_recorded_steps() -> None:
    # even braking at 3 m/s² shows from the second instant on; where somebody is absent nothing is made up
    assert difference_quotient(10.0 - 0.3 * np.arange(4), 0.1) == pytest.approx(
        [np.nan, -3, -3, -3], nan_ok=True
    )
    speed = np.array([1.0, 2.0, np.nan, 1.0, 1.0])
    assert difference_quotient(speed, 0.1) == pytest.approx([np.nan, 10, np.nan, np.nan, 0], nan_ok=True)


def test_a_car_that_stands_shows_no_motion_before_it_starts() -> None:
    tracks = _tracks([[0.0] * 9], [0.0], [0.0])
    tracks.speed_mps[0, 8] = 0.2  # it starts with the last step
    series = series_of(EpisodeStates(tracks, 0), None)
    assert series.accel_mps2[1:] == pytest.approx([0.0] * 7 + [2.0])
    assert series.jerk_mps3[2:] == pytest.approx([0.0] * 6 + [20.0])


def test_time_to_collision_falls_with_time() -> None:
    k = np.arange(6)
    tracks = _tracks([list(1.0 * k), [25.0] * 6], [0.0, 0.0], [10.0, 0.0])
    series = series_of(EpisodeStates(tracks, 0), "b")
    assert series.ttc_s == pytest.approx(2.0 - 0.1 * k)  # 20 m between bumpers at 10 m/s
    assert series.attacker_mps == pytest.approx(np.zeros(6))


def test_charts_say_what_they_show() -> None:
    tracks = _tracks([[0.0, 1.0]], [0.0], [10.0])
    charts = charts_of(series_of(EpisodeStates(tracks, 0), None), contact_s=0.1)
    speed, accel, jerk, gap, ttc = charts
    assert jerk.summary == "Jerk: nothing to show"
    assert speed.summary.startswith("Speed of the target: least 10.0 m/s at 0.0 s")
    assert [len(chart.curves) for chart in charts] == [1, 1, 0, 0, 0]
    assert accel.summary.startswith("Acceleration of the target: least 0.0 m/s² at 0.1 s")
    assert gap.title == "Gap to the nearest (m)"
    assert ttc.contact_x == "328.0"  # the right end of the plot: 340 − 12


def test_one_instant_has_no_charts() -> None:
    tracks = _tracks([[0.0]], [0.0], [10.0])
    assert charts_of(series_of(EpisodeStates(tracks, 0), None), None) == ()
