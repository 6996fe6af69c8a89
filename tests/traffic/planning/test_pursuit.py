"""Compiled pursuit drives as the bicycle of core does, and a line is searched from anywhere."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.core.bicycle import step
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.traffic.planning.pursuit import Lines, move, pursue, segment, wrapped


def straight(segments: int = 30) -> Lines:
    """Return two lines along x, 10 m of segments of 1 m, then one of *segments*."""
    s = np.concatenate((np.arange(10.0), np.arange(float(segments))))
    along = np.tile((1.0, 0.0), (len(s), 1))
    first, last = np.array([0, 10]), np.array([9, 9 + segments])
    xy = np.stack((s, np.zeros_like(s)), axis=-1)
    return Lines(xy, along, np.zeros_like(s), s, first, last, np.zeros(2), np.array([10.0, 8.0]))


def test_a_move_is_a_step_of_the_bicycle() -> None:
    """Driving, stopping within the step, standing, and straight on."""
    rng = np.random.default_rng(0)
    states = np.column_stack((rng.normal(size=(50, 2)), rng.uniform(-4, 4, 50), rng.uniform(0, 15, 50)))
    accel, bend = rng.uniform(-9, 3, 50), rng.uniform(-0.2, 0.2, 50)
    states[:10, 3], bend[5:15], accel[40:] = 0.0, 0.0, 0.0
    xy, yaw, speed = step(states[:, :2], states[:, 2], states[:, 3], accel, bend, 0.5)
    for row in range(50):
        move(states[row], accel[row], bend[row], 0.5)
    np.testing.assert_allclose(states, np.column_stack((xy, yaw, speed)), atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 3.0, np.pi, -np.pi, 3.5 * np.pi, -9.0])
def test_angles_are_wrapped_as_everywhere(angle: float) -> None:
    assert wrapped(angle) == wrap_angle(angle)


@pytest.mark.parametrize("begin", [10, 17, 39])
def test_a_segment_is_found_from_before_and_behind_and_lines_go_on(begin: int) -> None:
    lines = straight()
    found = [segment(lines, 1, s, begin) for s in (-5.0, 0.0, 0.99, 1.0, 12.5, 99.0)]
    assert found == [10, 10, 10, 11, 22, 39]


def test_who_is_beside_its_lane_comes_back_and_reaches_the_limit() -> None:
    states = np.array([[0.0, 1.0, 0.1, 6.0], [0.0, 0.0, 0.0, 12.0]])
    made = np.empty((2, 12, 2, 4))
    pursue(straight(), states, np.full(2, 0.3), 6.0, 0.25, made)
    assert abs(made[0, -1, -1, 1]) < 0.1
    np.testing.assert_allclose(made[:, -1, -1, 3], (10.0, 8.0), atol=0.02)
    np.testing.assert_allclose(made[1, :, :, 1:3], 0.0, atol=1e-12)
