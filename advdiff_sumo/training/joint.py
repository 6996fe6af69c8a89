"""Stage "joint": all of traffic model and denoiser together, with collision penalties (Sec. III-B, L_joint)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.losses import off_road, pair_overlap
from advdiff_sumo.training.denoiser import clean, diffused, judge, noise_loss, random_steps, schedule_of
from advdiff_sumo.training.presets import CollisionOptions, ElboOptions
from advdiff_sumo.training.stage import Moment, Tally
from advdiff_sumo.training.traffic import TrafficStage, elbo, encode, kl_share, masked_mean


class JointStage:
    """Trains traffic model and denoiser by L_ELBO + L_noise + P_coll.

    z̃⁰ carries no gradient in L_noise: otherwise the posterior could lower it by giving up information.

    Args:
        bundle: trained in place, all but its reward model.
        elbo_options: weights of the ELBO.
        options: weights of the other terms.
    """

    name = "joint"
    monitor = "loss"

    def __init__(self, bundle: Bundle, elbo_options: ElboOptions, options: CollisionOptions) -> None:
        self._bundle, self.elbo_options, self.options = bundle, elbo_options, options
        self.schedule = schedule_of(bundle)
        parts = {"traffic": bundle.traffic, "denoiser": bundle.denoiser, "codec": bundle.codec}
        self.module: nn.Module = nn.ModuleDict(parts)
        self.beside: nn.Module = nn.Module()

    def loss(self, batch: SceneBatch, moment: Moment) -> dict[str, Tensor]:
        """Return L_joint and its parts."""
        k = random_steps(batch, self.schedule, moment.generator)
        return self._terms(batch, k, kl_share(moment.progress, self.elbo_options), moment.generator)

    def evaluate(self, batch: SceneBatch, generator: torch.Generator) -> Tally:
        """Return the loss, and the displacements of both parts."""
        k = random_steps(batch, self.schedule, generator)
        terms = self._terms(batch, k, 1.0, generator)
        tally = TrafficStage(self._bundle, self.elbo_options).evaluate(batch, generator)
        tally |= judge(self._bundle, batch, generator)
        weight = float(batch.scenes)
        return tally | {name: (float(value) * weight, weight) for name, value in terms.items()}

    def after_step(self) -> None:
        """Do nothing."""

    def bundle(self) -> Bundle:
        """Return the bundle with the trained models."""
        return self._bundle

    def _terms(
        self, batch: SceneBatch, k: Tensor, share: float, generator: torch.Generator
    ) -> dict[str, Tensor]:
        bundle, options = self._bundle, self.options
        encoded = encode(bundle.traffic, batch, generator)
        terms = elbo(encoded, batch, self.elbo_options, share)
        with torch.no_grad():
            x0 = clean(bundle, batch, encoded.context, generator)
        terms["noise"] = noise_loss(bundle.denoiser, x0, encoded.context, batch, self.schedule, k, generator)
        rollouts = [encoded.rollout, *self._sampled(encoded.context, batch, generator)]
        terms["vehicles"] = torch.stack([vehicle_penalty(r, batch) for r in rollouts]).mean()
        terms["road"] = torch.stack([road_penalty(r, batch) for r in rollouts]).mean()
        terms["loss"] = (
            terms["loss"]
            + options.noise * terms["noise"]
            + options.vehicles * terms["vehicles"]
            + options.road * terms["road"]
        )
        return terms

    def _sampled(self, context: Context, batch: SceneBatch, generator: torch.Generator) -> list[Rollout]:
        """Return what the model makes of these scenes on its own, as the options say."""
        if self.options.samples == "none":
            return []
        if self.options.samples == "prior":
            return [self._bundle.traffic.decoder(context.prior.sample(generator), context.h, batch)]
        with torch.no_grad():
            drawn = diffused(self._bundle, context, self.options.sampling_steps, generator)
        return [self._bundle.codec.decode(drawn, context, batch)]


def vehicle_penalty(rollout: Rollout, batch: SceneBatch) -> Tensor:
    """Return P_coll between agents: overlap summed over others and instants, mean over vehicles not parked."""
    overlap = pair_overlap(rollout, batch.size, batch.present)  # (B, A, A, T)
    return masked_mean(overlap.sum((2, 3)), batch.moved & ~batch.parked)


def road_penalty(rollout: Rollout, batch: SceneBatch) -> Tensor:
    """Return P_coll with the environment: overlap with the road's edge beyond what the log has, summed and meant.

    A log knows vehicles that leave the drivable area, into parking places for one: what they do is no fault.
    """
    over = off_road(rollout, batch)
    logged = off_road(_logged(batch), batch)
    known = batch.future_valid & batch.moved[..., None]
    extra = torch.where(known, (over - logged).clamp(min=0.0), 0.0)
    return masked_mean(extra.sum(-1), batch.moved & ~batch.parked)


def _logged(batch: SceneBatch) -> Rollout:
    future = batch.future
    nothing = torch.zeros_like(future[..., 0])
    return Rollout(future[..., :2], future[..., 2], future[..., 3], nothing, nothing)
