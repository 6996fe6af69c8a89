"""Experiences (s, a, r, s') of Q: from logs with a random target and random latents, or from a run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from advdiff_sumo.diffusion.sampler import Sampling
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Forced, Rollout
from advdiff_sumo.models.model_options import FUTURE_STEPS
from advdiff_sumo.training.adversarial_reward import Payoff, first_steps, payoffs
from advdiff_sumo.training.dataset import join
from advdiff_sumo.training.denoiser_stage import diffused_samples
from advdiff_sumo.training.presets import RewardOptions


@dataclass(frozen=True)
class Experience:
    """B experiences.

    Attributes:
        state: scenes s.
        target: (B,) row of the tested vehicle.
        action: (B, A, Z) scaled latents a.
        gain: (B,) discounted rewards of the executed stretches.
        remains: (B,) factor of Q(s', ·): γⁿ, or 0 after a collision.
        after: scenes s'.
        weight: (B,) 1 if the experience counts, else 0.
    """

    state: SceneBatch
    target: Tensor
    action: Tensor
    gain: Tensor
    remains: Tensor
    after: SceneBatch
    weight: Tensor

    def to(self, device: torch.device | str) -> Experience:
        """Return the experiences on *device*."""
        return Experience(**{f.name: getattr(self, f.name).to(device) for f in fields(self)})


def gathered(parts: Sequence[Experience]) -> Experience:
    """Return several experiences as one, padded to the most agents."""
    agents = max(part.state.agents for part in parts)
    action = [torch.nn.functional.pad(p.action, (0, 0, 0, agents - p.state.agents)) for p in parts]
    flat = {
        f.name: torch.cat([getattr(part, f.name) for part in parts])
        for f in fields(Experience)
        if f.name in ("target", "gain", "remains", "weight")
    }
    state, after = join([part.state for part in parts]), join([part.after for part in parts])
    return Experience(state=state, after=after, action=torch.cat(action), **flat)


def value_of(rewards: Sequence[Payoff], discount: float) -> tuple[Tensor, Tensor]:
    """Return the discounted value (B,) of stretches of rewards, and the factor (B,) of the value after them.

    Values are scaled by 1 − γ, so that a constant reward of 1 has value 1. After a collision, which ends an episode,
    its reward is continued for ever; otherwise staying near would have a higher value than colliding.
    """
    gain = torch.zeros_like(rewards[0].reward)
    factor = torch.ones_like(gain)
    for following in rewards:
        share = torch.where(following.contact, 1.0, 1.0 - discount)
        gain = gain + factor * share * following.reward
        factor = factor * torch.where(following.contact, 0.0, discount)
    return gain, factor


def observed(
    state: SceneBatch, path: Rollout, target: Tensor, action: Tensor, options: RewardOptions
) -> Experience:
    """Return the experience of a plan that has been executed, in a run or in a log.

    Args:
        state: scenes when the plan was made.
        path: (B, A, T) executed states, T = n · ``options.execute`` steps.
        target: (B,) row of the tested vehicle.
        action: (B, A, Z) scaled latents of the plan.
        options: weights, discount.
    """
    steps = path.xy.shape[2]
    rewards = payoffs(path, state, target, options, steps // options.execute)
    gain, remains = value_of(rewards, options.discount)
    after = state.advanced(path.states())
    return Experience(state, target, action, gain, remains, after, torch.ones_like(gain))


def pick_target(batch: SceneBatch, steps: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Return a random target (B,) among vehicles with known next *steps*, and whether there is one (B,)."""
    usable = batch.moved & ~batch.parked & batch.future_valid[:, :, :steps].all(-1)
    weight = usable.float() + 1e-9 * batch.present.float()
    drawn = torch.multinomial(weight.cpu(), 1, generator=generator).squeeze(1).to(batch.past.device)
    return drawn, usable.gather(1, drawn[:, None]).squeeze(1)


def random_action(
    bundle: Bundle, context: Context, options: RewardOptions, generator: torch.Generator
) -> Tensor:
    """Return scaled latents (B, A, Z), for each scene from one source, drawn with the options' shares."""
    shares = torch.tensor([options.prior, options.noise, options.diffusion])
    scenes = context.h.shape[0]
    source = torch.multinomial(shares, scenes, replacement=True, generator=generator)
    action = prior_action(bundle, context, generator)
    noise = torch.randn(action.shape, generator=generator).to(action)
    action = torch.where((source == 1).to(action.device)[:, None, None], noise, action)
    rows = torch.nonzero(source == 2).squeeze(1).to(action.device)
    if len(rows):
        sampling = Sampling(options.sampling_steps)
        action[rows] = diffused_samples(bundle, context.rows(rows), sampling, generator)[:, :, 0]
    return action


def prior_action(bundle: Bundle, context: Context, generator: torch.Generator) -> Tensor:
    """Return scaled latents (B, A, Z) sampled from the prior."""
    return bundle.codec.scale(context.prior.sample(generator)[:, :, None])[:, :, 0]


def decoded(
    bundle: Bundle,
    action: Tensor,
    context: Context,
    batch: SceneBatch,
    target: Tensor,
    steps: int = FUTURE_STEPS,
) -> Rollout:
    """Return decoded scaled latents (B, A, Z), while the target replays its log as far as that is known."""
    rows = torch.arange(batch.agents, device=target.device) == target[:, None]
    forced = Forced(batch.future, rows[..., None] & batch.future_valid)
    z = bundle.codec.unscale(action[:, :, None])[:, :, 0]
    path: Rollout = bundle.traffic.decoder(z, context.h, batch, steps, forced=forced)
    return path


@torch.no_grad()
def from_logs(
    bundle: Bundle, batch: SceneBatch, options: RewardOptions, generator: torch.Generator
) -> Iterator[Experience]:
    """Yield successive experiences in the same scenes, ``options.execute`` steps apart.

    Each covers n = ``options.returns`` stretches of one plan; the next one begins after the first stretch.
    """
    steps = options.execute * options.returns
    target, alive = pick_target(batch, steps, generator)
    row = torch.arange(batch.scenes, device=target.device)
    for number in range(options.transitions):
        if number * options.execute + steps > batch.future.shape[2]:
            return
        alive = alive & batch.future_valid[row, target, :steps].all(-1)
        context = bundle.traffic.encoder(batch)
        action = random_action(bundle, context, options, generator)
        path = decoded(bundle, action, context, batch, target)
        experience = observed(batch, first_steps(path, steps), target, action, options)
        yield replace(experience, weight=alive.to(experience.gain))
        first = payoffs(path, batch, target, options, 1)[0]
        alive = alive & ~first.contact
        batch = batch.advanced(path.states()[:, :, : options.execute])
