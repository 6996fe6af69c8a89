"""Strive's objective (Rempe et al. 2022, Sec. 3.2, doi:10.1109/CVPR52688.2022.01679).

Latents are in standard deviations of the prior, ε = (z − μ) / σ, so that one rate suits all of them. The matching
term of the target is left out, as the surrogate's states are forced on the decoder.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.losses import off_road, pair_overlap
from advdiff_sumo.models.road_edges import RoadEdges
from advdiff_sumo.traffic.baselines.baseline_options import StriveOptions
from advdiff_sumo.traffic.baselines.baseline_policy import halves


@dataclass(frozen=True)
class Terms:
    """The loss of one scene and its terms, each a scalar.

    Attributes:
        total: weighted sum.
        adversarial: squared distance to the target, soft-minimised over vehicles and time, m².
        vehicles: mean overlap of vehicles that collide with each other.
        target: mean overlap of vehicles that collide with the target, weighted less for attackers.
        road: mean share over the edge of vehicles that leave the road.
        prior: half the squared deviation from the prior, mean over vehicles, weighted less for attackers.
        start: squared distance from the natural latents, sum over vehicles, weighted less for attackers.
        share: (A,) share of each vehicle in the attack, δ summed over time; no gradient.
    """

    total: Tensor
    adversarial: Tensor
    vehicles: Tensor
    target: Tensor
    road: Tensor
    prior: Tensor
    start: Tensor
    share: Tensor


def strive_loss(
    rollout: Rollout,
    batch: SceneBatch,
    moved: Tensor,
    may_attack: Tensor,
    epsilon: tuple[Tensor, Tensor],
    options: StriveOptions,
    edges: RoadEdges | None = None,
) -> Terms:
    """Return the loss of one scene; the target is row 0 and is not differentiated.

    Args:
        rollout: joint futures, (1, A, T).
        batch: the scene.
        moved: (A,) whether the vehicle's latent is searched.
        may_attack: (A,) whether the vehicle may attack; at least one may.
        epsilon: standardised latents (A, Z), and the natural ones (A, Z).
        options: the weights.
        edges: edges of the road around the scene; None: derived from the scene.
    """
    adversarial, share = adversarial_term(rollout, may_attack)
    searched, natural = epsilon
    prior_weight = _mixed(share, options.prior, options.prior_attacker)
    start_weight = _mixed(share, options.start, options.start_attacker)
    prior = (prior_weight * 0.5 * searched.square().sum(-1))[moved].mean()
    start = (start_weight * (searched - natural).square().sum(-1))[moved].sum()
    dense = halves(rollout, batch.pose)
    vehicles, target = _collisions(dense, batch, moved, share)
    road = _mean_of_positive(off_road(dense, batch, edges)[0][moved])
    total = options.adversarial * adversarial + options.vehicles * vehicles + options.target * target
    total = total + options.road * road + prior + start
    return Terms(total, adversarial, vehicles, target, road, prior, start, share)


def adversarial_term(rollout: Rollout, may_attack: Tensor) -> tuple[Tensor, Tensor]:
    """Return Σ δ d² and (A,) Σ_t δ; δ: softmin of the distance d to the target over time and possible attackers."""
    gap = torch.sqrt((rollout.xy[0] - rollout.xy[0, :1].detach()).square().sum(-1) + 1e-9)  # (A, T)
    excluded = torch.where(may_attack[:, None], 0.0, torch.inf)
    delta = torch.softmax((-gap - excluded).flatten(), dim=0).reshape(gap.shape)
    return (delta * gap.square()).sum(), delta.detach().sum(-1)


def _mixed(share: Tensor, non_attacker: float, attacker: float) -> Tensor:
    return (1.0 - share) * non_attacker + share * attacker


def _collisions(rollout: Rollout, batch: SceneBatch, moved: Tensor, share: Tensor) -> tuple[Tensor, Tensor]:
    """Return the mean overlaps of vehicles with each other, and of non-attackers with the target."""
    overlap = pair_overlap(rollout, batch.size, batch.present)[0]  # (A, A, T)
    agents = len(moved)
    upper = torch.ones(agents, agents, dtype=torch.bool, device=moved.device).triu(1)
    pairs = upper & (moved[:, None] | moved)
    pairs[0] = False
    with_target = overlap[0][moved]
    count = (with_target > 0.0).sum().clamp(min=1)
    weighted = ((1.0 - share[moved])[:, None] * with_target).sum() / count
    return _mean_of_positive(overlap[pairs]), weighted


def _mean_of_positive(penalty: Tensor) -> Tensor:
    """Return the mean of the positive values; 0 if there are none."""
    return penalty.sum() / (penalty > 0.0).sum().clamp(min=1)
