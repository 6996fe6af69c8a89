"""Windows out of tracks: three cars on a lane, worked by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data.window_arrays import WindowArrays, crop, crops, window_arrays
from tests.data.windows_made import PARKED, small_file, straight_table, three_cars


def window(tracks: Tracks, now: int, focal: int) -> WindowArrays:
    rows = crop(tracks.xy_m[:, now], focal)
    return window_arrays(tracks, now, rows, PARKED, straight_table(), {"J": "y"}, "s")


def test_the_focal_agent_comes_first_then_the_nearest_within_60_m() -> None:
    tracks = three_cars()
    assert crop(tracks.xy_m[:, 4], 0).tolist() == [0, 1]  # "c" is 80 m away
    assert crop(tracks.xy_m[:, 6], 2).tolist() == [2]  # the others are 75 m away
    assert crop(tracks.xy_m[:, 9], 0).tolist() == [0, 1]
    assert crop(np.array([[0, 0], [60, 0], [0, 60.1], [np.nan, 0]]), 0).tolist() == [0, 1]
    assert crop(np.zeros((40, 2)), 7).tolist() == [7, *(i for i in range(24) if i != 7)]


def test_crops_share_little() -> None:
    xy = np.column_stack((5.0 * np.arange(40), np.zeros(40)))
    found = [rows.tolist() for rows in crops(xy, np.arange(40), most=3, apart=4)]
    assert [rows[0] for rows in found] == [0, 4, 6]  # 0 takes 1 to 3, 4 takes 3, 5 and 2
    assert len(list(crops(xy, np.arange(40), most=2))) == 2


def test_past_and_future_of_a_car_that_drives_10_mps() -> None:
    made = window(three_cars(), 4, 0)
    np.testing.assert_allclose(made.past[0, :, 0], [0, 5, 10, 15, 20])
    np.testing.assert_allclose(made.future[0, :, 0], 25.0 + 5.0 * np.arange(12))
    np.testing.assert_allclose(made.past[0, :, 1:], [[0, 0, 10]] * 5)
    assert made.past_valid[0].all()
    assert made.future_valid[0].all()
    assert made.parked.tolist() == [False, True]
    assert made.signals.tolist() == [2]
    assert made.near[0, :3].tolist() == [0, 1, 2]  # at x = 20 the first two are equally near
    assert window(three_cars(), 5, 0).near[0, :3].tolist() == [1, 0, 2]  # 1 m, 5 m behind, 0.4 × 15 m ahead
    assert made.near[0, 28] == 5  # the road's edge comes after the 28 lanes


def test_what_is_not_known_is_zero_and_masked() -> None:
    made = window(three_cars(), 6, 2)
    assert made.past_valid[0].tolist() == [False, True, True, True, True]
    assert made.future_valid[0].tolist() == [True] * 3 + [False] * 9
    assert not made.past[0, 0].any()
    assert not made.future[0, 3:].any()
    assert np.isfinite(made.past).all()


def test_windows_at_the_ends_of_the_tracks() -> None:
    made = window(three_cars(), 1, 0)
    assert made.past_valid[0].tolist() == [False, False, False, True, True]
    made = window(three_cars(), 18, 0)
    assert made.future_valid[0].tolist() == [True] + [False] * 11


def test_an_agent_that_is_absent_now_is_refused() -> None:
    with pytest.raises(ValueError, match="is not there"):
        window_arrays(three_cars(), 1, np.array([2]), PARKED, straight_table(), {}, "s")


def test_the_file_is_relative_to_the_middle_of_the_map() -> None:
    made = small_file()
    np.testing.assert_array_equal(made.map_origin, [50.0, -1.0])
    assert made.offset.tolist() == [0, 2, 3]  # a and b, then c alone
    focal = made.rows(0).start
    np.testing.assert_allclose(made.past[focal, -1], [20.0 - 50.0, 1.0, 0.0, 10.0])
    assert made.signals.tolist() == [[1], [3]]
    assert made.scene.tolist() == [0, 1]


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_the_order_of_the_tracks_does_not_matter(seed: int) -> None:
    tracks = three_cars()
    order = np.random.default_rng(seed).permutation(3)
    mixed = tracks.rows(order)
    rows = crop(mixed.xy_m[:, 4], int(np.flatnonzero(order == 0)[0]))
    other = window_arrays(mixed, 4, rows, PARKED[order], straight_table(), {"J": "y"}, "s")
    made = window(tracks, 4, 0)
    for name in ("past", "past_valid", "future", "future_valid", "size", "classes", "parked", "near"):
        np.testing.assert_array_equal(getattr(made, name), getattr(other, name))


@settings(max_examples=20, deadline=None)
@given(x=st.floats(-1e5, 1e5), y=st.floats(-1e5, 1e5))
def test_a_shifted_world_gives_the_same_window_shifted(x: float, y: float) -> None:
    cars, table, shift = three_cars(), straight_table(), np.array([x, y])
    off_ties = np.array([0.3, 0.0])  # no piece at exactly 60 m, where rounding would decide
    tracks = replace(cars, xy_m=cars.xy_m + off_ties)
    moved = replace(tracks, xy_m=tracks.xy_m + shift)
    there = window_arrays(
        moved, 4, crop(moved.xy_m[:, 4], 0), PARKED, replace(table, xy_m=table.xy_m + shift), {}, "s"
    )
    here = window(tracks, 4, 0)
    np.testing.assert_allclose(there.past[..., :2] - shift, here.past[..., :2], atol=1e-9)
    np.testing.assert_array_equal(there.past[..., 2:], here.past[..., 2:])
    assert set(there.near[0][there.near[0] >= 0]) == set(here.near[0][here.near[0] >= 0])
