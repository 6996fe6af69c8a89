"""Figures about window files, worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.data.stats import WindowMotion, window_stats
from tests.data.windows_made import random_file, small_file


def test_figures_of_three_cars() -> None:
    found = window_stats([small_file()])
    assert (found["files"], found["maps"], found["windows"], found["scenes"], found["agents"]) == (
        1,
        1,
        2,
        2,
        3,
    )
    assert found["agents_per_window"]["max"] == 2.0
    assert found["classes_share"]["car"] == round(2 / 3, 4)
    assert found["classes_share"]["bus"] == round(1 / 3, 4)
    assert found["parked_share"] == round(1 / 3, 4)
    assert found["moving_share"] == round(2 / 3, 4)
    assert found["waiting_share"] == 0.0
    assert found["focal_moving_share"] == 1.0
    assert found["moving_speed_mps"]["min"] == 5.0
    assert found["moving_speed_mps"]["max"] == 10.0
    assert found["moving_acceleration_mps2"]["max"] == 0.0
    assert found["curvature_1pm"]["max"] == 0.0
    assert found["past_missing_share"] == round(1 / 15, 4)  # the bus, at −2 s
    assert found["future_missing_share"] == round(9 / 36, 4)
    assert found["whole_future_share"] == round(2 / 3, 4)
    assert found["gap_instants"] == 0
    assert found["windows_with_signals_share"] == 1.0


def test_a_gap_lies_between_known_instants() -> None:
    made = small_file()
    made.future_valid[0, 3:5] = False  # the arrays are the test's own
    assert WindowMotion.of(made).gaps == 2
    assert window_stats([made])["gap_instants"] == 2


def test_a_circle_has_its_curvature() -> None:
    made = small_file()
    angle = 0.1 * np.arange(17)
    circle = np.column_stack((20 * np.sin(angle), -20 * np.cos(angle), angle, np.full(17, 4.0)))
    made.past[0], made.future[0] = circle[:5], circle[5:]
    curved = np.sort(WindowMotion.of(made).curvature_1pm)[-16:]
    np.testing.assert_allclose(curved, 0.05, rtol=1e-3)


def test_many_and_no_windows() -> None:
    assert window_stats([random_file(1, 3), random_file(2, 0)])["windows"] == 3
    assert window_stats([random_file(2, 0)])["agents"] == 0
    with pytest.raises(ValueError, match="no window file"):
        window_stats([])
