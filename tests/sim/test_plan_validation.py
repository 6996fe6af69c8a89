"""Plans that no vehicle could drive are refused; the message names the planner and the fault."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.core.errors import EpisodeFailure, PlanRefusedError
from advdiff_sumo.core.plan import MAX_SPEED_MPS, SLACK_M, Controls, JointPlan, Trajectory
from advdiff_sumo.core.plan_form import plan_arrays
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.sim.plan_validation import check_joint_form, check_joint_plan, check_plan

HERE = np.array((3.0, 4.0))


def straight(speed: float = 10.0, steps: int = 5, dt: float = 0.1) -> Trajectory:
    x = HERE[0] + speed * dt * np.arange(1, steps + 1)
    return Trajectory(
        np.column_stack((x, np.full(steps, HERE[1]))), np.zeros(steps), np.full(steps, speed), dt
    )


def joint(speed: float = 10.0) -> JointPlan:
    x = speed * 0.5 * np.arange(1.0, 4.0)
    xy = np.stack((np.column_stack((x, 0 * x)), np.column_stack((x, 0 * x + 5.0))))
    tracks = Tracks(
        ids=("u", "v"),
        classes=np.zeros(2, dtype=np.int64),
        size_m=np.full((2, 2), 2.0),
        xy_m=xy,
        yaw_rad=np.zeros((2, 3)),
        speed_mps=np.full((2, 3), speed),
        valid=np.ones((2, 3), dtype=np.bool_),
        t0_s=0.5,
        dt_s=0.5,
    )
    return JointPlan(tracks)


def test_good_plans_pass() -> None:
    check_plan(straight(), HERE, 0.5, "it")
    check_plan(Controls(np.zeros(5), np.zeros(5), 0.1), HERE, 0.5, "it")
    far = check_joint_plan(joint(), np.array(((0.0, 0.0), (0.0, 5.0))), "it")
    assert far.tolist() == [False, False]


@pytest.mark.parametrize("dtype", [np.float32, np.int64, np.float64])
def test_any_numbers_become_float64(dtype: type) -> None:
    """From (3, 4) with 10 m/s for 0.5 s to (8, 4)."""
    plan = straight(speed=10.0, dt=0.5, steps=1)
    given = replace(plan, **{name: getattr(plan, name).astype(dtype) for name in plan_arrays(plan)})
    taken = check_plan(given, HERE, 0.5, "it")
    assert isinstance(taken, Trajectory)
    assert {getattr(taken, name).dtype for name in plan_arrays(taken)} == {np.dtype(np.float64)}
    assert taken.xy_m.tolist() == [[8.0, 4.0]]
    controls = check_plan(Controls(np.ones(5, dtype), np.zeros(5, dtype), 0.1), HERE, 0.5, "it")
    assert isinstance(controls, Controls)
    assert controls.accel_mps2.dtype == controls.steer_rad.dtype == np.float64


@pytest.mark.parametrize("field", ["xy_m", "yaw_rad", "speed_mps"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_none_are_refused(field: str, value: float) -> None:
    plan = straight()
    wrong = getattr(plan, field).copy()
    wrong[2] = value
    with pytest.raises(
        PlanRefusedError, match="it planned a trajectory that holds values that are not numbers"
    ):
        check_plan(replace(plan, **{field: wrong}), HERE, 0.5, "it")


def test_the_first_value_that_is_no_number_is_named() -> None:
    bent = straight()
    bent.xy_m[2, 1] = bent.xy_m[4, 0] = np.nan
    steer = np.array((0.0, 0.1, -np.inf, 0.0, 0.0))
    with pytest.raises(PlanRefusedError, match=r"not numbers: xy_m\[2, 1\] is nan$"):
        check_plan(bent, HERE, 0.5, "it")
    with pytest.raises(PlanRefusedError, match=r"not numbers: steer_rad\[2\] is -inf$"):
        check_plan(Controls(np.ones(5), steer, 0.1), HERE, 0.5, "it")


@pytest.mark.parametrize("accel", [(np.nan, 0.0), (0.0, np.inf), (51.0, 0.0), (0.0, 1.6)])
def test_impossible_controls_are_refused(accel: tuple[float, float]) -> None:
    plan = Controls(np.full(5, accel[0]), np.full(5, accel[1]), 0.1)
    with pytest.raises(PlanRefusedError, match="it planned"):
        check_plan(plan, HERE, 0.5, "it")


def test_the_bound_on_jumps_is_sharp() -> None:
    bound = MAX_SPEED_MPS * 0.1 + SLACK_M  # 9.5 m in 0.1 s
    for jump, refused in ((bound - 1e-6, False), (bound + 1e-6, True)):
        xy = np.tile(HERE + np.array((jump, 0.0)), (5, 1))
        plan = Trajectory(xy, np.zeros(5), np.zeros(5), 0.1)
        if refused:
            with pytest.raises(PlanRefusedError, match=r"jump of 9\.5 m in 0\.1 s"):
                check_plan(plan, HERE, 0.5, "it")
        else:
            check_plan(plan, HERE, 0.5, "it")


def test_a_jump_within_the_plan_and_a_speed_beyond_all_cars_are_refused() -> None:
    plan = straight()
    torn = plan.xy_m.copy()
    torn[3:] += 20.0
    with pytest.raises(PlanRefusedError, match="jump"):
        check_plan(replace(plan, xy_m=torn), HERE, 0.5, "it")
    with pytest.raises(PlanRefusedError, match=r"a speed of 90\.04 m/s, beyond 90 m/s"):
        check_plan(replace(plan, speed_mps=np.full(5, 90.04)), HERE, 0.5, "it")


ONES, LISTED = np.ones(5), [0.0] * 5


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        (
            straight(steps=4),
            r"Trajectory that cannot be driven: it lasts 0\.4 s, less than one model step of 0\.5 s",
        ),
        (Controls(np.zeros(4), np.zeros(4), 0.1), "Controls that cannot be driven: it lasts 0.4 s"),
        (Controls(np.zeros(0), np.zeros(0), 0.1), "it lasts 0 s, less than one model step"),
        (Trajectory(np.zeros((5, 3)), ONES, ONES, 0.1), r"xy_m has shape \(5, 3\), not \(T, 2\)"),
        (
            Trajectory(np.zeros((5, 2)), ONES, np.zeros(4), 0.1),
            r"do not fit each other in shape: .* speed_mps \(4,\)",
        ),
        (Controls(np.zeros(10), np.zeros(7), 0.1), r"in shape: accel_mps2 \(10,\), steer_rad \(7,\)"),
        (Controls(LISTED, ONES, 0.1), "accel_mps2 is of type list, not a NumPy array"),  # type: ignore[arg-type] # wrong on purpose
        (Controls(ONES, np.ma.masked_array(ONES), 0.1), "steer_rad is of type MaskedArray"),
        (Controls(ONES, np.array(["left"] * 5), 0.1), "steer_rad holds <U4, not numbers"),
        (Controls(ONES, ONES.astype(np.complex128), 0.1), "steer_rad holds complex128, not numbers"),
        (Controls(np.float64(1.0), ONES, 0.1), "accel_mps2 is of type float64, not a NumPy array"),  # type: ignore[arg-type] # as above
        (Controls(np.array(1.0), ONES, 0.1), r"accel_mps2 has shape \(\), not \(T,\)"),
        (
            Controls(np.zeros(10_001), np.zeros(10_001), 0.1),
            "it has 10001 steps, over 10000; plan some seconds",
        ),
        (Controls(ONES, ONES, 0.0), "dt_s is 0.0, not a positive number of seconds"),
        (Controls(ONES, ONES, -0.1), "dt_s is -0.1, not a positive"),
        (Controls(ONES, ONES, 500.0), "dt_s is 500 s, over 10 s; give it in seconds, not in milliseconds"),
        (Controls(ONES, ONES, np.nan), "dt_s is nan, not a positive"),
        (Controls(ONES, ONES, "0.1"), "dt_s is of type str, not a number of seconds"),  # type: ignore[arg-type] # as above
        (Trajectory(None, None, None, 0.1), "xy_m is of type NoneType, not a NumPy array"),  # type: ignore[arg-type] # as above
    ],
)
def test_misshapen_plans_are_refused(plan: Trajectory | Controls, words: str) -> None:
    with pytest.raises(PlanRefusedError, match="it planned .*" + words):
        check_plan(plan, HERE, 0.5, "it")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"dt_s": 0.0}, "dt_s is 0.0, not a positive"),
        ({"ids": ("u", 7)}, "a vehicle whose name is no text"),
        ({"classes": np.array((0, 17))}, "a class that is none, .* for vehicle 'v'"),
        ({"size_m": np.array(((np.nan, 2.0), (4.0, 2.0)))}, "a size that is not positive, for vehicle 'u'"),
        ({"size_m": np.array(((4.0, 2.0), (4.0, -2.0)))}, "a size that is not positive, for vehicle 'v'"),
    ],
)
def test_misshapen_joint_plans_are_refused(change: dict[str, Any], words: str) -> None:
    check_joint_form(joint(), "it")
    with pytest.raises(PlanRefusedError, match="it planned .*" + words):
        check_joint_form(JointPlan(replace(joint().tracks, **change)), "it")
    with pytest.raises(PlanRefusedError, match="it planned tracks of type str, not Tracks"):
        check_joint_form(JointPlan("tracks"), "it")  # type: ignore[arg-type] # that is the test


def test_something_else_than_a_plan_is_refused() -> None:
    with pytest.raises(PlanRefusedError, match="returned a dict, not a Trajectory or Controls"):
        check_plan({}, HERE, 0.5, "it")  # type: ignore[arg-type] # that is the test
    assert issubclass(PlanRefusedError, EpisodeFailure)


def test_a_joint_plan_names_vehicle_and_step() -> None:
    plan = joint()
    plan.tracks.yaw_rad[1, 2] = np.nan
    with pytest.raises(PlanRefusedError, match="not a number for vehicle 'v' at step 2"):
        check_joint_plan(plan, np.zeros((2, 2)), "it")


def test_a_joint_plan_may_hold_nan_where_nobody_is() -> None:
    plan = joint()
    plan.tracks.valid[1] = False
    for part in (plan.tracks.xy_m, plan.tracks.yaw_rad, plan.tracks.speed_mps):
        part[1] = np.nan
    assert not check_joint_plan(plan, np.full((2, 2), (0.0, 0.0)), "it").any()


def test_a_joint_plans_jump_and_speed_are_refused_and_a_far_start_is_told() -> None:
    plan = joint()
    plan.tracks.xy_m[0, 1:] += 60.0
    with pytest.raises(
        PlanRefusedError, match=r"a jump of more than 45\.5 m in 0\.5 s for vehicle 'u' at step 0"
    ):
        check_joint_plan(plan, np.zeros((2, 2)), "it")
    fast = joint()
    fast.tracks.speed_mps[1, 1] = -91.0
    with pytest.raises(PlanRefusedError, match="speed beyond 90 m/s for vehicle 'v' at step 1"):
        check_joint_plan(fast, np.zeros((2, 2)), "it")
    now = np.array(((0.0, 0.0), (0.0, 60.0)))
    assert check_joint_plan(joint(), now, "it").tolist() == [False, True]
    assert check_joint_plan(joint(), np.full((2, 2), np.nan), "it").tolist() == [False, False]


@given(
    st.floats(0.0, 90.0),
    st.floats(-np.pi, np.pi),
    st.floats(0.05, 0.5),
    st.integers(1, 40),
    st.floats(-1e4, 1e4),
)
def test_whatever_drives_below_the_bound_passes(
    speed: float, yaw: float, dt: float, steps: int, offset: float
) -> None:
    ahead = np.arange(1, steps + 1)[:, None] * speed * dt * np.array((np.cos(yaw), np.sin(yaw)))
    start = HERE + offset
    plan = Trajectory(start + ahead, np.full(steps, yaw), np.full(steps, speed), dt)
    check_plan(plan, start, steps * dt, "it")
