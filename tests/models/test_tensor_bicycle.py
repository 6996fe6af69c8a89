"""The bicycle model on tensors: the one of core, with gradients, and limits that no action breaks."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from advdiff_sumo.core import bicycle as core
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.tensor_bicycle import controls, step

OPTIONS = ModelOptions()
RAW = st.floats(-1e6, 1e6)
SPEED, LENGTH = st.floats(0.0, 60.0), st.floats(0.3, 20.0)


def double(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64).squeeze()


def drive(
    yaw: float, speed: float, accel: float | Tensor, bend: float, dt_s: float, xy: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """Return one step in double precision, from the origin unless *xy* is given."""
    start = double(0.0, 0.0) if xy is None else xy
    push = accel if isinstance(accel, Tensor) else double(accel)
    return step(start, double(yaw), double(speed), push, double(bend), dt_s)


@settings(max_examples=60, deadline=None)
@given(SPEED, st.floats(-9.0, 4.0), st.floats(-0.3, 0.3), st.floats(-3.0, 3.0), st.floats(0.05, 3.0))
def test_agrees_with_core(speed: float, accel: float, bend: float, yaw: float, dt: float) -> None:
    if -1e-6 < accel < 0.0:  # the two put the same floor under a division at 1e-6 and 1e-9
        accel = 0.0
    xy = np.array((3.0, -2.0))
    wanted = core.step(xy, np.asarray(yaw), np.asarray(speed), np.asarray(accel), np.asarray(bend), dt)
    made = drive(yaw, speed, accel, bend, dt, torch.from_numpy(xy))
    np.testing.assert_allclose(made[0].numpy(), wanted[0], atol=1e-9)
    assert math.remainder(float(made[1]) - float(wanted[1]), math.tau) == pytest.approx(0.0, abs=1e-9)
    assert float(made[2]) == pytest.approx(float(wanted[2]), abs=1e-9)


def test_a_quarter_of_a_circle_by_hand() -> None:
    """Radius 20 m at 5 m/s for 2 π s."""
    xy, yaw, speed = drive(0.0, 5.0, 0.0, 0.05, 2.0 * math.pi)
    torch.testing.assert_close(xy, torch.tensor([20.0, 20.0], dtype=torch.float64))
    assert float(yaw) == pytest.approx(math.pi / 2)
    assert float(speed) == 5.0


def test_stops_and_stays() -> None:
    """From 2 m/s at −8 m/s²: 0.25 m, then standing; no reversing."""
    xy, _, speed = drive(0.0, 2.0, -8.0, 0.0, 0.5)
    torch.testing.assert_close(xy, torch.tensor([0.25, 0.0], dtype=torch.float64))
    assert float(speed) == 0.0
    again = drive(0.0, 0.0, -8.0, 0.2, 0.5, xy)
    torch.testing.assert_close(again[0], xy)
    assert float(again[2]) == 0.0


@settings(max_examples=60, deadline=None)
@given(RAW, RAW, SPEED, LENGTH)
def test_no_action_breaks_a_limit(push: float, turn: float, speed: float, length: float) -> None:
    raw = torch.tensor([push, turn], dtype=torch.float64)
    made = controls(raw, double(speed), double(length), OPTIONS)
    accel, bend = float(made[0]), float(made[1])
    assert -OPTIONS.brake_mps2 <= accel <= OPTIONS.accel_mps2
    steer = math.atan(abs(bend) * core.WHEELBASE_PER_LENGTH * max(length, 0.5))
    assert steer <= OPTIONS.steer_rad + 1e-9
    assert abs(bend) * speed**2 <= OPTIONS.lateral_mps2 + 1e-9
    clipped = core.clip_controls(
        np.asarray(speed),
        np.asarray(accel),
        np.asarray(bend),
        np.asarray(max(length, 0.5)),
        core.Limits(brake_mps2=OPTIONS.brake_mps2),
    )
    assert float(clipped[0]) == pytest.approx(accel if speed < 60.0 else min(accel, 0.0))
    assert float(clipped[1]) == pytest.approx(bend)


def test_controls_by_hand() -> None:
    """A 5 m car: wheelbase 3 m; at 2 m/s steering bounds the curvature, at 20 m/s the grip, 6 / 400."""
    raw = torch.tensor([[4.0, 1.0], [-8.0, -1.0], [0.0, 0.0]], dtype=torch.float64)
    speed, length = torch.tensor([2.0, 20.0, 7.0]).double(), torch.full((3,), 5.0, dtype=torch.float64)
    accel, bend = controls(raw, speed, length, OPTIONS)
    t = math.tanh(1.0)
    torch.testing.assert_close(accel, torch.tensor([4.0 * t, -8.0 * t, 0.0], dtype=torch.float64))
    wanted = [math.tan(0.6) / 3.0 * t, -6.0 / 400.0 * t, 0.0]
    torch.testing.assert_close(bend, torch.tensor(wanted, dtype=torch.float64))


def leaf(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64, requires_grad=True)


def test_gradients_of_a_step_against_differences() -> None:
    """Driving, braking, stopping within the step, bending either way."""
    xy = torch.zeros(4, 2, dtype=torch.float64, requires_grad=True)
    inputs = xy, leaf(0.3, -2.0, 1.0, 3.0), leaf(8.0, 5.0, 1.5, 0.4), leaf(1.0, -3.0, -6.0, 0.5)
    assert torch.autograd.gradcheck(
        lambda p, a, v, u, c: step(p, a, v, u, c, 0.5),
        (*inputs, leaf(0.1, -0.05, 0.2, 0.02)),
        eps=1e-6,
        atol=1e-6,
    )


def test_gradients_of_controls_against_differences() -> None:
    raw = torch.tensor([[1.0, 0.3], [-2.0, -1.5], [0.5, 0.0]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda r, v: controls(r, v, torch.full((3,), 4.5, dtype=torch.float64), OPTIONS),
        (raw, leaf(3.0, 15.0, 0.5)),
        atol=1e-6,
    )


@pytest.mark.parametrize("speed", [0.0, 1e-6, 3.0])
@pytest.mark.parametrize("accel", [0.0, -8.0, 4.0, -1e-12])
@pytest.mark.parametrize("bend", [0.0, 1e-12, 0.2])
def test_gradients_are_numbers_at_rest_and_straight_on(speed: float, accel: float, bend: float) -> None:
    xy = torch.zeros(2, requires_grad=True)
    inputs = [torch.tensor(v, requires_grad=True) for v in (0.0, speed, accel, bend)]
    made = step(xy, inputs[0], inputs[1], inputs[2], inputs[3], 0.5)
    grads = torch.autograd.grad(made[0].sum() + made[1] + made[2], (xy, *inputs))
    assert all(bool(torch.isfinite(g).all()) for g in grads)


def test_a_standing_vehicle_feels_that_it_could_move_off() -> None:
    """From rest, the place grows by ½ dt² and the speed by dt for each m/s² more."""
    accel = torch.tensor(0.5, dtype=torch.float64, requires_grad=True)
    xy, _, speed = drive(0.0, 0.0, accel, 0.0, 0.5)
    assert float(torch.autograd.grad(xy[0], accel, retain_graph=True)[0]) == pytest.approx(0.125)
    assert float(torch.autograd.grad(speed, accel)[0]) == pytest.approx(0.5)
