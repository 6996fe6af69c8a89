"""Stage "traffic": context encoder, posterior and decoder by the ELBO (Sec. III-B, Training)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.gaussian import Gaussian
from advdiff_sumo.models.losses import masked_mean, reconstruction
from advdiff_sumo.models.traffic import TrafficModel
from advdiff_sumo.training.displacement import displacement
from advdiff_sumo.training.own_samples import decoded_pair, faults, sample_judge
from advdiff_sumo.training.presets import DecoderOptions, ElboOptions
from advdiff_sumo.training.stage import BundleStage, Moment, Tally

_KL_START = 0.01


@dataclass(frozen=True)
class Encoded:
    """Outputs of the traffic model for windows with known future.

    Attributes:
        context: h and prior.
        posterior: q(z | τ, h).
        rollout: decoded sample of the posterior.
    """

    context: Context
    posterior: Gaussian
    rollout: Rollout


class TrafficStage(BundleStage):
    """Trains the traffic VAE.

    Args:
        bundle: its traffic model is trained in place.
        options: weights of the loss terms.
        sampled: weights of the penalties of samples of the prior.
        compiled: whether to compile these penalties.
    """

    name = "traffic"
    monitor = "loss"

    def __init__(
        self,
        bundle: Bundle,
        options: ElboOptions,
        sampled: DecoderOptions | None = None,
        compiled: bool = False,
    ) -> None:
        super().__init__(bundle, bundle.traffic)
        self.options, self.sampled = options, sampled or DecoderOptions()
        self._judge = sample_judge(compiled)

    def loss(self, batch: SceneBatch, moment: Moment) -> dict[str, Tensor]:
        """Return the negative ELBO and its parts."""
        return self._terms(batch, kl_share(moment.progress, self.options), moment.generator)[0]

    def evaluate(self, batch: SceneBatch, generator: torch.Generator) -> Tally:
        """Return the loss at the full weight of KL, and displacement errors of posterior and prior."""
        model = self.bundle.traffic
        terms, encoded, free = self._terms(batch, 1.0, generator)
        tally = {name: (float(value) * batch.scenes, float(batch.scenes)) for name, value in terms.items()}
        if free is not None:
            tally |= faults(free, batch)
        context = encoded.context
        for name, z in (("posterior", encoded.posterior.mean), ("prior", context.prior.mean)):
            errors = displacement(model.decoder(z, context.h, batch), batch)
            tally[f"{name}_ade_m"], tally[f"{name}_fde_m"] = errors.ade_sum(), errors.fde_sum()
        return tally

    def _terms(
        self, batch: SceneBatch, share: float, generator: torch.Generator
    ) -> tuple[dict[str, Tensor], Encoded, Rollout | None]:
        """Return the loss terms, the outputs they are of, and decoded samples of the prior, if these are penalised.

        The penalties train the decoder only.
        """
        model, options = self.bundle.traffic, self.options
        if options.samples == 0.0:
            encoded = encode(model, batch, generator)
            return elbo(encoded, batch, options, share), encoded, None
        context = model.encoder(batch)
        posterior = model.posterior(batch, context.h)
        z = posterior.sample(generator)
        drawn = context.prior.sample(generator).detach()
        known, free = decoded_pair(model.decoder, (z, drawn), (context.h, context.h.detach()), batch)
        encoded = Encoded(context, posterior, known)
        terms = elbo(encoded, batch, options, share)
        wrong = self._judge(free, batch, self.sampled)
        terms["loss"] = terms["loss"] + options.samples * torch.stack(list(wrong.values())).sum()
        return terms | wrong, encoded, free


def encode(model: TrafficModel, batch: SceneBatch, generator: torch.Generator) -> Encoded:
    """Return context, posterior and a decoded sample of the posterior."""
    context = model.encoder(batch)
    posterior = model.posterior(batch, context.h)
    z = posterior.sample(generator)
    return Encoded(context, posterior, model.decoder(z, context.h, batch))


def elbo(encoded: Encoded, batch: SceneBatch, options: ElboOptions, kl_share: float) -> dict[str, Tensor]:
    """Return the negative ELBO as "loss", with "reconstruction" and "kl".

    Args:
        encoded: of :func:`encode`.
        batch: the windows.
        options: weights.
        kl_share: annealing factor of the KL's weight.
    """
    error = known_mean(reconstruction(encoded.rollout, batch), batch)
    divergence = encoded.posterior.kl(encoded.context.prior)  # (B, A, Z)
    is_modelled = modelled(batch)
    kl = masked_mean(divergence.sum(-1), is_modelled)
    paid = (
        masked_mean(divergence.clamp(min=options.free_nats).sum(-1), is_modelled) if options.free_nats else kl
    )
    loss = error + kl_share * options.kl_weight * paid
    return {"loss": loss, "reconstruction": error, "kl": kl}


def kl_share(progress: float, options: ElboOptions) -> float:
    """Return the annealing factor of the KL's weight at *progress* of the training: linear from 0.01 to 1."""
    if progress >= options.kl_anneal_share:
        return 1.0
    return _KL_START + (1.0 - _KL_START) * progress / options.kl_anneal_share


def modelled(batch: SceneBatch) -> Tensor:
    """Return (B, A) vehicles with at least one known future instant."""
    return batch.moved & batch.future_valid.any(-1)


def known_mean(value: Tensor, batch: SceneBatch) -> Tensor:
    """Return the mean of *value* (B, A, T) over the known instants of vehicles."""
    return masked_mean(value, batch.future_valid & batch.moved[..., None])
