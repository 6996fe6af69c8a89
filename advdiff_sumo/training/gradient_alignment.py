"""Gradient alignment: trains the direction of Q's gradient, which guides, to lead attackers to the target.

The single reward of an experience says little about which of several hundred latents matter. So the direction of
∂Q/∂aᵢ, for each vehicle near the target, is compared with that of −∂cᵢ/∂aᵢ through the decoder, while the target moves
as recorded. c is the loss of ``diffusion.attack`` of kind "any": the least gap in the next seconds, overlap with others
and the road edge, and the latent's likelihood under the prior. Only the direction is trained (gradients as labels:
Sobolev training, Czarnecki et al. 2017, arXiv:1706.04859), as guidance uses nothing else of the gradient.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from advdiff_sumo.diffusion.attack import OTHERS_WEIGHT, PRIOR_WEIGHT, ROAD_WEIGHT, prior_distance
from advdiff_sumo.diffusion.attack_costs import smooth_minimum
from advdiff_sumo.diffusion.guides import direction
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.training.adversarial_reward import among_background, background, over_edge, target_gap
from advdiff_sumo.training.experience import Experience, decoded
from advdiff_sumo.training.presets import RewardOptions

_FAR_M = 20.0
_FLAT = 1e-3
_PUSHED, _TURNS, _MOST_PUSHED = 0.8, 3, 3


@dataclass(frozen=True)
class Agreement:
    """Agreement of Q's gradient with the direction that leads to contact.

    Attributes:
        cosine: (B, A) between ∂Q/∂aᵢ and that direction; 0 for vehicles that do not count.
        counts: (B, A) vehicles that come near a target with known motion, and have such a direction.
    """

    cosine: Tensor
    counts: Tensor


def direction_loss(
    bundle: Bundle, experience: Experience, options: RewardOptions, generator: torch.Generator
) -> Tensor:
    """Return 1 − cos averaged over the vehicles that count; 1 if there is none."""
    agreement = agreement_of(bundle, experience, options, generator)
    return 1.0 - agreement.cosine.sum() / agreement.counts.sum().clamp(min=1)


def agreement_of(
    bundle: Bundle, experience: Experience, options: RewardOptions, generator: torch.Generator
) -> Agreement:
    """Return the agreement at the actions of *experience*, some of them shifted along Q's gradient, as in guidance.

    Args:
        bundle: the networks; only the reward model gets gradients.
        experience: experiences; the target moves as in the future of their states.
        options: horizon, and length of the shifts.
        generator: of the shifts.
    """
    with torch.no_grad():
        context = bundle.traffic.encoder(experience.state)
    experience = replace(experience, action=_pushed(bundle, experience, context, options.push, generator))
    with torch.enable_grad():
        action = experience.action.detach().requires_grad_(True)
        cost, near = _cost(bundle, replace(experience, action=action), context, options.look)
        descent = -torch.autograd.grad(cost.sum(), action)[0].nan_to_num()
        q = bundle.reward(context.h, context.prior.mean, action, experience.state, experience.target)
        slope = torch.autograd.grad(q.sum(), action, create_graph=True)[0]
    size = descent.norm(dim=-1)
    row = torch.arange(len(experience.target), device=size.device)
    known = experience.state.future_valid[row, experience.target, : options.look].all(-1) & (
        experience.weight > 0.0
    )
    counts = near & (size > _FLAT) & known[:, None]
    cosine = (slope * descent).sum(-1) / (slope.norm(dim=-1) * size).clamp(min=1e-12)
    return Agreement(torch.where(counts, cosine, 0.0), counts)


def approach(path: Rollout, batch: SceneBatch, target: Tensor) -> tuple[Tensor, Tensor]:
    """Return the attackers' loss without the prior's term (B,), and which vehicles come near enough to count (B, A)."""
    gap = target_gap(path, batch, target)
    least = smooth_minimum(gap)
    near = background(batch, target) & (least.detach() < _FAR_M)
    cost = torch.where(near, least, 0.0).sum(1)
    cost = cost + OTHERS_WEIGHT * among_background(path, batch, target).sum(-1)
    return cost + ROAD_WEIGHT * over_edge(path, batch, target).sum(-1), near


def _cost(bundle: Bundle, experience: Experience, context: Context, steps: int) -> tuple[Tensor, Tensor]:
    path = decoded(bundle, experience.action, context, experience.state, experience.target, steps)
    cost, near = approach(path, experience.state, experience.target)
    unlikely = prior_distance(context.prior, bundle.codec.unscale(experience.action[:, :, None])[:, :, 0])
    return cost + PRIOR_WEIGHT * torch.where(near, unlikely, 0.0).sum(1), near


def _pushed(
    bundle: Bundle, experience: Experience, context: Context, most: float, generator: torch.Generator
) -> Tensor:
    """Return actions (B, A, Z), in 80 % of the scenes with up to three vehicles shifted along Q's gradient."""
    mask = _chosen(experience.state, experience.target, generator).to(experience.action.dtype)
    device = experience.action.device
    share = torch.rand((len(mask), 1, 1), generator=generator)
    is_shifted = torch.rand((len(mask), 1, 1), generator=generator) < _PUSHED
    length = (most / _TURNS * share * is_shifted).to(device)
    state = bundle.reward.prepare(context.h, context.prior.mean, experience.state, experience.target)
    shifted = experience.action
    for _ in range(_TURNS):
        shifted = shifted + length * direction(lambda a: bundle.reward.value_of(state, a), shifted, mask)
    return shifted.detach()


def _chosen(batch: SceneBatch, target: Tensor, generator: torch.Generator) -> Tensor:
    """Return (B, A) one to three random vehicles that can attack; nearer ones are more likely."""
    row = torch.arange(batch.scenes, device=target.device)
    away = (batch.pose[..., :2] - batch.pose[row, target][:, None, :2]).norm(dim=-1)
    away = away * (1.0 + 0.5 * torch.rand(away.shape, generator=generator).to(away))
    away = torch.where(background(batch, target), away, torch.inf)
    count = torch.randint(1, _MOST_PUSHED + 1, (batch.scenes, 1), generator=generator).to(target.device)
    return (away.argsort(dim=1).argsort(dim=1) < count) & torch.isfinite(away)
