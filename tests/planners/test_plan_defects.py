"""Planted defects of brakes and plans: what each does to a plan, computed by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.core.plan import Controls, Trajectory
from advdiff_sumo.planners.defects.actuation import SlowBrakes, StuckReplanning, WeakBrakes
from advdiff_sumo.planners.defects.defective_planner import DefectivePlanner
from advdiff_sumo.planners.defects.misjudgement import LocalisationOffset
from advdiff_sumo.planners.planner_check import same_plan

from .test_defects import Counting, agents, later, stop


def test_weak_brakes_bound_the_deceleration_along_the_path() -> None:
    scene = agents((0.0, 0.0, 0.0, 10.0))
    plan, _ = WeakBrakes(2.5).act(stop(8.0), scene, None)
    assert isinstance(plan, Trajectory)
    assert plan.speed_mps == pytest.approx(10.0 - 2.5 * 0.1 * np.arange(1, 21))
    assert plan.xy_m[-1] == pytest.approx([15.0, 0.0])  # 10 · 2 − 2.5 · 2² / 2
    same, _ = WeakBrakes(8.5).act(stop(8.0), scene, None)
    assert same_plan(same, stop(8.0))
    controls, _ = WeakBrakes(2.5).act(Controls(np.array([1.0, -8.0]), np.zeros(2), 0.5), scene, None)
    assert isinstance(controls, Controls)
    assert controls.accel_mps2.tolist() == [1.0, -2.5]


def test_slow_brakes_build_up_and_continue_in_the_next_plan() -> None:
    """9 m/s² in 4.5 s is 2 m/s³: after half a second 1 m/s², from which the next plan continues."""
    scene = agents((0.0, 0.0, 0.0, 10.0))
    controls = Controls(np.full(10, -8.0), np.zeros(10), 0.1)
    first, memory = SlowBrakes(4.5).act(controls, scene, None)
    second, _ = SlowBrakes(4.5).act(controls, later(scene, 0.5), memory)
    assert isinstance(first, Controls)
    assert isinstance(second, Controls)
    assert first.accel_mps2[:5] == pytest.approx([-0.2, -0.4, -0.6, -0.8, -1.0])
    assert second.accel_mps2[:2] == pytest.approx([-1.2, -1.4])


@pytest.mark.parametrize("dt_s", [0.25, 0.5, 1.0, 2.0])
def test_slow_brakes_build_up_whatever_the_interval(dt_s: float) -> None:
    """2 m/s³ again, and a plan every half second: the fifth begins after 2 s, at 4 m/s²."""
    scene, memory = agents((0.0, 0.0, 0.0, 20.0)), None
    for number in range(5):
        wish = Controls(np.full(4, -8.0), np.zeros(4), dt_s)
        plan, memory = SlowBrakes(4.5).act(wish, later(scene, 0.5 * number), memory)
    assert isinstance(plan, Controls)
    assert plan.accel_mps2[0] == pytest.approx(-(4.0 + 2.0 * dt_s), abs=1e-6)


def test_stuck_continues_the_old_plan_and_then_straight_on() -> None:
    scene = agents((0.0, 0.0, 0.0, 10.0))
    planner = DefectivePlanner(Counting(), (StuckReplanning(3.0),))  # type: ignore[arg-type] # no map is needed
    rng = np.random.default_rng(0)
    memory = planner.start(None, scene, rng)  # type: ignore[arg-type] # the same
    first, memory = planner.plan(None, scene, memory, rng)  # type: ignore[arg-type] # the same
    for seconds in (0.5, 2.5):
        held, memory = planner.plan(None, later(scene, seconds), memory, rng)  # type: ignore[arg-type] # the same
        assert memory.planner == 1
        assert isinstance(held, Trajectory)
        assert isinstance(first, Trajectory)
        if seconds == 0.5:
            assert held.xy_m[:15] == pytest.approx(first.xy_m[5:])
        assert held.xy_m[-1, 0] == pytest.approx(16.0 + 6.0 * seconds, abs=0.01)  # 16 m in 2 s, then 6 m/s
    _, memory = planner.plan(None, later(scene, 3.0), memory, rng)  # type: ignore[arg-type] # the same
    assert memory.planner == 2


def test_faults_before_stuck_act_on_the_continued_plan() -> None:
    """In an earlier version the continued plan was without the faults before it, such as weak brakes."""
    scene = agents((0.0, 0.0, 0.0, 10.0))
    planner = DefectivePlanner(Counting(), (LocalisationOffset(2.0), StuckReplanning(3.0)))  # type: ignore[arg-type] # no map is needed
    rng = np.random.default_rng(0)
    memory = planner.start(None, scene, rng)  # type: ignore[arg-type] # the same
    for seconds in (0.0, 0.5, 1.0):
        plan, memory = planner.plan(None, later(scene, seconds), memory, rng)  # type: ignore[arg-type] # the same
        assert isinstance(plan, Trajectory)
        assert plan.xy_m[:5, 1] == pytest.approx(np.full(5, -2.0))
    assert memory.planner == 1


@given(brake=st.floats(0.5, 8.0), bound=st.floats(0.5, 8.0), speed=st.floats(1.0, 30.0))
def test_braked_plans_never_brake_harder_nor_fall_behind(brake: float, bound: float, speed: float) -> None:
    scene = agents((0.0, 0.0, 0.0, speed))
    plan, _ = WeakBrakes(bound).act(stop(brake, speed), scene, None)
    assert isinstance(plan, Trajectory)
    steps = -np.diff(np.append(speed, plan.speed_mps)) / 0.1
    assert steps.max() <= max(bound, 0.0) + 1e-6
    assert (plan.xy_m[:, 0] >= stop(brake, speed).xy_m[:, 0] - 1e-9).all()
