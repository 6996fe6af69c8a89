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
    """One step of a ladder, as a guide sees it.

    Attributes:
        left: steps that follow.
        alpha: α of the step that is gone to; μ is data times √α plus noise.
        deviation: √Σ of Eq. (2), whatever the family and η; 0 at the last step.
    """

    left: int
    alpha: float
    deviation: float


Guide: TypeAlias = Callable[[Tensor, SamplingStep], Tensor]
"""(μ (B, A, C, L), where on the ladder) → what is added to μ."""


@dataclass(frozen=True)
class Sampling:
    """How noise becomes a sample.

    Attributes:
        steps: K̂, steps taken through the schedule.
        family: "printed": Eq. (2) as it stands, the deterministic DDIM mean plus noise of the posterior's
            variance; "consistent": the DDIM family whose marginals match the forward process for every η.
        eta: share of the posterior's standard deviation that is drawn anew at each step; "printed" has 1.
        begin: share of the schedule at which pure noise is taken to be: near its end the data predicted from ε is all
            error, since it is divided by √α, and without fresh noise (η = 0) no later step makes up for it.
        clip: bound on each number of the predicted data, in deviations; 0: none.
    """

    steps: int = 10
    family: Family = "consistent"
    eta: float = 1.0
    begin: float = 1.0
    clip: float = 4.0


def transition(
    x: Tensor, noise: Tensor, k: int, to: int, schedule: NoiseSchedule, sampling: Sampling
) -> tuple[Tensor, float]:
    """Return mean μ and standard deviation of the step from *k* to *to* < *k*.

    With α the cumulative products and β = 1 − α^k / α^to, the variance is Σ = (1 − α^to) / (1 − α^k) β. The
    printed mean is √α^to x̂⁰ + √(1 − α^to) ε; the consistent one has √(1 − α^to − η² Σ) before ε.

    Args:
        x: (…) noisy sample at *k*.
        noise: (…) predicted noise.
        k: step, at least 1.
        to: step to go to.
        schedule: its αs.
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
    """Return samples (B, A, C, L) made from standard normal noise *start*.

    At each step the guide's shift is added to the mean before noise is drawn (Alg. 1).

    Args:
        noise_of: the trained noise prediction with its condition.
        start: (B, A, C, L) noise.
        schedule: what the network was trained with.
        sampling: steps and family.
        generator: random numbers of the steps; on the CPU, so that a seed means the same on every device.
        guide: shifts the mean; None: natural samples.
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
class Foresight:
    """What the network predicts on its way to a sample.

    Attributes:
        clean: (B, A, C, L) the data that it expects.
        noise: (B, A, C, L) the noise it sees, before clipping.
        x: (B, A, C, L) what it was shown, without gradients.
        k: at which step.
        alpha: α of that step.
    """

    clean: Tensor
    noise: Tensor
    x: Tensor
    k: int
    alpha: float


def foresee(
    noise_of: Noise,
    start: Tensor,
    schedule: NoiseSchedule,
    sampling: Sampling,
    generator: torch.Generator,
    done: int,
) -> Foresight:
    """Return what the network predicts after *done* natural steps.

    Gradients reach the last prediction alone: what led to it is taken as it came.

    Args: those of :func:`sample` but *guide*, and *done*, 0 … ``sampling.steps`` − 1.
    """
    x, ladder = start, schedule.ladder(sampling.steps, sampling.begin)
    with torch.no_grad():
        for k, to in pairwise(ladder[: done + 1]):
            x, deviation = transition(x, noise_of(x, k), k, to, schedule, sampling)
            x = x + deviation * draw(x, generator)
    k = ladder[done]
    noise = noise_of(x, k)
    clean, _ = transition(x, noise, k, 0, schedule, sampling)
    return Foresight(clean, noise, x, k, float(schedule.alpha[k]))
