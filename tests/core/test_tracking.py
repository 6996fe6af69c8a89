"""From plans to states: feasible plans are driven exactly, others within limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from advdiff_sumo.core.bicycle import Limits, clip_controls, rollout, step
from advdiff_sumo.core.frames import local_from_world, unit, wrap_angle
from advdiff_sumo.core.plan import Controls, Trajectory
from advdiff_sumo.core.tracking import State, densify, drive_controls, drive_plan, track

LENGTH, LIMITS, STEP = np.asarray(4.5), Limits(), 0.1
WHEELBASE = 0.6 * 4.5


def start(speed: float = 8.0, yaw: float = 0.3) -> State:
    return np.array((5.0, -2.0)), np.asarray(yaw), np.asarray(speed)


def feasible(seed: int, steps: int = 40) -> State:
    """Return states of a bicycle under random controls within the limits."""
    rng = np.random.default_rng(seed)
    xy, yaw, speed = start()
    bend, accel = rng.uniform(-0.02, 0.02, steps), rng.uniform(-1.5, 2.0, steps)
    return rollout(xy, yaw, speed, accel, bend, STEP)


@given(st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_a_feasible_reference_is_reproduced(seed: int) -> None:
    reference = feasible(seed)
    driven = track(start(), reference, LENGTH, STEP, LIMITS)
    np.testing.assert_allclose(driven[0], reference[0], atol=1e-9)
    np.testing.assert_allclose(wrap_angle(driven[1] - reference[1]), 0.0, atol=1e-9)
    np.testing.assert_allclose(driven[2], reference[2], atol=1e-9)


@given(st.integers(0, 10**6), st.floats(0.0, 30.0))
@settings(max_examples=40, deadline=None)
def test_an_infeasible_reference_is_followed_within_the_limits(seed: int, speed: float) -> None:
    rng = np.random.default_rng(seed)
    steps = 30
    reference = rng.normal(0, 20, (steps, 2)), rng.uniform(-3, 3, steps), rng.uniform(0, 40, steps)
    xy, yaw, pace = track(start(speed), reference, LENGTH, STEP, LIMITS)
    before = np.concatenate(([speed], pace[:-1]))
    turned = wrap_angle(np.diff(np.concatenate(([0.3], yaw))))
    moved = np.hypot(*np.diff(np.concatenate((start()[0][None], xy)), axis=0).T)
    assert (np.diff(np.concatenate(([speed], pace))) <= LIMITS.accel_mps2 * STEP + 1e-9).all()
    assert (before - pace <= LIMITS.brake_mps2 * STEP + 1e-9).all()
    assert (pace >= 0.0).all()
    assert (
        np.abs(turned) <= np.tan(LIMITS.steer_rad) / WHEELBASE * 0.5 * (before + pace) * STEP + 1e-9
    ).all()
    assert (
        np.abs(turned) * np.maximum(before, 0.1) ** 2 <= LIMITS.lateral_mps2 * (before + 0.4) * STEP + 1e-9
    ).all()
    assert (moved <= 0.5 * (before + pace) * STEP + 1e-9).all()


@given(st.integers(0, 10**6), st.sampled_from([(), (1,), (5,)]), st.floats(0.0, 70.0))
@settings(max_examples=40, deadline=None)
def test_tracking_by_single_steps_gives_the_same_bits(
    seed: int, shape: tuple[int, ...], speed: float
) -> None:
    """The control law written with point arrays, step by step."""
    rng = np.random.default_rng(seed)
    reference = (
        rng.normal(0, 20, (*shape, 9, 2)),
        rng.uniform(-3, 3, (*shape, 9)),
        rng.uniform(0, 20, (*shape, 9)),
    )
    state = rng.normal(0, 5, (*shape, 2)), rng.uniform(-3, 3, shape), np.full(shape, speed)
    state, length = (state[0], np.asarray(state[1]), state[2]), np.full(shape, 4.5)
    driven, pose, last = track(state, reference, length, STEP, LIMITS), state, state
    for k in range(9):
        goal = reference[0][..., k, :], reference[1][..., k], reference[2][..., k]
        xy, yaw, pace = pose
        offset = local_from_world(last[0], xy, yaw)
        way = np.maximum(0.5 * (last[2] + goal[2]) * STEP, 1e-6)
        feed = np.where(way > 1e-3, wrap_angle(goal[1] - last[1]) / way, 0.0)
        error = 0.6 * offset[..., 1] + 2.4 * wrap_angle(last[1] - yaw)
        bend = feed + np.minimum(1.0, pace / 2.0) * error / np.maximum(pace, 1.0)
        accel = (goal[2] - last[2]) / STEP + 1.0 * offset[..., 0] + 2.0 * (last[2] - pace)
        pose, last = step(xy, yaw, pace, *clip_controls(pace, accel, bend, length, LIMITS), STEP), goal
        for part, single in zip(
            (driven[0][..., k, :], driven[1][..., k], driven[2][..., k]), pose, strict=True
        ):
            assert np.array_equal(part, single)


@given(st.floats(0.0, 40.0), st.floats(-9.0, 4.0), st.floats(-0.2, 0.2))
@settings(max_examples=60, deadline=None)
def test_a_step_is_the_chord_of_its_arc(speed: float, accel: float, bend: float) -> None:
    """The same bits as a formula with numpy's sinc and point arrays."""
    xy, yaw, pace = np.array((5.0, -2.0)), np.asarray(0.3), np.asarray(speed)
    stop_s = np.where(accel < 0.0, pace / np.maximum(-accel, 1e-9), np.inf)
    moving_s = np.minimum(np.maximum(stop_s, 0.0), STEP)
    travelled = pace * moving_s + 0.5 * accel * moving_s**2
    half = 0.5 * (bend * travelled)
    moved = step(xy, yaw, pace, np.asarray(accel), np.asarray(bend), STEP)[0]
    assert np.array_equal(moved, xy + travelled * np.sinc(half / np.pi) * unit(yaw + half))


def test_an_offset_decays() -> None:
    steps = 80
    x = 5.0 + 0.8 * np.arange(1, steps + 1)
    reference = np.column_stack((x, np.full(steps, -2.0))), np.zeros(steps), np.full(steps, 8.0)
    begin = np.array((5.0, -3.0)), np.asarray(0.0), np.asarray(6.0)  # 1 m to the right, too slow
    xy, yaw, speed = track(begin, reference, LENGTH, STEP, LIMITS)
    assert abs(xy[-1, 1] + 2.0) < 0.02
    assert abs(xy[-1, 0] - x[-1]) < 0.05
    assert abs(yaw[-1]) < 0.01
    assert abs(speed[-1] - 8.0) < 0.05
    assert xy[:, 1].max() < -1.8, "no wild overshoot"


def test_vehicles_side_by_side_do_not_mix() -> None:
    references = [feasible(seed) for seed in (1, 2)]
    both = tuple(np.stack(parts) for parts in zip(*references, strict=True))
    begin = tuple(np.stack((p, p)) for p in start())
    driven = track(begin, both, np.array((4.5, 4.5)), STEP, LIMITS)  # type: ignore[arg-type] # three parts
    for row, reference in enumerate(references):
        np.testing.assert_allclose(driven[0][row], reference[0], atol=1e-9)


def test_controls_are_held_and_the_last_one_continues() -> None:
    controls = Controls(np.array((1.0, -2.0)), np.array((0.05, -0.1)), 0.5)
    driven = drive_controls(start(), controls, LENGTH, STEP, 15, LIMITS)
    accel = np.repeat((1.0, -2.0, -2.0), 5)
    bend = np.tan(np.repeat((0.05, -0.1, -0.1), 5)) / WHEELBASE
    expected = rollout(*start(), accel, bend, STEP)
    for got, wanted in zip(driven, expected, strict=True):
        np.testing.assert_allclose(got, wanted, atol=1e-12)


def test_controls_beyond_the_limits_are_clipped() -> None:
    controls = Controls(np.full(10, 40.0), np.full(10, 1.5), 0.1)
    _, _, speed = drive_controls(start(2.0), controls, LENGTH, STEP, 10, LIMITS)
    np.testing.assert_allclose(np.diff(speed), 0.4, atol=1e-9)
    accel, bend = clip_controls(
        np.asarray(2.0), np.asarray(40.0), np.tan(np.asarray(0.6)) / WHEELBASE, LENGTH, LIMITS
    )
    first = rollout(*start(2.0), np.atleast_1d(accel), np.atleast_1d(bend), STEP)
    one = drive_controls(start(2.0), controls, LENGTH, STEP, 1, LIMITS)
    np.testing.assert_allclose(one[0], first[0], atol=1e-12)


@given(st.integers(0, 10**6), st.integers(1, 6))
@settings(max_examples=40, deadline=None)
def test_densifying_hits_every_keyframe(seed: int, keys: int) -> None:
    rng = np.random.default_rng(seed)
    plan = rng.normal(0, 10, (keys, 2)), rng.uniform(-3, 3, keys), rng.uniform(0, 20, keys)
    xy, yaw, speed = densify(start(), plan, 0.5, STEP, 5 * keys)
    assert len(yaw) == 5 * keys
    np.testing.assert_allclose(xy[4::5], plan[0], atol=1e-9)
    np.testing.assert_allclose(wrap_angle(yaw[4::5] - plan[1]), 0.0, atol=1e-9)
    np.testing.assert_allclose(speed[4::5], plan[2], atol=1e-9)


def test_densifying_constant_speed_is_exact_and_a_parked_vehicle_stays() -> None:
    ahead = np.array((np.cos(0.3), np.sin(0.3)))
    plan = start()[0] + 4.0 * np.arange(1, 4)[:, None] * ahead, np.full(3, 0.3), np.full(3, 8.0)
    xy, _, speed = densify(start(), plan, 0.5, STEP, 15)
    np.testing.assert_allclose(xy, start()[0] + 0.8 * np.arange(1, 16)[:, None] * ahead, atol=1e-9)
    np.testing.assert_allclose(speed, 8.0)
    parked = np.tile(start()[0], (3, 1)), np.full(3, 0.3), np.full(3, 8.0)
    xy, _, _ = densify(start(), parked, 0.5, STEP, 15)
    np.testing.assert_allclose(xy, np.tile(start()[0], (15, 1)), atol=1e-9)


def test_a_trajectory_on_the_model_step_is_driven() -> None:
    reference = feasible(7, 50)
    plan = Trajectory(*(part[4::5] for part in reference), dt_s=0.5)
    xy, _, _ = drive_plan(start(), plan, LENGTH, STEP, 25, LIMITS)
    assert xy.shape == (25, 2)
    assert np.hypot(*(xy - reference[0][:25]).T).max() < 0.3
    same = drive_plan(start(), Trajectory(*reference, dt_s=STEP), LENGTH, STEP, 25, LIMITS)
    np.testing.assert_allclose(same[0], reference[0][:25], atol=1e-9)


def test_a_plan_of_controls_is_driven() -> None:
    controls = Controls(np.array((1.0,)), np.array((0.05,)), 0.5)
    got = drive_plan(start(), controls, LENGTH, STEP, 5, LIMITS)
    expected = drive_controls(start(), controls, LENGTH, STEP, 5, LIMITS)
    assert got[2][-1] == pytest.approx(8.5)
    np.testing.assert_array_equal(got[0], expected[0])
