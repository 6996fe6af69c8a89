"""DDIM sampling, guided or not (Sec. III-B Eq. 2, Sec. III-C, Song et al. 2021, arXiv:2010.02502)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, TypeAlias

import torch
from torch import Tensor

from advdiff_sumo.diffusion.noise_schedule import NoiseSchedule
from advdiff_sumo.models.gaussian import draw

Family: TypeAlias = Literal["printed", "consistent"]
Noise: TypeAlias = Callable[[Tensor, int], Tensor]
"""ε(x, k): (B, A, C, L) and a step → (B, A, C, L)."""


@dataclass(frozen=True)
class SamplingStep:
    """One denoising step, as passed to a guide.

    Attributes:
        left: number of steps that follow.
        alpha: α after the step; μ is data times √α plus noise.
        deviation: √Σ of Eq. (2), for every family and η; 0 in the last step.
    """

    left: int
    alpha: float
    deviation: float


Guide: TypeAlias = Callable[[Tensor, SamplingStep], Tensor]
"""(μ (B, A, C, L), step) → shift added to μ."""


@dataclass(frozen=True)
class Sampling:
    """Settings of the sampler.

    Attributes:
        steps: K̂, number of denoising steps.
        family: "printed": Eq. (2) as printed, the deterministic DDIM mean plus noise of the posterior's variance;
            "consistent": the DDIM family, whose marginals match the forward process for every η.
        eta: noise added in each step, as a share of the posterior's standard deviation; "printed" has 1.
        begin: share of the schedule at which sampling starts from pure noise. Near its end, data predicted from ε is
            mostly error, as it is divided by √α; without new noise (η = 0) later steps do not correct that.
        clip: bound on the absolute predicted data, in standard deviations; 0: none.
    """

    steps: int = 10
    family: Family = "consistent"
    eta: float = 1.0
    begin: float = 1.0
    clip: float = 4.0


def transition(
    x: Tensor, noise: Tensor, k: int, to: int, schedule: NoiseSchedule, sampling: Sampling
) -> tuple[Tensor, float]:
    """Return mean μ and standard deviation of the transition from *k* to *to* < *k*.

    With α the cumulative products and β = 1 − α^k / α^to, the variance is Σ = (1 − α^to) / (1 − α^k) β. The
    printed mean is √α^to x̂⁰ + √(1 − α^to) ε; the consistent one has √(1 − α^to − η² Σ) before ε.

    Args:
        x: (…) noisy sample at *k*.
        noise: (…) predicted noise.
        k: present step, at least 1.
        to: next step.
        schedule: provides α.
        sampling: family, η and clipping.
    """
    now, then = float(schedule.alpha[k]), float(schedule.alpha[to])
    clean = (x - (1.0 - now) ** 0.5 * noise) / now**0.5
    if sampling.clip > 0.0:
        clean = clean.clamp(-sampling.clip, sampling.clip)
        noise = (x - now**0.5 * clean) / (1.0 - now) ** 0.5
    variance = posterior_deviation(k, to, schedule) ** 2
    if sampling.family == "printed":
        return then**0.5 * clean + (1.0 - then) ** 0.5 * noise, variance**0.5
    variance *= sampling.eta**2
    return then**0.5 * clean + max(1.0 - then - variance, 0.0) ** 0.5 * noise, variance**0.5


def posterior_deviation(k: int, to: int, schedule: NoiseSchedule) -> float:
    """Return √Σ of Eq. (2) for the step from *k* to *to*, with β = 1 − α^k / α^to."""
    now, then = float(schedule.alpha[k]), float(schedule.alpha[to])
    return float(((1.0 - then) / (1.0 - now) * (1.0 - now / then)) ** 0.5)


def sample(
    noise_of: Noise,
    start: Tensor,
    schedule: NoiseSchedule,
    sampling: Sampling,
    generator: torch.Generator,
    guide: Guide | None = None,
) -> Tensor:
    """Return samples (B, A, C, L) denoised from standard normal noise *start*.

    In each step the guide's shift is added to the mean before noise is drawn (Alg. 1).

    Args:
        noise_of: noise prediction with its condition.
        start: (B, A, C, L) noise.
        schedule: that of the network's training.
        sampling: steps and family.
        generator: of the steps' noise; on the CPU, so that a seed gives the same samples on every device.
        guide: shifts the means; None: natural samples.
    """
    x = start
    ladder = schedule.ladder(sampling.steps, sampling.begin)
    for left, (k, to) in zip(reversed(range(sampling.steps)), pairwise(ladder), strict=True):
        mean, deviation = transition(x, noise_of(x, k), k, to, schedule, sampling)
        if guide is not None:
            mean = mean + guide(
                mean, SamplingStep(left, float(schedule.alpha[to]), posterior_deviation(k, to, schedule))
            )
        x = mean
        if deviation > 0.0 and to > 0:
            x = x + deviation * draw(x, generator)
    return x


@dataclass(frozen=True)
class StepPrediction:
    """A prediction of the network during sampling.

    Attributes:
        clean: (B, A, C, L) predicted data.
        noise: (B, A, C, L) predicted noise, before clipping.
        x: (B, A, C, L) input, without gradients.
        k: step.
        alpha: α of that step.
    """

    clean: Tensor
    noise: Tensor
    x: Tensor
    k: int
    alpha: float


def predict_at_step(
    noise_of: Noise,
    start: Tensor,
    schedule: NoiseSchedule,
    sampling: Sampling,
    generator: torch.Generator,
    done: int,
) -> StepPrediction:
    """Return the network's prediction after *done* natural steps.

    Gradients flow through the last prediction only.

    Args: those of :func:`sample` without *guide*, and *done*, 0 … ``sampling.steps`` − 1.
    """
    x, ladder = start, schedule.ladder(sampling.steps, sampling.begin)
    with torch.no_grad():
        for k, to in pairwise(ladder[: done + 1]):
            x, deviation = transition(x, noise_of(x, k), k, to, schedule, sampling)
            x = x + deviation * draw(x, generator)
    k = ladder[done]
    noise = noise_of(x, k)
    clean, _ = transition(x, noise, k, 0, schedule, sampling)
    return StepPrediction(clean, noise, x, k, float(schedule.alpha[k]))
