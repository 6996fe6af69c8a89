"""Deviations from a natural plan, worked by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.tensor_bicycle import step
from advdiff_sumo.traffic.rl.steer import curvature_span, steered_futures

OPTIONS = ModelOptions()
STEPS = 6


def batch(speeds: list[float]) -> SceneBatch:
    """Return vehicles of 4.5 × 1.8 m side by side, headed east."""
    count = len(speeds)
    past = torch.zeros(1, count, 5, 4)
    past[..., 1] = 4.0 * torch.arange(count)[:, None]
    past[..., 3] = torch.tensor(speeds)[:, None]
    yes = torch.ones(1, count, dtype=torch.bool)
    nothing = torch.zeros(1, count, 1)
    return SceneBatch(
        past=past,
        past_valid=yes[..., None].expand(-1, -1, 5),
        size=torch.tensor([4.5, 1.8]).expand(1, count, 2),
        classes=torch.zeros(1, count, dtype=torch.long),
        present=yes,
        moved=yes,
        parked=~yes,
        map_xy=nothing,
        map_features=nothing,
        map_valid=nothing,
        future=nothing,
        future_valid=nothing,
    )


def natural(scene: SceneBatch, accel: float = 0.0, curvature: float = 0.0) -> Rollout:
    """Return the futures of vehicles with the same constant actions."""
    pose = scene.pose
    motion = pose[..., :2], pose[..., 2], pose[..., 3]
    push, turn = torch.full_like(motion[1], accel), torch.full_like(motion[1], curvature)
    states = []
    for _ in range(STEPS):
        motion = step(*motion, push, turn, 0.5)
        states.append((*motion, push, turn))
    return Rollout(*(torch.stack(column, dim=2) for column in zip(*states, strict=True)))


def one(scene: SceneBatch, plan: Rollout, residual: tuple[float, float], row: int = 1) -> Rollout:
    return steered_futures(plan, scene, torch.tensor([row]), torch.tensor([residual]), OPTIONS)


@pytest.mark.parametrize(("accel", "curvature"), [(0.0, 0.0), (1.3, 0.02), (-3.0, -0.05)])
def test_no_deviation_is_exactly_the_natural_plan(accel: float, curvature: float) -> None:
    scene = batch([8.0, 10.0])
    plan = natural(scene, accel, curvature)
    made = one(scene, plan, (0.0, 0.0))
    for name in ("xy", "yaw", "speed", "accel", "curvature"):
        assert torch.equal(getattr(made, name), getattr(plan, name)), name


def test_an_action_of_one_half_is_2_mps2_for_half_a_second() -> None:
    scene = batch([8.0, 10.0])
    made = one(scene, natural(scene), (0.5, 0.0))
    assert made.accel[0, 1].tolist() == [2.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert made.speed[0, 1].tolist() == [11.0] * STEPS
    assert made.xy[0, 1, 0, 0].item() == pytest.approx(10.0 * 0.5 + 0.5 * 2.0 * 0.25)


def test_a_full_turn_is_3_mps2_of_lateral_acceleration_and_is_corrected_later() -> None:
    """At 10 m/s κ = 3 / 10² = 0.03; over 5 m that is 0.15 rad, of which half remains after each step."""
    scene = batch([8.0, 10.0])
    made = one(scene, natural(scene), (0.0, 1.0))
    assert made.curvature[0, 1, 0].item() == pytest.approx(0.03)
    assert made.yaw[0, 1].tolist() == pytest.approx([0.15 * 0.5**k for k in range(STEPS)], abs=1e-6)
    assert made.xy[0, 1, -1, 1].item() > 4.0 + 1.0  # it has gone to its left


def test_a_slow_vehicle_turns_no_more_than_the_span() -> None:
    assert curvature_span(torch.tensor([0.0, 2.0, 10.0])).tolist() == pytest.approx([0.1, 0.1, 0.03])


def test_the_others_keep_their_plans() -> None:
    scene = batch([8.0, 10.0, 9.0])
    plan = natural(scene, 0.5)
    made = one(scene, plan, (-1.0, -1.0))
    assert torch.equal(made.xy[0, [0, 2]], plan.xy[0, [0, 2]])
    assert not torch.equal(made.xy[0, 1], plan.xy[0, 1])
    assert torch.equal(plan.accel, natural(scene, 0.5).accel), "the natural plan must not be written over"


@given(
    speed=st.floats(0.0, 30.0),
    accel=st.floats(-8.0, 4.0),
    lateral=st.floats(-6.0, 6.0),
    push=st.floats(-3.0, 3.0),
    turn=st.floats(-3.0, 3.0),
)
def test_actions_stay_within_the_limits(
    speed: float, accel: float, lateral: float, push: float, turn: float
) -> None:
    scene = batch([5.0, speed])
    curvature = float(np.clip(lateral / max(speed, 0.1) ** 2, -0.2, 0.2))
    made = one(scene, natural(scene, accel, curvature), (push, turn))
    before = torch.cat((torch.tensor([speed]), made.speed[0, 1, :-1]))
    assert made.accel[0, 1].max() <= OPTIONS.accel_mps2
    assert made.accel[0, 1].min() >= -OPTIONS.brake_mps2
    geometric = math.tan(OPTIONS.steer_rad) / (0.6 * 4.5)
    bound = torch.minimum(torch.tensor(geometric), OPTIONS.lateral_mps2 / before.clamp(min=0.1) ** 2)
    assert (made.curvature[0, 1].abs() <= bound * (1.0 + 1e-5)).all()
    assert (made.speed >= 0.0).all()
    assert abs(made.accel[0, 1, 0].item() - np.clip(accel, -8.0, 4.0)) <= 4.0 + 1e-5
