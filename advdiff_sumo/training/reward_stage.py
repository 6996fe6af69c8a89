"""Stage "reward": Q by DQN targets, from logs with random targets and random latents (Sec. III-C, L_Q)."""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.reward import RewardModel
from advdiff_sumo.training.adversarial_reward import payoffs
from advdiff_sumo.training.displacement import masked_sum
from advdiff_sumo.training.experience import (
    Experience,
    decoded,
    from_logs,
    pick_target,
    prior_action,
    random_action,
    value_of,
)
from advdiff_sumo.training.gradient_alignment import agreement_of, direction_loss
from advdiff_sumo.training.presets import RewardOptions
from advdiff_sumo.training.stage import BundleStage, Moment, Tally

_CHOICES = 6


class RewardStage(BundleStage):
    """Trains only Q.

    Args:
        bundle: its reward model is trained in place, the rest is frozen.
        options: discount, weights, sources of random actions.
    """

    name = "reward"
    monitor = "regret"

    def __init__(self, bundle: Bundle, options: RewardOptions) -> None:
        for frozen in (bundle.traffic, bundle.denoiser):
            frozen.eval().requires_grad_(False)
        self._target = copy.deepcopy(bundle.reward).requires_grad_(False)
        super().__init__(bundle, bundle.reward, self._target)
        self.options = options

    def loss(self, batch: SceneBatch, moment: Moment) -> dict[str, Tensor]:
        """Return L_Q over experiences from the windows, with the mean value and the rate of collisions."""
        experiences = list(from_logs(self.bundle, batch, self.options, moment.generator))
        terms = [
            q_loss(self.bundle, self._target, experience, self.options, moment.generator)
            for experience in experiences
        ]
        weight = sum(float(experience.weight.sum()) for experience in experiences)
        loss = torch.stack([term for term, _ in terms]).sum() / max(weight, 1.0)
        value = torch.stack([q for _, q in terms]).sum() / max(weight, 1.0)
        direction = loss.new_zeros(())
        if experiences and self.options.direction > 0.0:
            direction = direction_loss(self.bundle, experiences[0], self.options, moment.generator)
        contact = sum(
            float((experience.weight * (experience.remains == 0.0)).sum()) for experience in experiences
        ) / max(weight, 1.0)
        return {
            "loss": loss + self.options.direction * direction,
            "td": loss,
            "direction": direction,
            "value": value,
            "contact": torch.tensor(contact),
        }

    def evaluate(self, batch: SceneBatch, generator: torch.Generator) -> Tally:
        """Measure how well Q ranks random actions by their rewards when their plans are executed to the end.

        "regret": reward of the best action minus that of the action with the highest Q; "chance": the same for a
        random action; "td": temporal-difference error; "direction": 1 − cos of its gradient (1: unrelated).
        """
        worth, liked, usable = self._choices(batch, generator)
        best = worth.amax(1)
        chosen = worth.gather(1, liked.argmax(1, keepdim=True)).squeeze(1)
        tally = {
            "regret": masked_sum(best - chosen, usable),
            "chance": masked_sum(best - worth.mean(1), usable),
        }
        experiences = list(from_logs(self.bundle, batch, self.options, generator))
        losses = [
            q_loss(self.bundle, self._target, experience, self.options, generator)[0]
            for experience in experiences
        ]
        weight = sum(float(experience.weight.sum()) for experience in experiences)
        tally |= {"td": (float(torch.stack(losses).sum()), weight)}
        if experiences:
            agreement = agreement_of(self.bundle, experiences[0], self.options, generator)
            tally["direction"] = (
                float((1.0 - agreement.cosine)[agreement.counts].sum()),
                float(agreement.counts.sum()),
            )
        return tally

    def after_step(self) -> None:
        """Update the target network."""
        follow(self._target, self.bundle.reward, self.options.target_decay)

    def _choices(self, batch: SceneBatch, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """Return rewards and Q (B, 6) of random actions, and where (B,) the target's log is long enough."""
        bundle, options = self.bundle, self.options
        stretches = batch.future.shape[2] // options.execute
        target, usable = pick_target(batch, stretches * options.execute, generator)
        context = bundle.traffic.encoder(batch)
        state = bundle.reward.prepare(context.h, context.prior.mean, batch, target)
        worth, liked = [], []
        for _ in range(_CHOICES):
            action = random_action(bundle, context, options, generator)
            path = decoded(bundle, action, context, batch, target)
            worth.append(value_of(payoffs(path, batch, target, options, stretches), options.discount)[0])
            liked.append(bundle.reward.value_of(state, action))
        return torch.stack(worth, dim=1), torch.stack(liked, dim=1), usable


def q_loss(
    bundle: Bundle,
    target_network: RewardModel,
    experience: Experience,
    options: RewardOptions,
    generator: torch.Generator,
) -> tuple[Tensor, Tensor]:
    """Return the summed squared errors of Q against its DQN targets, and the summed Q.

    The target is (1 − γ) Σ γⁱ rᵢ + γⁿ max Q(s', a) with the maximum over candidates a drawn from the prior.
    """
    with torch.no_grad():
        context = bundle.traffic.encoder(experience.state)
        after = bundle.traffic.encoder(experience.after)
        future = best_value(bundle, target_network, experience, after, options.candidates, generator)
        target_value = experience.gain + experience.remains * future
    q = bundle.reward(context.h, context.prior.mean, experience.action, experience.state, experience.target)
    return (experience.weight * (q - target_value).square()).sum(), (experience.weight * q.detach()).sum()


def best_value(
    bundle: Bundle,
    network: RewardModel,
    experience: Experience,
    after: Context,
    candidates: int,
    generator: torch.Generator,
) -> Tensor:
    """Return the maximum (B,) of Q(s', ·) over *candidates* samples of the prior."""
    state = network.prepare(after.h, after.prior.mean, experience.after, experience.target)
    values = [network.value_of(state, prior_action(bundle, after, generator)) for _ in range(candidates)]
    return torch.stack(values).amax(0)


@torch.no_grad()
def follow(target: nn.Module, source: nn.Module, decay: float) -> None:
    """Move the weights of *target* towards those of *source*: decay · target + (1 − decay) · source."""
    for target_weight, source_weight in zip(target.parameters(), source.parameters(), strict=True):
        target_weight.lerp_(source_weight, 1.0 - decay)
