"""Gradients written by hand, against autograd and against differences, in double precision."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
import torch
from torch import Tensor

from advdiff_sumo.diffusion.compiled.vehicle_kernel import DONE, cars_of, drive, drive_back, limits_of
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.fast_reward import FastReward, RewardWeights
from advdiff_sumo.models import tensor_bicycle
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.model_options import MODEL_STEP_S
from tests.diffusion.test_fast import SMALL, bundle, scene

PARTS = ("xy", "yaw", "speed", "accel", "curvature")


def double(batch: SceneBatch) -> SceneBatch:
    parts = {f.name: getattr(batch, f.name) for f in fields(batch)}
    return SceneBatch(**{n: v.double() if v.is_floating_point() else v for n, v in parts.items()})


@pytest.fixture(scope="module")
def made() -> Bundle:
    networks = bundle()
    for module in networks.modules().values():
        module.double()
    return networks


def two_scenes(networks: Bundle) -> tuple[SceneBatch, Context]:
    """Return two scenes of eight, with somebody absent, on foot, and standing."""
    batch = double(scene(scenes=2, agents=8))
    batch.present[1, 6:] = False
    batch.moved[1, 6:] = False
    batch.moved[0, 5] = False
    batch.past[0, 2, :, 3] = 0.05
    return batch, networks.traffic.encoder(batch)


def weighed(rollout: Rollout) -> Tensor:
    """Return a sum in which every number of a roll-out counts differently."""
    generator = torch.Generator().manual_seed(5)
    total = torch.zeros((), dtype=torch.float64)
    for name in PARTS:
        part = getattr(rollout, name)
        total = total + (part * torch.randn(part.shape, generator=generator, dtype=part.dtype)).sum()
    return total


@pytest.mark.parametrize("rows", [[5, 2], [2], [1, 3, 7]])
def test_some_rows_against_autograd(made: Bundle, rows: list[int]) -> None:
    batch, context = two_scenes(made)
    picked, z = torch.tensor(rows), context.prior.mean
    results = []
    for compiled in (True, False):
        fast = FastDecoder(made.traffic.decoder, compiled)
        whole, trace = fast.whole(z, context.h, batch, 6)
        free = (z[:, picked] + 0.3).requires_grad_()
        some = fast.some(free, context.h, batch, picked, 6, trace)
        (gradient,) = torch.autograd.grad(weighed(some), free)
        there = batch.present
        results.append((*(getattr(whole, n)[there] for n in PARTS), trace.motion, trace.senders, gradient))
        assert gradient.abs().max() > 1e-3
    for array, tensor in zip(*results, strict=True):
        if array.dim() == 5:  # what absent agents say is heard by nobody
            array, tensor = (x[..., :6, :] for x in (array, tensor))
        if array.shape[-1] == 4:
            array, tensor = (x[..., :6, :] for x in (array, tensor))
        torch.testing.assert_close(array, tensor, atol=1e-9, rtol=1e-7)


def test_some_rows_against_differences(made: Bundle) -> None:
    batch, context = two_scenes(made)
    picked = torch.tensor([4, 1])
    fast = FastDecoder(made.traffic.decoder)
    _, trace = fast.whole(context.prior.mean, context.h, batch, 4)

    def value(z: Tensor) -> Tensor:
        return weighed(fast.some(z, context.h, batch, picked, 4, trace))

    free = context.prior.mean[:, picked].clone().requires_grad_()
    assert torch.autograd.gradcheck(value, (free,), fast_mode=True, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("speed", [0.0, 0.4, 9.0, 30.0])
def test_one_step_against_the_bicycle_on_tensors(speed: float) -> None:
    """Standing, about to stop within the step, in town, and where grip bounds the curvature."""
    rng = np.random.default_rng(3)
    pose = rng.normal(size=(6, 4))
    pose[:, 3] = speed
    length, moved = np.full(6, 4.6), np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    raw = rng.normal(size=(6, 2)) * (3.0, 1.0)
    raw[0, 0] = -9.0
    cars, limits = cars_of(pose, length, moved, SMALL), limits_of(SMALL, pose)
    motion, done = pose.copy(), np.empty((6, DONE))
    for row in range(6):
        drive(cars[row], limits, raw[row], motion[row], done[row])
    leaves = [torch.tensor(x, requires_grad=True) for x in (pose[:, :2], pose[:, 2], pose[:, 3], raw)]
    xy, yaw, v, controls = leaves
    accel, curvature = tensor_bicycle.controls(controls, v, torch.tensor(length), SMALL)
    accel, curvature = accel * torch.tensor(moved), curvature * torch.tensor(moved)
    to, turned, fast = tensor_bicycle.step(xy, yaw, v, accel, curvature, MODEL_STEP_S)
    mine = (*motion.T, done[:, 4], done[:, 5])
    theirs = (to[:, 0], to[:, 1], turned, fast, accel, curvature)
    for a, b in zip(mine, theirs, strict=True):
        np.testing.assert_allclose(a, b.detach(), atol=1e-12)
    weights = rng.normal(size=(6, 6))
    total = sum((torch.tensor(w) * part).sum() for w, part in zip(weights, theirs, strict=True))
    assert isinstance(total, Tensor)
    wanted = torch.autograd.grad(total, leaves)
    before, by_raw = np.ascontiguousarray(weights[:4].T), np.empty((6, 2))
    controls_by = np.ascontiguousarray(weights[4:].T)
    for row in range(6):
        drive_back(cars[row], limits, done[row], before[row], controls_by[row], by_raw[row])
    for a, b in zip((*before.T[:3], by_raw), (*wanted[0].T, *wanted[1::2]), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-7, rtol=1e-6)
    if speed > 0.1:  # at a standstill the way has a corner
        np.testing.assert_allclose(before[:, 3], wanted[2], atol=1e-7, rtol=1e-6)


@pytest.mark.parametrize("compiled", [True, False])
def test_q_and_its_gradient(made: Bundle, compiled: bool) -> None:
    batch, context = two_scenes(made)
    target = torch.tensor([0, 3])
    state = made.reward.prepare(context.h, context.prior.mean, batch, target)
    fast = FastReward(RewardWeights(made.reward, compiled), state)
    mu = torch.randn(2, 8, SMALL.latent, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    weight = torch.tensor([1.0, -2.0], dtype=torch.float64)
    gradients = []
    for value_of in (fast, lambda x: made.reward.value_of(state, x)):
        free = mu.clone().requires_grad_()
        value = value_of(free)
        (gradient,) = torch.autograd.grad((value * weight).sum(), free)
        gradients.append((value.detach(), gradient))
    for mine, theirs in zip(*gradients, strict=True):
        torch.testing.assert_close(mine, theirs, atol=1e-12, rtol=1e-9)
    assert gradients[0][1][0].abs().sum(-1).gt(0.0).tolist() == [False] + [True] * 7
    assert torch.autograd.gradcheck(fast, (mu.clone().requires_grad_(),), fast_mode=True)
