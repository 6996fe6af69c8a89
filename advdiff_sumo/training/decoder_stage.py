"""Stage "decoder": trains only the closed-loop decoder, between a fixed encoder and denoiser.

It learns from two kinds of latents at once. Latents of the posterior shall be decoded to the recorded future. Samples
of the denoiser shall be decoded to futures without overlap: the penalties of ``diffusion.sample_refinement`` train
the network instead of moving a finished sample. Two terms keep vehicles from standing still, which would minimise
these penalties: an anchor to the initial decoder's futures, and the distances driven in the log.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import torch
from torch import Tensor

from advdiff_sumo.diffusion.sample_refinement import RefinementOptions, overlap_penalty
from advdiff_sumo.diffusion.sampler import Sampling
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Decoder, Rollout
from advdiff_sumo.models.losses import masked_mean, reconstruction
from advdiff_sumo.training.cvae import known_mean
from advdiff_sumo.training.denoiser_stage import diffused_samples
from advdiff_sumo.training.displacement import displacement
from advdiff_sumo.training.own_samples import decoded_pair, faults, sample_judge
from advdiff_sumo.training.presets import DecoderOptions
from advdiff_sumo.training.stage import BundleStage, Moment, Tally

_FAULTY = 1e-3


class DecoderStage(BundleStage):
    """Trains the decoder; encoder, posterior, codec, denoiser and reward model are frozen.

    Args:
        bundle: its decoder is trained in place.
        began: the initial decoder, whose futures are the anchor; not changed.
        options: weights of the loss terms.
        compiled: whether to compile the penalties.
    """

    name = "decoder"
    monitor = "loss"

    def __init__(
        self, bundle: Bundle, began: Decoder, options: DecoderOptions, compiled: bool = False
    ) -> None:
        assert isinstance(bundle.codec, LatentCodec)  # noqa: S101 - setup refuses others for this stage
        bundle.frozen()
        decoder = bundle.traffic.decoder
        super().__init__(bundle, decoder.requires_grad_(True))
        self.options = options
        self._judge = sample_judge(compiled)
        device = decoder.start.weight.device
        self._began = copy.deepcopy(began).eval().requires_grad_(False).to(device)

    def loss(self, batch: SceneBatch, moment: Moment) -> dict[str, Tensor]:
        """Return the weighted sum and its terms."""
        context, latents, before = self._latents(batch, moment.generator)
        known, free = decoded_pair(self.bundle.traffic.decoder, latents, (context.h, context.h), batch)
        return self._terms(known, free, before, batch)

    @torch.no_grad()
    def evaluate(self, batch: SceneBatch, generator: torch.Generator) -> Tally:
        """Return the loss, displacement errors of posterior and sample, and the sample's collisions and departures."""
        context, latents, before = self._latents(batch, generator)
        known, free = decoded_pair(self.bundle.traffic.decoder, latents, (context.h, context.h), batch)
        terms, weight = self._terms(known, free, before, batch), float(batch.scenes)
        return {
            **{name: (float(value) * weight, weight) for name, value in terms.items()},
            "posterior_ade_m": displacement(known, batch).ade_sum(),
            "sample_ade_m": displacement(free, batch).ade_sum(),
            **faults(free, batch),
        }

    @torch.no_grad()
    def _latents(
        self, batch: SceneBatch, generator: torch.Generator
    ) -> tuple[Context, tuple[Tensor, Tensor], Rollout]:
        """Return context, latents (B, A, Z) of posterior and denoiser, and futures of the latter at the beginning."""
        traffic, codec = self.bundle.traffic, self.bundle.codec
        context = traffic.encoder(batch)
        posterior = traffic.posterior(batch, context.h).sample(generator)
        scaled = diffused_samples(self.bundle, context, Sampling(self.options.sampling_steps), generator)
        drawn = codec.unscale(scaled)[:, :, 0]
        return context, (posterior, drawn), self._began(drawn, context.h, batch)

    def _terms(self, known: Rollout, free: Rollout, before: Rollout, batch: SceneBatch) -> dict[str, Tensor]:
        options, is_driven = self.options, batch.moved & ~batch.parked
        how = RefinementOptions(vehicles=options.vehicles, road=options.road)
        fits = overlap_penalty(before, batch, how) < _FAULTY
        is_present = batch.present[..., None].expand(before.yaw.shape)
        same = reconstruction(free, replace(batch, future=before.states(), future_valid=is_present)).mean(-1)
        terms = {
            "reconstruction": known_mean(reconstruction(known, batch), batch),
            "anchor": options.anchor * masked_mean(same, is_driven & fits),
            **self._judge(free, batch, options),
        }
        return {"loss": torch.stack(list(terms.values())).sum(), **terms}
