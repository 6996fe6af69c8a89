"""What is diffused: scaling there and back, latents, and trajectories that come out as they went in."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.codec import LatentCodec, TrajectoryCodec
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.geometry import wrap_angle
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.traffic import TrafficModel

Driving = Callable[..., SceneBatch]


@pytest.fixture(scope="module")
def model(options: ModelOptions, lively: Callable[[nn.Module], nn.Module]) -> TrafficModel:
    torch.manual_seed(0)
    made = TrafficModel(options)
    lively(made)
    return made


@pytest.fixture
def context(model: TrafficModel, batch: SceneBatch) -> Context:
    with torch.no_grad():
        made: Context = model.encoder(batch)
    return made


def measured(codec: LatentCodec | TrajectoryCodec) -> Tensor:
    """Give *codec* statistics of made-up data (M, C, L), which is returned."""
    generator = torch.Generator().manual_seed(0)
    raw = 5.0 + 3.0 * torch.randn(500, *codec.shape, generator=generator)
    raw[:, 0, 0] = 2.0  # a number that never varies
    codec.measure(raw)
    return raw


@pytest.mark.parametrize("name", ["latent", "trajectory"])
def test_scale_and_back(name: str, options: ModelOptions, model: TrafficModel) -> None:
    codec = LatentCodec(options, model) if name == "latent" else TrajectoryCodec()
    assert codec.shape == ((1, options.latent) if name == "latent" else (3, 12))
    torch.testing.assert_close(codec.scale(torch.full(codec.shape, 4.0)), torch.full(codec.shape, 4.0))
    raw = measured(codec)
    scaled = codec.scale(raw)
    assert float(scaled.mean(0).abs().max()) < 1e-4
    deviation = scaled.std(0).flatten()
    torch.testing.assert_close(deviation[1:], torch.ones(deviation.numel() - 1), atol=1e-4, rtol=0.0)
    assert not bool(scaled[:, 0, 0].any())  # no division by zero
    torch.testing.assert_close(codec.unscale(scaled), raw, atol=1e-5, rtol=1e-5)


def test_the_codec_owns_its_statistics_alone(options: ModelOptions, model: TrafficModel) -> None:
    codec = LatentCodec(options, model)
    assert sorted(codec.state_dict()) == ["mean", "std"]
    assert list(codec.parameters()) == []


@torch.no_grad()
def test_latents_are_draws_of_the_posterior_and_decode_as_they_are(
    options: ModelOptions, model: TrafficModel, batch: SceneBatch, context: Context
) -> None:
    codec = LatentCodec(options, model)
    measured(codec)
    raw = codec.raw(batch, context, torch.Generator().manual_seed(3))
    posterior = model.posterior(batch, context.h)
    z = posterior.sample(torch.Generator().manual_seed(3))
    assert raw.shape == (2, 5, 1, options.latent)
    torch.testing.assert_close(raw[:, :, 0], z)
    made, wanted = codec.decode(codec.scale(raw), context, batch), model.decoder(z, context.h, batch)
    torch.testing.assert_close(made.states(), wanted.states(), atol=1e-3, rtol=1e-4)


def test_a_trajectory_comes_back(options: ModelOptions, batch: SceneBatch, context: Context) -> None:
    codec = TrajectoryCodec()
    measured(codec)
    raw = codec.raw(batch, context, None)
    assert raw.shape == (2, 5, 3, 12)
    made = codec.decode(codec.scale(raw), context, batch)
    known = batch.future_valid
    torch.testing.assert_close(made.xy[known], batch.future[..., :2][known], atol=1e-3, rtol=1e-4)
    off = wrap_angle(made.yaw - batch.future[..., 2])[known]
    assert float(off.abs().max()) < 1e-4


def test_a_trajectory_by_hand(options: ModelOptions, driving: Driving, context: Context) -> None:
    """A car at (3, 1) looks north at 4 m/s and goes on at 6: 3 m further each time, from 3 m ahead."""
    scene = driving([(3.0, 1.0, math.pi / 2, 4.0)])
    future = torch.zeros_like(scene.future)
    future[0, 0, :, 0] = 3.0
    future[0, 0, :, 1] = 1.0 + 3.0 * torch.arange(1, 13)
    future[0, 0, :, 2], future[0, 0, :, 3] = math.pi / 2, 6.0
    scene = replace(scene, future=future, future_valid=torch.ones_like(scene.future_valid))
    codec = TrajectoryCodec().double()
    raw = codec.raw(scene, context, None)
    wanted = torch.stack((3.0 * torch.arange(1, 13), torch.zeros(12), torch.zeros(12))).double()
    torch.testing.assert_close(raw[0, 0], wanted)
    made = codec.decode(raw, context, scene)
    torch.testing.assert_close(made.states(), future)
    assert float(made.accel[0, 0, 0]) == pytest.approx(4.0)  # (6 − 4) / 0.5
    assert float(made.accel[0, 0, 1:].abs().max()) < 1e-9
    assert not bool(made.curvature.any())


def test_unknown_instants_keep_the_last_known_velocity(
    options: ModelOptions, driving: Driving, context: Context
) -> None:
    """Known at 1 s alone: before it the velocity now, 2 m/s east, after it 4 m/s north."""
    scene = driving([(0.0, 0.0, 0.0, 2.0)])
    scene.future[0, 0, 1] = torch.tensor([5.0, 1.0, math.pi / 2, 4.0], dtype=torch.float64)
    scene.future_valid[0, 0, 1] = True
    raw = TrajectoryCodec().double().raw(scene, context, None)[0, 0].T
    wanted = [(1.0, 0.0, 0.0), *((5.0, 1.0 + 2.0 * k, math.pi / 2) for k in range(11))]
    torch.testing.assert_close(raw, torch.tensor(wanted, dtype=torch.float64))


def test_a_full_turn_keeps_its_curvature(options: ModelOptions, driving: Driving, context: Context) -> None:
    """A roundabout of 10 m radius, 330° in 6 s: the heading passes π, the curvature stays near 0.1."""
    turn = math.radians(330.0) / 12 * torch.arange(1, 13, dtype=torch.float64)
    scene = driving([(0.0, 0.0, 0.0, 4.8)])
    scene.future[0, 0] = torch.stack(
        (10.0 * torch.sin(turn), 10.0 - 10.0 * torch.cos(turn), wrap_angle(turn), torch.full((12,), 4.8)), -1
    )
    scene = replace(scene, future_valid=torch.ones_like(scene.future_valid))
    codec = TrajectoryCodec().double()
    made = codec.decode(codec.raw(scene, context, None), context, scene)
    torch.testing.assert_close(made.curvature, torch.full_like(made.curvature, 0.1), atol=0.002, rtol=0.0)


def test_gradients_of_a_standing_trajectory_are_numbers(
    options: ModelOptions, driving: Driving, context: Context
) -> None:
    scene = driving([(0.0, 0.0, 0.3, 0.0), (0.0, 0.0, 0.3, 0.0)])
    codec = TrajectoryCodec().double()
    x = torch.zeros(1, 2, 3, 12, dtype=torch.float64, requires_grad=True)
    made = codec.decode(x, context, scene)
    total = made.states().sum() + made.accel.sum() + made.curvature.sum()
    (grad,) = torch.autograd.grad(total, x)
    assert bool(torch.isfinite(grad).all())
