"""Strive's objective (Rempe et al. 2022, Sec. 3.2, doi:10.1109/CVPR52688.2022.01679).

Latents are counted in deviations of the prior, ε = (z − μ) / σ, so that one rate suits them all. The target's
matching term is left out: the decoder takes the surrogate's states for the target's.
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
    """The loss of one scene and its parts, each a number.

    Attributes:
        total: weighted sum.
        adversarial: squared distance to the target, soft over vehicles and time, m².
        vehicles: mean overlap of vehicles that collide.
        target: mean overlap with the target of those who collide with it, less for who attacks.
        road: mean share over the edge of those who leave the road.
        prior: half the squared deviation from the prior, mean over vehicles, less for who attacks.
        start: squared distance from the natural latents, sum over vehicles, less for who attacks.
        share: (A,) how much each is the attacker, δ summed over time; no gradient.
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
    may: Tensor,
    epsilon: tuple[Tensor, Tensor],
    options: StriveOptions,
    edges: RoadEdges | None = None,
) -> Terms:
    """Return the loss of one scene; the target is row 0 and is not differentiated.

    Args:
        rollout: joint futures, (1, A, T).
        batch: the scene.
        moved: (A,) whose latents are searched.
        may: (A,) who of them may attack, one at least.
        epsilon: standardised latents (A, Z), and the natural ones.
        options: the weights.
        edges: of the road around the scene; None: they are worked out.
    """
    adversarial, share = attack(rollout, may)
    now, natural = epsilon
    prior_weight = _mixed(share, options.prior, options.prior_attacker)
    start_weight = _mixed(share, options.start, options.start_attacker)
    prior = (prior_weight * 0.5 * now.square().sum(-1))[moved].mean()
    start = (start_weight * (now - natural).square().sum(-1))[moved].sum()
    dense = halves(rollout, batch.pose)
    vehicles, target = _touching(dense, batch, moved, share)
    road = _mean_of_touching(off_road(dense, batch, edges)[0][moved])
    total = options.adversarial * adversarial + options.vehicles * vehicles + options.target * target
    total = total + options.road * road + prior + start
    return Terms(total, adversarial, vehicles, target, road, prior, start, share)


def attack(rollout: Rollout, may: Tensor) -> tuple[Tensor, Tensor]:
    """Return Σ δ d² and (A,) Σ_t δ; δ: softmin of the distance d to the target over time and who may attack."""
    gap = torch.sqrt((rollout.xy[0] - rollout.xy[0, :1].detach()).square().sum(-1) + 1e-9)  # (A, T)
    allowed = torch.where(may[:, None], 0.0, torch.inf)
    delta = torch.softmax((-gap - allowed).flatten(), dim=0).reshape(gap.shape)
    return (delta * gap.square()).sum(), delta.detach().sum(-1)


def _mixed(share: Tensor, other: float, attacker: float) -> Tensor:
    return (1.0 - share) * other + share * attacker


def _touching(rollout: Rollout, batch: SceneBatch, moved: Tensor, share: Tensor) -> tuple[Tensor, Tensor]:
    """Return the mean overlaps of vehicles with each other, and with the target."""
    overlap = pair_overlap(rollout, batch.size, batch.present)[0]  # (A, A, T)
    agents = len(moved)
    upper = torch.ones(agents, agents, dtype=torch.bool, device=moved.device).triu(1)
    pairs = upper & (moved[:, None] | moved)
    pairs[0] = False
    meets = overlap[0][moved]
    hit = (meets > 0.0).sum().clamp(min=1)
    weighted = ((1.0 - share[moved])[:, None] * meets).sum() / hit
    return _mean_of_touching(overlap[pairs]), weighted


def _mean_of_touching(penalty: Tensor) -> Tensor:
    """Return the mean of what is above zero; 0 where nothing is."""
    return penalty.sum() / (penalty > 0.0).sum().clamp(min=1)
