"""Which plans are recorded: those of the target and of the vehicles nearest to it, at the model step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.core.plan import Controls, JointPlan, Trajectory
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.sim.planned import AHEAD_S, made_plans, natural_course
from advdiff_sumo.sim.sim_options import SimOptions


def tracks(x0_m: list[float], speed_mps: list[float], steps: int, t0_s: float, dt_s: float) -> Tracks:
    """Agents "a", "b", … that drive east, each further north than the one before."""
    agents = len(x0_m)
    along = np.array(speed_mps)[:, None] * dt_s * np.arange(steps)
    x = np.array(x0_m)[:, None] + along
    y = np.broadcast_to(4.0 * np.arange(agents)[:, None], x.shape)
    return Tracks(
        ids=tuple("abcdefgh"[:agents]),
        classes=np.zeros(agents, dtype=np.int64),
        size_m=np.tile((5.0, 2.0), (agents, 1)),
        xy_m=np.stack((x, y), axis=-1),
        yaw_rad=np.zeros_like(x),
        speed_mps=np.repeat(np.array(speed_mps)[:, None], steps, axis=1),
        valid=np.ones_like(x, dtype=np.bool_),
        t0_s=t0_s,
        dt_s=dt_s,
    )


@pytest.fixture
def scene() -> Scene:
    """At 3 s "a", the target, is at 100 m; "b", "c" and "d" are 50, 10 and 30 m ahead of it."""
    history = tracks([80.0, 130.0, 90.0, 110.0], [10.0] * 4, 5, 1.0, 0.5)
    return Scene(history, 0, np.array([False, True, True, True]), ((),) * 4, {})


def test_a_trajectory_is_thinned(scene: Scene) -> None:
    ahead = tracks([101.0], [10.0], 30, 3.1, 0.1)
    plan = Trajectory(ahead.xy_m[0], ahead.yaw_rad[0], ahead.speed_mps[0], 0.1)
    made = made_plans(scene, plan, None, SimOptions())
    assert made is not None
    assert (made.made_s, made.dt_s, made.ids) == (3.0, 0.5, ("a",))
    assert made.xy_m.shape == (1, AHEAD_S / 0.5, 2)
    assert made.xy_m[0, :6, 0] == pytest.approx([105.0, 110.0, 115.0, 120.0, 125.0, 130.0])
    assert np.isnan(made.xy_m[0, 6:]).all()  # it reaches 3 s ahead


def test_controls_are_driven_to_their_end(scene: Scene) -> None:
    made = made_plans(scene, Controls(np.full(4, -2.0), np.zeros(4), dt_s=0.5), None, SimOptions())
    assert made is not None
    t = np.array([0.5, 1.0, 1.5, 2.0])
    assert made.xy_m[0, :4, 0] == pytest.approx(100.0 + 10.0 * t - t**2, abs=0.06)  # 0.1 s steps
    assert np.isnan(made.xy_m[0, 4:]).all()


def test_plans_between_the_model_steps_are_interpolated(scene: Scene) -> None:
    joint = JointPlan(tracks([0.0, 152.0], [10.0] * 2, 4, 3.2, 0.5).rows([1]))
    made = made_plans(scene, None, joint, SimOptions())
    assert made is not None
    assert made.xy_m[0, :3, 0] == pytest.approx([155.0, 160.0, 165.0])
    assert np.isnan(made.xy_m[0, 3:]).all()


def test_of_the_background_the_nearest_are_kept(scene: Scene) -> None:
    joint = JointPlan(tracks([0.0, 155.0, 115.0, 135.0], [10.0] * 4, 12, 3.5, 0.5).rows([1, 2, 3]))
    made = made_plans(scene, None, joint, SimOptions(record_plans=2))
    assert made is not None
    assert made.ids == ("c", "d")
    assert made.xy_m[:, 0, 0] == pytest.approx([115.0, 135.0])
    assert np.isfinite(made.xy_m).all()


def test_a_vehicle_that_appears_later_is_last_and_starts_later(scene: Scene) -> None:
    joint = JointPlan(tracks([0.0, 155.0, 115.0, 135.0, 140.0], [10.0] * 5, 12, 3.5, 0.5).rows([4, 1]))
    there = joint.tracks.valid.copy()
    there[0, :3] = False
    xy = np.where(there[..., None], joint.tracks.xy_m, np.nan)
    late = JointPlan(replace(joint.tracks, valid=there, xy_m=xy))
    made = made_plans(scene, None, late, SimOptions())
    assert made is not None
    assert made.ids == ("b", "e")
    assert np.flatnonzero(np.isfinite(made.xy_m[1, :, 0])).tolist() == list(range(3, 12))


def test_none_are_kept_where_none_are_wanted_or_made(scene: Scene) -> None:
    joint = JointPlan(tracks([0.0, 155.0], [10.0] * 2, 12, 3.5, 0.5).rows([1]))
    assert made_plans(scene, None, joint, SimOptions(record_plans=0)) is None
    assert made_plans(scene, None, None, SimOptions()) is None
    assert made_plans(scene, None, JointPlan(Tracks.empty()), SimOptions()) is None


def test_the_natural_course_begins_at_the_start() -> None:
    log = tracks([-20.0, 0.0], [10.0, 0.0], 61, -2.0, 0.1)
    gone = log.valid.copy()
    gone[1, 15:] = False
    xy = np.where(gone[..., None], log.xy_m, np.nan)
    course = natural_course(replace(log, valid=gone, xy_m=xy), 0.5)
    assert course.ids == ("a",)
    assert course.times_s == pytest.approx([0.5 * k for k in range(9)])
    assert course.xy_m[0, :, 0] == pytest.approx([5.0 * k for k in range(9)])
    assert natural_course(Tracks.empty(), 0.5).agents == 0
