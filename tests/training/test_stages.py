"""What the stages minimise: hand-worked terms, and that they learn four windows by heart."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import pytest
import torch

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle, BundleOptions, new_bundle
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.gaussian import Gaussian
from advdiff_sumo.training.cvae import TrafficStage, elbo, encode, kl_share, modelled
from advdiff_sumo.training.denoiser_stage import (
    DenoiserStage,
    clean,
    measure_scale,
    noise_loss,
    schedule_of,
    spread_steps,
)
from advdiff_sumo.training.displacement import displacement, logged_rollout
from advdiff_sumo.training.joint_stage import JointStage, road_penalty, vehicle_penalty
from advdiff_sumo.training.presets import CollisionOptions, ElboOptions
from advdiff_sumo.training.stage import Moment, Stage, add, means
from tests.training.conftest import TINY


def chance(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def judged(stage: Stage, batch: SceneBatch) -> dict[str, float]:
    with torch.no_grad():
        return means(stage.evaluate(batch, chance()))


def losses(stage: Stage, batch: SceneBatch, steps: int, rate: float) -> list[float]:
    optimiser = torch.optim.Adam(stage.module.parameters(), lr=rate)
    out = []
    for step in range(steps):
        terms = stage.loss(batch, Moment(step, steps, chance(step)))
        optimiser.zero_grad()
        torch.autograd.backward(terms["loss"])
        torch.nn.utils.clip_grad_norm_(stage.module.parameters(), 5.0)
        optimiser.step()
        out.append(float(terms["loss"].detach()))
    return out


def test_the_traffic_model_learns_four_windows_by_heart(bundle: Bundle, batch: SceneBatch) -> None:
    found = losses(TrafficStage(bundle, ElboOptions()), batch, 40, 5e-3)
    assert sum(found[-5:]) < 0.4 * sum(found[:5])


def test_the_denoiser_learns_and_leaves_the_traffic_model_alone(bundle: Bundle, batch: SceneBatch) -> None:
    before = {name: value.clone() for name, value in bundle.traffic.state_dict().items()}
    measure_scale(bundle, [batch], chance())
    stage = DenoiserStage(bundle)
    first = judged(stage, batch.repeat(8))["noise"]
    losses(stage, batch.repeat(8), 60, 3e-3)
    assert judged(stage, batch.repeat(8))["noise"] < 0.8 * first
    assert all(torch.equal(value, before[name]) for name, value in bundle.traffic.state_dict().items())


def test_joint_training_lowers_the_sum(bundle: Bundle, batch: SceneBatch) -> None:
    found = losses(JointStage(bundle, ElboOptions(), CollisionOptions()), batch, 20, 5e-3)
    assert sum(found[-3:]) < 0.7 * sum(found[:3])


def test_joint_training_adds_the_terms_with_their_weights(bundle: Bundle, batch: SceneBatch) -> None:
    options = CollisionOptions(vehicles=3.0, road=0.25, noise=0.5)
    with torch.no_grad():
        terms = JointStage(bundle, ElboOptions(kl_weight=0.1), options).loss(batch, Moment(1, 1, chance()))
    total = terms["reconstruction"] + 0.1 * terms["kl"] + 0.5 * terms["noise"]
    total = total + 3.0 * terms["vehicles"] + 0.25 * terms["road"] + 2.0 * terms["anchor"]
    assert float(terms["loss"]) == pytest.approx(float(total), rel=1e-5)


def test_the_noise_loss_gives_the_posterior_no_gradient(bundle: Bundle, batch: SceneBatch) -> None:
    options = CollisionOptions(vehicles=0.0, road=0.0, samples="none")
    terms = JointStage(bundle, ElboOptions(), options).loss(batch, Moment(0, 1, chance()))
    torch.autograd.backward(terms["noise"])
    assert all(p.grad is None or not p.grad.any() for p in bundle.traffic.posterior.parameters())
    assert any(p.grad is not None and p.grad.any() for p in bundle.denoiser.parameters())


def reached_by(bundle: Bundle, batch: SceneBatch, samples: Literal["denoiser", "decoder"]) -> set[str]:
    """Return the networks that a collision of samples alone gives gradients to."""
    options = CollisionOptions(samples=samples, sampling_steps=2)
    stage = JointStage(bundle, ElboOptions(), options)
    for number in range(4):
        made, _ = stage.sampled(bundle.traffic.encoder(batch), batch, chance(number))
        made[0][0].xy.sum().backward()
    parts = {
        "encoder": bundle.traffic.encoder,
        "decoder": bundle.traffic.decoder,
        "denoiser": bundle.denoiser,
    }
    return {
        name
        for name, part in parts.items()
        if any(p.grad is not None and bool(p.grad.any()) for p in part.parameters())
    }


def test_samples_are_for_the_denoiser_or_for_the_decoder_to_mend(bundle: Bundle, batch: SceneBatch) -> None:
    for weight in bundle.denoiser.parameters():  # untrained it predicts 0, whatever its inner weights
        weight.data += 0.1
    assert reached_by(bundle, batch, "denoiser") == {"denoiser"}
    for module in bundle.modules().values():
        module.zero_grad()
    assert reached_by(bundle, batch, "decoder") == {"encoder", "decoder"}
    assert all(weight.requires_grad for weight in bundle.traffic.decoder.parameters())


def test_the_anchor_is_nothing_at_first_and_grows_with_what_is_changed(
    bundle: Bundle, batch: SceneBatch
) -> None:
    stage = JointStage(bundle, ElboOptions(), CollisionOptions())
    found = []
    for shift in (0.0, 0.1, 0.2):
        bundle.denoiser.out.bias.data.fill_(shift)
        found.append(float(stage.loss(batch, Moment(1, 1, chance()))["anchor"].detach()))
    assert found == pytest.approx([0.0, 0.01, 0.04], abs=1e-6)


def test_a_fixed_traffic_model_without_samples_leaves_the_noise_loss(
    bundle: Bundle, batch: SceneBatch
) -> None:
    stage = JointStage(bundle, ElboOptions(), CollisionOptions(traffic=False, samples="none"))
    terms = stage.loss(batch, Moment(0, 1, chance()))
    assert float(terms["loss"].detach()) == float(terms["noise"].detach()) > 0.0


def test_the_weight_of_kl_rises_straight() -> None:
    options = ElboOptions(kl_anneal_share=0.4)
    shares = [kl_share(progress, options) for progress in (0.0, 0.2, 0.4, 1.0)]
    assert shares == pytest.approx([0.01, 0.505, 1.0, 1.0])
    assert kl_share(0.0, ElboOptions(kl_anneal_share=0.0)) == 1.0


@torch.no_grad()
def test_kl_of_the_elbo_is_per_vehicle_and_free_nats_are_a_floor(bundle: Bundle, batch: SceneBatch) -> None:
    encoded = encode(bundle.traffic, batch, chance())
    zero = torch.zeros_like(encoded.posterior.mean)
    shifted = replace(
        encoded,
        posterior=Gaussian(zero + 2.0, zero),
        context=replace(encoded.context, prior=Gaussian(zero, zero)),
    )
    terms = elbo(shifted, batch, ElboOptions(kl_weight=1.0), 1.0)
    assert float(terms["kl"]) == pytest.approx(8 * 2.0)  # 8 numbers of 2² / 2 nats
    floor = elbo(shifted, batch, ElboOptions(kl_weight=1.0, free_nats=3.0), 1.0)
    assert float(floor["loss"] - floor["reconstruction"]) == pytest.approx(8 * 3.0, rel=1e-5)


@torch.no_grad()
def test_the_codec_is_standardised_over_the_modelled_vehicles(bundle: Bundle, batch: SceneBatch) -> None:
    measure_scale(bundle, [batch, batch], chance())
    context = bundle.traffic.encoder(batch)
    x0 = clean(bundle, batch, context, chance(1))[modelled(batch)]
    assert x0.mean().abs() < 0.2
    assert 0.7 < float(x0.std()) < 1.3


@torch.no_grad()
def test_noise_that_is_predicted_exactly_costs_nothing(bundle: Bundle, batch: SceneBatch) -> None:
    context = bundle.traffic.encoder(batch)
    x0 = clean(bundle, batch, context, chance())
    k, schedule = spread_steps(batch, schedule_of(bundle)), schedule_of(bundle)
    noise = torch.randn(x0.shape, generator=chance(7))

    class Oracle(torch.nn.Module):
        def __init__(self, shift: float) -> None:
            super().__init__()
            self.shift = shift

        def forward(self, x: torch.Tensor, *_: torch.Tensor) -> torch.Tensor:
            assert torch.allclose(x, schedule.noisy(x0, k, noise))
            return noise + self.shift

    for shift, loss in ((0.0, 0.0), (0.5, 0.25)):
        found = noise_loss(Oracle(shift), x0, context, batch, schedule, k, chance(7))  # type: ignore[arg-type]  # stands in
        assert float(found) == pytest.approx(loss, abs=1e-6)


def test_an_untrained_denoiser_has_a_loss_of_one(bundle: Bundle, batch: SceneBatch) -> None:
    assert judged(DenoiserStage(bundle), batch.repeat(16))["noise"] == pytest.approx(1.0, abs=0.1)


def test_the_log_itself_has_no_displacement_and_stays_on_the_road(batch: SceneBatch) -> None:
    found = displacement(logged_rollout(batch), batch)
    assert found.ade_sum() == (0.0, float((batch.present & ~batch.parked).sum()))
    assert float(road_penalty(logged_rollout(batch), batch)) == 0.0


def test_displacements_are_over_known_instants_of_vehicles_that_are_not_parked(batch: SceneBatch) -> None:
    true = logged_rollout(batch)
    ahead = Rollout(true.xy + torch.tensor([3.0, 4.0]), true.yaw, true.speed, true.accel, true.curvature)
    valid = batch.future_valid.clone()
    valid[:, :, 6:] = False
    found = displacement(ahead, replace(batch, future_valid=valid))
    total, number = found.fde_sum()
    assert total / number == pytest.approx(5.0, rel=1e-5)
    assert number == float((batch.present & ~batch.parked).sum())


def test_cars_inside_each_other_and_beside_the_road_cost(batch: SceneBatch) -> None:
    true = logged_rollout(batch)
    place = batch.pose[:, :1, None, :2].expand_as(true.xy)
    heap = Rollout(place, true.yaw, true.speed, true.accel, true.curvature)
    assert float(vehicle_penalty(heap, batch)) > 10.0
    aside = Rollout(true.xy + torch.tensor([0.0, 12.0]), true.yaw, true.speed, true.accel, true.curvature)
    assert float(road_penalty(aside, batch)) > 10.0


def test_tallies_are_weighted_means() -> None:
    total: dict[str, tuple[float, float]] = {}
    add(total, {"a": (6.0, 2.0)})
    add(total, {"a": (1.0, 5.0), "b": (0.0, 0.0)})
    assert means(total) == {"a": 1.0}


def test_draws_of_the_prior_teach_the_decoder_alone(batch: SceneBatch) -> None:
    closed = TINY.model_copy(update={"decoder": "closed-loop"})
    bundle = new_bundle(BundleOptions(model=closed, diffusion_steps=20), seed=1)
    plain = TrafficStage(bundle, ElboOptions())
    stage = TrafficStage(bundle, ElboOptions(samples=1.0))
    terms = stage.loss(batch, Moment(0, 10, chance()))
    wrong = [terms[name] for name in ("overlap_penalty", "lane", "following", "progress")]
    assert float((terms["loss"] - sum(wrong)).detach()) == pytest.approx(
        float(plain.loss(batch, Moment(0, 10, chance()))["loss"].detach()), rel=1e-4
    )
    parts = dict(bundle.traffic.named_children())
    gradients = torch.autograd.grad(sum(wrong), list(bundle.traffic.parameters()), allow_unused=True)
    reached = {
        name.split(".")[0]
        for (name, _), gradient in zip(bundle.traffic.named_parameters(), gradients, strict=True)
        if gradient is not None and gradient.abs().max() > 0.0
    }
    assert reached == {"decoder"} < set(parts)
    figures = judged(stage, batch)
    assert {"collision_rate", "off_road_rate", "travelled", "prior_ade_m"} <= figures.keys()
