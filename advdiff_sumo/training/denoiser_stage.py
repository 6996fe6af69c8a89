"""Stage "denoiser": noise prediction on latents of the frozen traffic model (Sec. III-B, L_noise)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import torch
from torch import Tensor, nn

from advdiff_sumo.diffusion.noise_schedule import NoiseSchedule
from advdiff_sumo.diffusion.sampler import Noise, Sampling, sample
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.denoiser import Denoiser
from advdiff_sumo.models.gaussian import Gaussian
from advdiff_sumo.models.losses import masked_mean
from advdiff_sumo.training.cvae import modelled
from advdiff_sumo.training.displacement import displacement
from advdiff_sumo.training.presets import DenoiserOptions
from advdiff_sumo.training.stage import BundleStage, Moment, Tally

_JUDGED_STEPS = 10
_STANDS_MPS = 0.3
# share of the schedule at which the denoising of a plan begins, as in ``DiffusionOptions``
_PLANS_BEGIN = 0.9


class DenoiserStage(BundleStage):
    """Trains the denoiser only.

    Args:
        bundle: its denoiser is trained in place, the rest is frozen.
        options: weights of the loss.
    """

    name = "denoiser"
    monitor = "noise"

    def __init__(self, bundle: Bundle, options: DenoiserOptions | None = None) -> None:
        # the codec's scale is no parameter, but later stages and a resumed run need it
        super().__init__(bundle, nn.ModuleDict({"denoiser": bundle.denoiser, "codec": bundle.codec}))
        self._options = options or DenoiserOptions()
        self.schedule = schedule_of(bundle)
        bundle.traffic.eval().requires_grad_(False)

    def loss(self, batch: SceneBatch, moment: Moment) -> dict[str, Tensor]:
        """Return the noise loss of the windows, each at one random diffusion step."""
        with torch.no_grad():
            context = self.bundle.traffic.encoder(batch)
            x0 = clean(self.bundle, batch, context, moment.generator)
            weight = loss_weight(self.bundle, batch, context, self._options)
        k = random_steps(batch, self.schedule, moment.generator)
        net, generator = self.bundle.denoiser, moment.generator
        loss = noise_loss(net, x0, context, batch, self.schedule, k, generator, weight)
        if not self._options.samples:
            return {"loss": loss}
        score = sample_score(self.bundle, x0, context, batch, self._options.sampling_steps, generator, weight)
        return {"loss": loss + self._options.samples * score, "noise": loss, "score": score}

    def evaluate(self, batch: SceneBatch, generator: torch.Generator) -> Tally:
        """Return the noise loss at steps spread over the schedule, and the displacement of one sample."""
        return judge(self.bundle, batch, generator)


def judge(bundle: Bundle, batch: SceneBatch, generator: torch.Generator) -> Tally:
    """Return the noise loss at steps spread over the schedule, and the displacement of one sample."""
    context = bundle.traffic.encoder(batch)
    x0 = clean(bundle, batch, context, generator)
    schedule = schedule_of(bundle)
    k = spread_steps(batch, schedule)
    loss = noise_loss(bundle.denoiser, x0, context, batch, schedule, k, generator)
    drawn = diffused_samples(bundle, context, Sampling(_JUDGED_STEPS), generator)
    tally = displacement(bundle.codec.decode(drawn, context, batch), batch)
    weight = float(batch.scenes)
    return {
        "noise": (float(loss) * weight, weight),
        "sample_ade_m": tally.ade_sum(),
        "sample_fde_m": tally.fde_sum(),
    }


def schedule_of(bundle: Bundle) -> NoiseSchedule:
    """Return the noise schedule of the bundle's denoiser."""
    return NoiseSchedule(bundle.options.diffusion_steps, bundle.options.schedule)


def clean(bundle: Bundle, batch: SceneBatch, context: Context, generator: torch.Generator) -> Tensor:
    """Return scaled x⁰ (B, A, C, L) of the known futures: z̃⁰ from the posterior, or the trajectories."""
    return bundle.codec.scale(bundle.codec.raw(batch, context, generator))


def random_steps(batch: SceneBatch, schedule: NoiseSchedule, generator: torch.Generator) -> Tensor:
    """Return a diffusion step (B,) for each scene, uniform in 1 … K."""
    drawn = torch.randint(1, schedule.steps + 1, (batch.scenes,), generator=generator)
    return drawn.to(batch.past.device)


def spread_steps(batch: SceneBatch, schedule: NoiseSchedule) -> Tensor:
    """Return diffusion steps (B,) evenly spread over 1 … K."""
    middle = (torch.arange(batch.scenes) + 0.5) / batch.scenes
    return (1 + (middle * schedule.steps).long()).clamp(max=schedule.steps).to(batch.past.device)


def noise_loss(
    denoiser: Denoiser,
    x0: Tensor,
    context: Context,
    batch: SceneBatch,
    schedule: NoiseSchedule,
    k: Tensor,
    generator: torch.Generator,
    weight: Tensor | None = None,
) -> Tensor:
    """Return the mean of ‖ε(x̃ᵏ, k, z, h) − ε‖² over the modelled vehicles and the numbers of x̃ (L_noise).

    Args:
        denoiser: ε.
        x0: (B, A, C, L) scaled data.
        context: h and prior; its mean is the condition z.
        batch: the windows.
        schedule: of the noise.
        k: (B,) diffusion steps.
        generator: of the noise.
        weight: (B, A, C, L) weights of the components of x̃; None: 1.
    """
    noise = torch.randn(x0.shape, generator=generator).to(x0)
    predicted = denoiser(schedule.noisy(x0, k, noise), k, context)
    error = (predicted - noise).square()
    if weight is not None:
        error = weight * error
    return masked_mean(error.flatten(2).mean(-1), modelled(batch))


def loss_weight(bundle: Bundle, batch: SceneBatch, context: Context, options: DenoiserOptions) -> Tensor:
    """Return weights (B, A, C, L) of the components of x⁰ in the loss, with mean 1 for each vehicle.

    Most dimensions of the latent carry almost no information: their noise cannot be predicted, and dominates the loss.
    ``options.information`` weights each by its KL divergence from the standard normal, over the modelled vehicles of
    the batch.
    """
    standing = (batch.pose[..., 3].abs() < _STANDS_MPS).to(context.h.dtype)
    weight = (1.0 + (options.standing - 1.0) * standing)[..., None, None]
    if not (options.information and isinstance(bundle.codec, LatentCodec)):
        return weight.expand(-1, -1, *bundle.codec.shape)
    posterior: Gaussian = bundle.traffic.posterior(batch, context.h)
    mean = bundle.codec.scale(posterior.mean[:, :, None])[:, :, 0]
    logvar = posterior.logvar - 2.0 * bundle.codec.std[0].log()
    known = modelled(batch)
    nats = 0.5 * (mean.square() + logvar.exp() - logvar - 1.0)[known].mean(0)
    share = options.information * nats / nats.mean().clamp(min=1e-6) + 1.0 - options.information
    counts: Tensor = weight * share[None, None, None]
    return counts


def sample_score(
    bundle: Bundle,
    x0: Tensor,
    context: Context,
    batch: SceneBatch,
    steps: int,
    generator: torch.Generator,
    weight: Tensor,
) -> Tensor:
    """Return the continuous ranked probability score of the denoiser's finished samples, with gradients.

    For each component: the mean of |x − x⁰| over two samples, minus half their distance (Gneiting and Raftery 2007,
    doi:10.1198/016214506000001437, Eq. 21). It is least if samples of *steps* steps, as in a plan, are distributed as
    the data. With the noise loss alone such samples fall between two modes.

    Args:
        bundle: provides the denoiser.
        x0: (B, A, C, L) scaled data.
        context: of the windows.
        batch: the windows.
        steps: denoising steps of a sample.
        generator: of the initial noise.
        weight: (B, A, C, L) weights of the components.
    """
    start = torch.randn((2 * x0.shape[0], *x0.shape[1:]), generator=generator).to(x0)
    noise_of, schedule = noise_at(bundle.denoiser, context.repeat(2)), schedule_of(bundle)
    sampling = Sampling(steps=steps, eta=0.0, begin=_PLANS_BEGIN)
    drawn = sample(noise_of, start, schedule, sampling, generator)
    first, second = drawn.reshape(-1, 2, *x0.shape[1:]).unbind(1)
    score = 0.5 * ((first - x0).abs() + (second - x0).abs() - (first - second).abs())
    return masked_mean((weight * score).flatten(2).mean(-1), modelled(batch))


def diffused_samples(
    bundle: Bundle, context: Context, sampling: Sampling, generator: torch.Generator
) -> Tensor:
    """Return unguided samples x̃⁰ (B, A, C, L) of the denoiser with the settings *sampling*.

    The number of steps is at most that of its schedule.
    """
    schedule = schedule_of(bundle)
    shape = (*context.h.shape[:2], *bundle.codec.shape)
    start = torch.randn(shape, generator=generator).to(context.h)
    return sample(
        noise_at(bundle.denoiser, context),
        start,
        schedule,
        replace(sampling, steps=min(sampling.steps, schedule.steps)),
        generator,
    )


def noise_at(denoiser: Denoiser, context: Context) -> Noise:
    """Return *denoiser* as ε(x, k) for the scenes of *context*."""

    def noise_of(x: Tensor, k: int) -> Tensor:
        at = torch.full((x.shape[0],), k, device=x.device)
        prediction: Tensor = denoiser(x, at, context)
        return prediction

    return noise_of


@torch.no_grad()
def measure_scale(bundle: Bundle, batches: Iterable[SceneBatch], generator: torch.Generator) -> None:
    """Set the codec's scale to mean and deviation of its values for the modelled vehicles of *batches*."""
    raw = []
    for batch in batches:
        context = bundle.traffic.encoder(batch)
        raw.append(bundle.codec.raw(batch, context, generator)[modelled(batch)])
    bundle.codec.measure(torch.cat(raw))
