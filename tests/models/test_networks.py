"""What must hold for every network: order of agents, padding and the world's frame change nothing."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import cast

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from advdiff_sumo.data.window_files import WindowFile
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.collate import collate
from advdiff_sumo.models.context import past_features
from advdiff_sumo.models.decoder import Forced, Rollout
from advdiff_sumo.models.denoiser import Denoiser
from advdiff_sumo.models.geometry import into_frame, rotate, wrap_angle
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.reward import RewardModel
from advdiff_sumo.models.traffic import TrafficModel

Stir = Callable[[nn.Module], nn.Module]
TARGET = torch.tensor([3, 1])


@dataclass(frozen=True)
class Nets:
    traffic: TrafficModel
    denoiser: Denoiser
    reward: RewardModel


@pytest.fixture(scope="module")
def nets(options: ModelOptions, lively: Stir) -> Nets:
    torch.manual_seed(0)
    traffic, denoiser, reward = TrafficModel(options), Denoiser(options, (1, 8)), RewardModel(options)
    return Nets(
        cast(TrafficModel, lively(traffic)),
        cast(Denoiser, lively(denoiser)),
        cast(RewardModel, lively(reward)),
    )


def latents(batch: SceneBatch, options: ModelOptions) -> Tensor:
    """Return (B, 5, Z) numbers of the agents, whatever the padding."""
    made = torch.randn(batch.scenes, 5, options.latent, generator=torch.Generator().manual_seed(1))
    return nn.functional.pad(made, (0, 0, 0, batch.agents - 5))


@torch.no_grad()
def everything(nets: Nets, batch: SceneBatch, z: Tensor, target: Tensor = TARGET) -> dict[str, Tensor]:
    """Return the answer of each network (B, A, …), Q as (B,), rollouts in own frames."""
    context = nets.traffic.encoder(batch)
    q = nets.traffic.posterior(batch, context.h)
    rollout = nets.traffic.decoder(z, context.h, batch)
    return {
        "h": context.h,
        "prior": torch.cat((context.prior.mean, context.prior.logvar), dim=-1),
        "posterior": torch.cat((q.mean, q.logvar), dim=-1),
        "noise": nets.denoiser(z[:, :, None], torch.tensor([5, 90]), context),
        "rollout": own_frame(rollout, batch),
        "Q": nets.reward(context.h, context.prior.mean, z, batch, target),
    }


def own_frame(rollout: Rollout, batch: SceneBatch) -> Tensor:
    """Return (B, A, T, 6): x, y, turn, speed, acceleration, curvature as each agent sees them."""
    now = batch.pose[:, :, None]
    xy = into_frame(rollout.xy, now[..., :2], now[..., 2].expand(rollout.yaw.shape))
    turn = wrap_angle(rollout.yaw - now[..., 2])
    columns = (turn, rollout.speed, rollout.accel, rollout.curvature)
    return torch.cat((xy, torch.stack(columns, dim=-1)), dim=-1)


def differing(
    made: dict[str, Tensor], wanted: dict[str, Tensor], present: Tensor, atol: float
) -> dict[str, float]:
    """Return by how much those of *made* differ that are not *wanted* up to *atol*, absolute and relative."""
    out: dict[str, float] = {}
    for name, value in wanted.items():
        got = made[name] if name == "Q" else made[name][:, : present.shape[1]]
        kept = slice(None) if name == "Q" else present
        assert got[kept].shape == value[kept].shape
        if not torch.allclose(got[kept], value[kept], atol=atol, rtol=atol):
            out[name] = float((got[kept] - value[kept]).abs().max())
    return out


def test_agents_in_another_order_get_the_same(
    nets: Nets,
    batch: SceneBatch,
    options: ModelOptions,
    permuted: Callable[[SceneBatch, Tensor], SceneBatch],
) -> None:
    order = torch.tensor([3, 0, 4, 1, 2])
    z = latents(batch, options)
    wanted = everything(nets, batch, z)
    moved = permuted(batch, order)
    target = torch.argsort(order)[TARGET]
    made = everything(nets, moved, z[:, order], target)
    reordered = {name: value if name == "Q" else value[:, order] for name, value in wanted.items()}
    assert not differing(made, reordered, moved.present, 1e-5)


def test_padding_changes_nothing(
    nets: Nets, batch: SceneBatch, options: ModelOptions, padded: Callable[[SceneBatch], SceneBatch]
) -> None:
    wanted = everything(nets, batch, latents(batch, options))
    wider = padded(batch)
    made = everything(nets, wider, latents(wider, options))
    assert not differing(made, wanted, batch.present, 1e-5)


def test_a_scene_alone_gets_the_same_as_in_a_batch(
    nets: Nets, windows: Callable[..., WindowFile], batch: SceneBatch, options: ModelOptions
) -> None:
    """The smaller scene is padded in the batch, and its own three agents are all it has alone."""
    alone = collate(windows(), np.array([1, 1]))
    assert alone.agents == 3
    z = latents(batch, options)
    wanted = everything(nets, batch.rows(torch.tensor([1, 1])), z[[1, 1]], TARGET[[1, 1]])
    made = everything(nets, alone, z[[1, 1], :3], TARGET[[1, 1]])
    for name, value in wanted.items():
        kept = value if name == "Q" else value[:, :3]
        torch.testing.assert_close(made[name], kept, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(("turn", "shift"), [(0.7, (0.0, 0.0)), (0.0, (30.0, -50.0)), (2.9, (-40.0, 25.0))])
def test_the_world_turned_and_shifted_gives_the_same_plan(
    nets: Nets,
    windows: Callable[..., WindowFile],
    batch: SceneBatch,
    options: ModelOptions,
    turn: float,
    shift: tuple[float, float],
) -> None:
    z = latents(batch, options)
    moved = collate(windows(turn=turn, shift=shift), np.arange(2))
    assert not torch.allclose(moved.pose[..., 2], batch.pose[..., 2]) or turn == 0.0
    assert not differing(everything(nets, moved, z), everything(nets, batch, z), batch.present, 2e-4)


def test_the_scene_origin_does_not_matter(nets: Nets, batch: SceneBatch, options: ModelOptions) -> None:
    """As after steps at run time, when the first agent has left the origin."""
    shift = torch.tensor([40.0, -30.0, 2.0 * math.pi, 0.0])
    far = replace(batch, past=batch.past + shift, future=batch.future + shift)
    z = latents(batch, options)
    assert not differing(everything(nets, far, z), everything(nets, batch, z), batch.present, 2e-4)


def test_agents_notice_each_other_within_a_scene_alone(
    nets: Nets, batch: SceneBatch, options: ModelOptions
) -> None:
    z = latents(batch, options)
    wanted = everything(nets, batch, z)
    pushed = batch.past.clone()
    pushed[0, 1, :, :2] += 3.0
    made = everything(nets, replace(batch, past=pushed), z)
    for name in ("h", "prior", "posterior", "rollout", "Q"):
        change = (made[name] - wanted[name]).abs()
        assert float(change[0].max()) > 1e-4, name
        assert float(change[1].max()) == 0.0, name
        if name != "Q":
            assert float(change[0, 0].max()) > 1e-5, name  # agent 0 saw agent 1 move


def test_the_map_and_its_signals_are_read(nets: Nets, batch: SceneBatch) -> None:
    wanted = nets.traffic.encoder(batch).h
    without = nets.traffic.encoder(replace(batch, map_valid=torch.zeros_like(batch.map_valid))).h
    lit = batch.map_features.clone()
    lit[..., 10:] = torch.tensor([1.0, 0.0, 0.0])
    red = nets.traffic.encoder(replace(batch, map_features=lit)).h
    for other in (without, red):
        assert bool(torch.isfinite(other).all())
        assert bool(((other - wanted).abs().amax(-1) > 1e-4)[batch.present].all())


def test_unknown_instants_are_not_read(nets: Nets, batch: SceneBatch) -> None:
    """Rubbish where the masks are False changes no answer: nobody looks behind them."""
    rubbish = {
        "past": torch.where(batch.past_valid[..., None], batch.past, 7.0),
        "future": torch.where(batch.future_valid[..., None], batch.future, -9.0),
    }
    other = replace(batch, **rubbish)
    context, changed = nets.traffic.encoder(batch), nets.traffic.encoder(other)
    torch.testing.assert_close(changed.h, context.h)
    wanted, made = nets.traffic.posterior(batch, context.h), nets.traffic.posterior(other, context.h)
    torch.testing.assert_close(made.mean[batch.present], wanted.mean[batch.present])


def test_the_encoder_does_not_read_the_future(nets: Nets, batch: SceneBatch) -> None:
    other = replace(batch, future=batch.future + 3.0, future_valid=~batch.future_valid)
    torch.testing.assert_close(nets.traffic.encoder(other).h, nets.traffic.encoder(batch).h)


def test_the_networks_do_not_read_who_is_parked(nets: Nets, batch: SceneBatch, options: ModelOptions) -> None:
    z = latents(batch, options)
    other = everything(nets, replace(batch, parked=~batch.parked), z)
    assert not differing(other, everything(nets, batch, z), batch.present, 0.0)


def test_past_features_by_hand(windows: Callable[..., WindowFile]) -> None:
    """Two instants of a 4 × 2 m truck that drove 5 m north at 10 m/s."""
    batch = collate(windows(), np.array([1])).rows(slice(0, 1))
    past, valid = torch.zeros(1, 3, 5, 4), torch.zeros(1, 3, 5, dtype=torch.bool)
    past[0, 0, 3], past[0, 0, 4] = (
        torch.tensor([2.0, -4.0, math.pi / 2, 10.0]),
        torch.tensor([2.0, 1.0, math.pi / 2, 10.0]),
    )
    valid[0, 0, 3:] = True
    size = torch.tensor([4.0, 2.0]).expand(1, 3, 2)
    seen = past_features(
        replace(batch, past=past, past_valid=valid, size=size, classes=torch.ones(1, 3, dtype=torch.long))
    )[0, 0]
    state = [-0.5, 0.0, 1.0, 0.0, 1.0, 1.0]
    wanted = [0.0] * 18 + state + [0.0, *state[1:]] + [0.8, 0.4] + [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]
    torch.testing.assert_close(seen, torch.tensor(wanted), atol=1e-6, rtol=0.0)


def edge_cases(batch: SceneBatch) -> dict[str, SceneBatch]:
    zero = {f.name: torch.zeros_like(getattr(batch, f.name)) for f in fields(batch)}
    still = batch.past.clone()
    still[..., 3] = 0.0
    nobody = torch.zeros_like(batch.present)
    alone = nobody.clone()
    alone[:, 0] = True
    return {
        "all in one place": replace(batch, past=zero["past"], future=zero["future"]),
        "standing": replace(batch, past=still),
        "no neighbours": replace(batch, present=alone, moved=alone),
        "nobody": replace(batch, present=nobody, moved=nobody),
        "no map": replace(batch, map_valid=zero["map_valid"], map_xy=zero["map_xy"]),
        "only now": replace(batch, past_valid=torch.arange(5).expand(batch.past_valid.shape) == 4),
        "no future": replace(batch, future=zero["future"], future_valid=zero["future_valid"]),
    }


@pytest.mark.parametrize(
    "case",
    ["all in one place", "standing", "no neighbours", "nobody", "no map", "only now", "no future"],
)
def test_gradients_are_numbers_at_the_edges(
    nets: Nets, batch: SceneBatch, options: ModelOptions, case: str
) -> None:
    scene = edge_cases(batch)[case]
    z = latents(scene, options).requires_grad_()
    context = nets.traffic.encoder(scene)
    posterior = nets.traffic.posterior(scene, context.h)
    rollout = nets.traffic.decoder(z, context.h, scene)
    value = nets.reward(context.h, context.prior.mean, z, scene, torch.zeros(2, dtype=torch.long))
    kl = posterior.kl(context.prior).sum()
    total = rollout.states().square().mean() + value.sum() + kl
    weights = [*nets.traffic.parameters(), *nets.reward.parameters()]
    grads = torch.autograd.grad(total, [z, *weights])
    assert bool(torch.isfinite(total))
    assert all(bool(torch.isfinite(g).all()) for g in grads)


def test_a_rollout_with_its_trace_is_the_one_without(nets: Nets, batch: SceneBatch) -> None:
    decoder, context = nets.traffic.decoder, nets.traffic.encoder(batch)
    z = context.prior.mean
    traced, trace = decoder.roll(z, context.h, decoder.surroundings(batch), 5)
    assert torch.equal(traced.states(), decoder(z, context.h, batch, 5).states())
    assert torch.equal(trace.motion[1:], traced.states().movedim(2, 0)[:-1])


def test_decoder_is_the_bicycle_within_its_limits(
    nets: Nets, batch: SceneBatch, options: ModelOptions
) -> None:
    """Each step of a rollout is an arc of the stated controls, and these are within the limits."""
    z = 5.0 * latents(batch, options)
    with torch.no_grad():
        rollout = nets.traffic.decoder(z, nets.traffic.encoder(batch).h, batch)
    speed = torch.cat((batch.pose[..., None, 3], rollout.speed[..., :-1]), dim=-1)
    assert rollout.accel.abs().max() > 0.5
    assert bool((rollout.accel <= options.accel_mps2).all())
    assert bool((rollout.accel >= -options.brake_mps2).all())
    assert float((rollout.curvature.abs() * speed**2).max()) <= options.lateral_mps2 + 1e-4
    torch.testing.assert_close(rollout.speed, (speed + 0.5 * rollout.accel).clamp(min=0.0))
    yaw = torch.cat((batch.pose[..., None, 2], rollout.yaw[..., :-1]), dim=-1)
    turned = rollout.yaw - yaw
    driven = torch.where(rollout.speed > 0.0, 0.5 * (speed + rollout.speed) * 0.5, 0.0)
    going = driven > 0.0
    torch.testing.assert_close(turned[going], (rollout.curvature * driven)[going], atol=1e-5, rtol=1e-4)


def test_walkers_keep_their_velocity(nets: Nets, batch: SceneBatch, options: ModelOptions) -> None:
    with torch.no_grad():
        rollout = nets.traffic.decoder(latents(batch, options), nets.traffic.encoder(batch).h, batch)
    x, y, yaw, speed = batch.pose[0, 2]
    ahead = rotate(torch.stack((0.5 * speed * torch.arange(1, 13), torch.zeros(12)), dim=-1), yaw.expand(12))
    torch.testing.assert_close(rollout.xy[0, 2], torch.stack((x, y)) + ahead, atol=1e-4, rtol=1e-5)
    assert not bool(rollout.accel[0, 2].any())


def test_forced_agents_go_where_they_are_told_and_others_react(
    nets: Nets, batch: SceneBatch, options: ModelOptions
) -> None:
    z = latents(batch, options)
    mask = torch.zeros(2, 5, 12, dtype=torch.bool)
    mask[0, 0, :8] = True
    states = torch.zeros(2, 5, 12, 4)
    states[0, 0] = torch.tensor([1.0, 2.0, 0.3, 4.0])
    with torch.no_grad():
        h = nets.traffic.encoder(batch).h
        free, forced = (nets.traffic.decoder(z, h, batch, forced=f) for f in (None, Forced(states, mask)))
    torch.testing.assert_close(forced.states()[0, 0, :8], states[0, 0, :8])
    assert float((forced.xy[0, 0, 8] - states[0, 0, 7, :2]).norm()) < 4.0  # goes on from there
    assert float((forced.xy[0, 1] - free.xy[0, 1]).abs().max()) > 1e-4
    torch.testing.assert_close(forced.xy[1], free.xy[1])


def test_fewer_steps_are_the_beginning_of_more(nets: Nets, batch: SceneBatch, options: ModelOptions) -> None:
    z = latents(batch, options)
    with torch.no_grad():
        h = nets.traffic.encoder(batch).h
        short, long = (nets.traffic.decoder(z, h, batch, steps=n) for n in (3, 12))
    torch.testing.assert_close(short.states(), long.states()[:, :, :3])


def test_every_weight_learns(nets: Nets, batch: SceneBatch, options: ModelOptions) -> None:
    context = nets.traffic.encoder(batch)
    posterior = nets.traffic.posterior(batch, context.h)
    z = posterior.sample(torch.Generator().manual_seed(0))
    rollout = nets.traffic.decoder(z, context.h, batch)
    value = nets.reward(context.h, z, z, batch, TARGET)
    total = rollout.states().square().mean() + posterior.kl(context.prior).mean() + value.sum()
    for net in (nets.traffic, nets.reward):
        grads = torch.autograd.grad(total, list(net.parameters()), retain_graph=True)
        silent = [n for (n, _), g in zip(net.named_parameters(), grads, strict=True) if not g.any()]
        assert silent == []
