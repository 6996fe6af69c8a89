"""Stage "joint": trains traffic model and denoiser together, with collision penalties (Sec. III-B, L_joint)."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import torch
from torch import Tensor, nn

from advdiff_sumo.diffusion.sampler import Sampling, predict_at_step
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.gaussian import Gaussian
from advdiff_sumo.models.losses import masked_mean, off_road, pair_overlap
from advdiff_sumo.training.cvae import TrafficStage, elbo, encode, kl_share
from advdiff_sumo.training.denoiser_stage import (
    clean,
    diffused_samples,
    judge,
    noise_at,
    noise_loss,
    random_steps,
    schedule_of,
)
from advdiff_sumo.training.displacement import logged_rollout
from advdiff_sumo.training.presets import CollisionOptions, ElboOptions
from advdiff_sumo.training.stage import BundleStage, Moment, Tally


class JointStage(BundleStage):
    """Trains traffic model and denoiser by L_ELBO + L_noise + P_coll.

    L_noise sends no gradient to z̃⁰: the posterior could otherwise reduce it by losing information.

    Args:
        bundle: trained in place, except its reward model.
        elbo_options: weights of the ELBO.
        options: weights of the other terms.
    """

    name = "joint"
    monitor = "loss"

    def __init__(self, bundle: Bundle, elbo_options: ElboOptions, options: CollisionOptions) -> None:
        self.elbo_options, self.options = elbo_options, options
        self.schedule = schedule_of(bundle)
        self._began = copy.deepcopy(bundle.denoiser).eval().requires_grad_(False)
        parts: dict[str, nn.Module] = {"denoiser": bundle.denoiser, "codec": bundle.codec}
        if options.traffic:
            parts["traffic"] = bundle.traffic
        else:
            bundle.traffic.eval().requires_grad_(False)
        super().__init__(bundle, nn.ModuleDict(parts))

    def loss(self, batch: SceneBatch, moment: Moment) -> dict[str, Tensor]:
        """Return L_joint and its parts."""
        k = random_steps(batch, self.schedule, moment.generator)
        return self._terms(batch, k, kl_share(moment.progress, self.elbo_options), moment.generator)

    def evaluate(self, batch: SceneBatch, generator: torch.Generator) -> Tally:
        """Return the loss, and displacement errors of traffic model and denoiser."""
        k = random_steps(batch, self.schedule, generator)
        terms = self._terms(batch, k, 1.0, generator)
        tally = TrafficStage(self.bundle, self.elbo_options).evaluate(batch, generator)
        tally |= judge(self.bundle, batch, generator)
        weight = float(batch.scenes)
        return tally | {name: (float(value) * weight, weight) for name, value in terms.items()}

    def _terms(
        self, batch: SceneBatch, k: Tensor, share: float, generator: torch.Generator
    ) -> dict[str, Tensor]:
        bundle, options = self.bundle, self.options
        terms, rollouts, context = self._likely(batch, share, generator)
        with torch.no_grad():
            x0 = clean(bundle, batch, context, generator)
        terms["noise"] = noise_loss(bundle.denoiser, x0, context, batch, self.schedule, k, generator)
        more, terms["anchor"] = self.sampled(context, batch, generator)
        rollouts += more
        terms["vehicles"] = _mean(vehicle_penalty, rollouts, batch)
        terms["road"] = _mean(road_penalty, rollouts, batch)
        terms["loss"] = (
            terms["loss"]
            + options.noise * terms["noise"]
            + options.vehicles * terms["vehicles"]
            + options.road * terms["road"]
            + options.anchor * terms["anchor"]
        )
        return terms

    def _likely(
        self, batch: SceneBatch, share: float, generator: torch.Generator
    ) -> tuple[dict[str, Tensor], list[tuple[Rollout, float]], Context]:
        """Return the ELBO's terms, the posterior's futures and the context; only the last for a fixed traffic model."""
        traffic = self.bundle.traffic
        if not self.options.traffic:
            with torch.no_grad():
                return {"loss": batch.past.new_zeros(())}, [], traffic.encoder(batch)
        encoded = encode(traffic, batch, generator)
        return elbo(encoded, batch, self.elbo_options, share), [(encoded.rollout, 1.0)], encoded.context

    def sampled(
        self, context: Context, batch: SceneBatch, generator: torch.Generator
    ) -> tuple[list[tuple[Rollout, float]], Tensor]:
        """Return futures sampled by the model, each with its weight, and the loss of the anchor."""
        options, unmoved = self.options, batch.past.new_zeros(())
        if options.samples == "none":
            return [], unmoved
        if options.samples == "prior":
            drawn = context.prior.sample(generator)
            return [(self.bundle.traffic.decoder(drawn, context.h, batch), 1.0)], unmoved
        if options.samples == "denoiser":
            rollout, weight, strayed = self._predicted(_fixed(context), batch, generator)
            return [(rollout, weight)], strayed
        with torch.no_grad():
            drawn = diffused_samples(self.bundle, context, Sampling(options.sampling_steps), generator)
        return [(self.bundle.codec.decode(drawn, context, batch), 1.0)], unmoved

    def _predicted(
        self, context: Context, batch: SceneBatch, generator: torch.Generator
    ) -> tuple[Rollout, float, Tensor]:
        """Return the denoiser's decoded prediction at a random step, its weight and anchor loss; the decoder is fixed.

        Early predictions average over possible futures, so their weight is α. The anchor loss is the mean of
        ‖ε − ε of the initial denoiser‖² over vehicles and components.
        """
        bundle, sampling = self.bundle, Sampling(steps=self.options.sampling_steps)
        done = int(torch.randint(sampling.steps, (), generator=generator))
        shape = (*context.h.shape[:2], *bundle.codec.shape)
        start = torch.randn(shape, generator=generator).to(context.h)
        prediction = predict_at_step(
            noise_at(bundle.denoiser, context), start, self.schedule, sampling, generator, done
        )
        with torch.no_grad():
            before = noise_at(self._began, context)(prediction.x, prediction.k)
        strayed = masked_mean((prediction.noise - before).square().flatten(2).mean(-1), batch.moved)
        with _untrained(bundle.traffic.decoder):
            return bundle.codec.decode(prediction.clean, context, batch), prediction.alpha, strayed


def _fixed(context: Context) -> Context:
    """Return *context* without gradients."""
    prior = Gaussian(context.prior.mean.detach(), context.prior.logvar.detach())
    return replace(context, h=context.h.detach(), prior=prior)


@contextmanager
def _untrained(module: nn.Module) -> Iterator[None]:
    """Keep computations of *module* inside a ``with`` block from sending gradients to its weights."""
    trained = [weight for weight in module.parameters() if weight.requires_grad]
    for weight in trained:
        weight.requires_grad_(False)
    try:
        yield
    finally:
        for weight in trained:
            weight.requires_grad_(True)


def _mean(
    penalty: Callable[[Rollout, SceneBatch], Tensor], rollouts: list[tuple[Rollout, float]], batch: SceneBatch
) -> Tensor:
    """Return the weighted mean of the *penalty* of *rollouts*; 0 without rollouts."""
    if not rollouts:
        return batch.past.new_zeros(())
    return torch.stack([weight * penalty(rollout, batch) for rollout, weight in rollouts]).mean()


def vehicle_penalty(rollout: Rollout, batch: SceneBatch) -> Tensor:
    """Return P_coll between agents: overlap summed over others and instants, mean over vehicles that are not parked."""
    overlap = pair_overlap(rollout, batch.size, batch.present)  # (B, A, A, T)
    return masked_mean(overlap.sum((2, 3)), batch.moved & ~batch.parked)


def road_penalty(rollout: Rollout, batch: SceneBatch) -> Tensor:
    """Return P_coll with the environment: overlap with the road edge in excess of the log's, averaged over vehicles.

    In logs, vehicles may leave the drivable area, for example into parking places; this is not penalised.
    """
    over = off_road(rollout, batch)
    truth = off_road(logged_rollout(batch), batch)
    known = batch.future_valid & batch.moved[..., None]
    extra = torch.where(known, (over - truth).clamp(min=0.0), 0.0)
    return masked_mean(extra.sum(-1), batch.moved & ~batch.parked)
