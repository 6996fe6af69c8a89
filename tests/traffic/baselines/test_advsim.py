"""AdvSim's actions and costs, worked by hand and as properties, and its search on a street."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.model_options import MODEL_STEP_S, ModelOptions
from advdiff_sumo.models.view import look
from advdiff_sumo.traffic.baselines.advsim import AdvSim
from advdiff_sumo.traffic.baselines.advsim_actions import Initial, drive, initial_of, tightest_curvature
from advdiff_sumo.traffic.baselines.advsim_cost import (
    attack_cost,
    discomfort,
    ground_of,
    keeps_constraints,
    violation,
)
from advdiff_sumo.traffic.baselines.baseline_options import AdvSimOptions
from advdiff_sumo.traffic.baselines.baseline_policy import SearchTask, cut

Street = Callable[..., Scene]
PLACES = [(60.0, 0.0), (78.0, 0.0), (42.0, 0.0), (95.0, 0.0)]
SPEEDS = [8.0, 7.0, 9.0, 6.0]
OPTIONS, MODEL = AdvSimOptions(), ModelOptions()


def begun(speed: float, accel: float = 0.0, curvature: float = 0.0) -> Initial:
    steps = torch.ones(1, 6)
    return Initial(
        torch.tensor([[0.0, 0.0, 0.0, speed]]),
        torch.tensor([4.6]),
        accel * steps,
        curvature * steps,
        torch.tensor([[accel, curvature]]),
    )


def test_a_change_by_hand() -> None:
    """To brake by 6 m/s² more, it may change by 5 m/s² in the first half second and reach 6 m/s² in the second."""
    changes = torch.zeros(1, 1, 2, 2)
    changes[..., 0] = -1.0
    made = drive(changes, begun(20.0, 1.0), OPTIONS, MODEL)
    assert made.accel[0, 0].tolist() == [-4.0, -5.0, 0.0, 1.0, 1.0, 1.0]
    assert float(made.speed[0, 0, 1]) == pytest.approx(20.0 - 2.0 - 2.5)


def test_a_bend_by_hand() -> None:
    """At 10 m/s 6 m/s² of lateral acceleration is 0.06/m; 8 m/s³ allows a change of 0.04/m each half second."""
    changes = torch.zeros(1, 1, 3, 2)
    changes[..., 1] = 1.0
    made = drive(changes, begun(10.0), AdvSimOptions(steer_share=1.0), MODEL)
    assert made.curvature[0, 0, :4].tolist() == pytest.approx([0.04, 0.06, 0.06, 0.02])


def test_no_change_is_the_initial_sequence(downtown: RoadMap, street: Street, weights: str) -> None:
    view = look(downtown, street(PLACES, SPEEDS))
    policy = AdvSim(weights=weights, initial="model")
    with torch.no_grad():
        rollout = policy.driver(view.batch)
    rows = torch.tensor([1, 2])
    made = drive(torch.zeros(1, 2, 8, 2), initial_of(rollout, view.batch, rows), OPTIONS, policy.model)
    assert torch.equal(made.accel[0], rollout.accel[0, rows])
    assert torch.allclose(made.states()[0], rollout.states()[0, rows], atol=1e-4)


def largest_curvature(speed: torch.Tensor, length: torch.Tensor) -> torch.Tensor:
    """Return the largest curvature that steering angle and lateral acceleration allow at *speed*."""
    grip = MODEL.lateral_mps2 / speed.clamp(min=0.1) ** 2
    return torch.minimum(tightest_curvature(length, MODEL), grip)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    speed=st.floats(0.0, 30.0),
    accel=st.floats(-8.0, 4.0),
    turn=st.floats(-1.0, 1.0),
)
def test_bounds_hold_for_all_changes(seed: int, speed: float, accel: float, turn: float) -> None:
    changes = 4.0 * torch.rand(5, 1, 6, 2, generator=torch.Generator().manual_seed(seed)) - 2.0
    first = begun(speed, accel)
    curvature = turn * float(largest_curvature(torch.tensor(speed), torch.tensor(4.6)))
    initial = begun(speed, accel, curvature)
    made = drive(changes, initial, OPTIONS, MODEL)
    assert bool((made.accel >= -MODEL.brake_mps2).all() and (made.accel <= MODEL.accel_mps2).all())
    before = torch.cat((first.pose[None, :, 3:].expand(5, 1, 1), made.speed[..., :-1]), dim=2)
    limit = largest_curvature(before, torch.tensor([4.6])[None, :, None])
    assert bool((made.curvature.abs() <= limit + 1e-6).all())
    jump = torch.diff(made.accel, dim=2, prepend=torch.full((5, 1, 1), accel)).abs()
    assert float(jump.max()) <= OPTIONS.jerk_mps3 * MODEL_STEP_S + 1e-5


def test_costs_by_hand(downtown: RoadMap, street: Street) -> None:
    """An attacker 20 m behind the target's centre leaves 15.4 m between boxes of 4.6 m."""
    view = look(downtown, street([(60.0, 0.0), (40.0, 0.0), (50.0, 0.0)], [0.0, 0.0, 0.0]))
    states = view.batch.pose[:, :, None].repeat(1, 1, 4, 1)
    zero = torch.zeros(states.shape[:3])
    rollout = Rollout(states[..., :2], states[..., 2], states[..., 3], zero, zero)
    row = torch.tensor([view.ids.index("v1")])
    ground = ground_of(rollout, view.batch, row, 4)
    own = Rollout(*(part[:, row] for part in (rollout.xy, rollout.yaw, rollout.speed, zero, zero)))
    soft = 0.5 * np.log(8.0)  # eight half steps at the same distance
    assert float(attack_cost(own, ground)) == pytest.approx(15.4 - soft, abs=1e-3)
    assert float(violation(own, ground)) == pytest.approx(0.0, abs=1e-5)
    ahead = torch.tensor([torch.cos(states[0, 0, 0, 2]), torch.sin(states[0, 0, 0, 2])])
    inside = Rollout(own.xy + 6.4 * ahead, own.yaw, own.speed, own.accel, own.curvature)
    assert float(violation(inside, ground)) == pytest.approx(1.0, abs=1e-3)
    assert not keeps_constraints(float(violation(inside, ground)), ground)


def test_discomfort_by_hand() -> None:
    """Speeds 10, 9, 9: −2 and 0 m/s² on average 1; a change of 2 in half a second is 4 m/s³."""
    states = torch.zeros(3, 4)
    states[:, 3] = torch.tensor([10.0, 9.0, 9.0])
    assert discomfort(states) == pytest.approx(1.0 + 4.0)


@pytest.mark.parametrize("surrogate", ["model", "lane_graph"])
def test_the_search_beats_its_start_and_keeps_its_constraints(
    surrogate: str, weights: str, downtown: RoadMap, street: Street
) -> None:
    scene = street(PLACES, SPEEDS)
    policy = AdvSim(weights=weights, initial="model", rounds=10, candidates=16, surrogate=surrogate)
    memory = policy.start(downtown, scene, None, np.random.default_rng(0))
    task = SearchTask(downtown, look(downtown, scene), memory, 3)
    found = policy.search(task)
    assert found.losses[4] < found.losses[0]  # within the first block, against one reaction of the surrogate
    with torch.no_grad():
        natural = policy.driver(task.view.batch)
    rows = torch.tensor([task.view.ids.index(name) for name in found.drawn.attackers])
    untouched = [row for row in range(len(task.view.ids)) if row not in rows.tolist()]
    assert torch.equal(found.drawn.rollout.xy[:, untouched], natural.xy[:, untouched])
    ground = ground_of(natural, task.view.batch, rows, 8)
    before, after = (
        Rollout(*(p[:, rows] for p in (r.xy, r.yaw, r.speed, r.accel, r.curvature)))
        for r in (cut(natural, 8), cut(found.drawn.rollout, 8))
    )
    allowed = float(violation(before, ground)) + 0.02
    assert float(violation(after, ground)) <= allowed
    if surrogate == "model":  # the target does not react, so both costs are comparable
        assert float(attack_cost(after, ground)) < float(attack_cost(before, ground))


def test_the_next_search_starts_one_step_later(weights: str, downtown: RoadMap, street: Street) -> None:
    scene = street(PLACES, SPEEDS)
    policy = AdvSim(weights=weights, initial="model", rounds=5, candidates=8, surrogate="model", attackers=1)
    memory = policy.start(downtown, scene, None, np.random.default_rng(0))
    view = look(downtown, scene)
    first = policy.search(SearchTask(downtown, view, memory, 3)).memory
    (name,) = first.attackers
    old = first.searched[name].reshape(8, 2)
    assert old.any()
    with torch.no_grad():
        rollout = policy.driver(view.batch)
        case = policy._case(SearchTask(downtown, view, first, 4), view.batch, rollout)
    assert case is not None
    warm = policy._previous_changes(case).numpy()[0]
    np.testing.assert_allclose(warm, np.vstack((old[1:], np.zeros((1, 2)))), atol=1e-6)
    made = replace(view.now, t0_s=view.scene.time_s - 0.5)  # a plan made one second ago
    warm = policy._previous_changes(
        replace(case, task=replace(case.task, memory=replace(first, plan=made)))
    ).numpy()[0]
    np.testing.assert_allclose(warm, np.vstack((old[2:], np.zeros((2, 2)))), atol=1e-6)
