"""The background policy ``strive``: a search over the latents of a traffic prior.

After Rempe, Philion, Guibas, Fidler and Litany (2022), "Generating Useful Accident-Prone Driving Scenarios via a
Learned Traffic Prior", doi:10.1109/CVPR52688.2022.01679. Ours differs from the paper:

- It runs in closed loop, and each search starts from the previous result. It takes 20 rounds, as in AdvDiffuser (Xie
  et al. 2024, Sec. IV-C), not 200, and hence a rate of 0.4, not 0.05.
- The surrogate's states over 4 s, renewed every ``refresh`` rounds, are forced on the decoder; the target's latent is
  not matched to the planner.
- The loss covers 4 s and uses this project's prior. The licence limits who may attack; plans pass the safeguard.

The weights of the loss are those of the paper's code.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.diffusion.adam import Adam
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Forced, Rollout
from advdiff_sumo.models.model_options import FUTURE_STEPS
from advdiff_sumo.models.road_edges import RoadEdges
from advdiff_sumo.traffic.baselines.baseline_networks import FrozenPrior, prior_of
from advdiff_sumo.traffic.baselines.baseline_options import StriveOptions
from advdiff_sumo.traffic.baselines.baseline_policy import (
    BaselinePolicy,
    SearchResult,
    SearchTask,
)
from advdiff_sumo.traffic.baselines.strive_loss import Terms, strive_loss
from advdiff_sumo.traffic.diffusion.guidance import HORIZON_STEPS
from advdiff_sumo.traffic.planning.attackers import FARTHEST_M, can_attack, closest_m
from advdiff_sumo.traffic.planning.drawn import Drawn
from advdiff_sumo.traffic.planning.futures import futures_of


@dataclass(frozen=True)
class _Start:
    """The starting point of a search.

    Attributes:
        batch: the scene.
        context: its embeddings and prior.
        edges: edges of the road around it.
        moved: (A,) whether the vehicle's latent is searched.
        may_attack: (A,) whether the vehicle may attack.
        natural: (A, Z) standardised latents without an attack.
        warm_start: (A, Z) the same plus the result of the previous search.
    """

    batch: SceneBatch
    context: Context
    edges: RoadEdges
    moved: Tensor
    may_attack: Tensor
    natural: Tensor
    warm_start: Tensor


@dataclass(frozen=True)
class _Result:
    """The result of a search.

    Attributes:
        epsilon: (A, Z) standardised latents.
        forced: the surrogate's latest states.
        surrogate: its memory.
        losses: loss of every round, before its step.
        share: (A,) share of each vehicle in the attack.
    """

    epsilon: Tensor
    forced: Forced | None
    surrogate: Any
    losses: tuple[float, ...]
    share: FloatArray


class Strive(BaselinePolicy):
    """Moves the background by optimised latents; options are those of :class:`StriveOptions`.

    Attributes:
        options: the checked options.
        prior: the traffic model.
        decoder: its decoder, equal up to rounding on every device.
    """

    Options: ClassVar[type[StriveOptions]] = StriveOptions
    options: StriveOptions

    def __init__(self, **options: Any) -> None:
        """Check the options and read the networks.

        Raises:
            ConfigError: an option has no such name or value.
            WeightsError: the networks are missing or unusable.
        """
        super().__init__(StriveOptions.parse(options, "options of background 'strive'"))
        self.prior: FrozenPrior = prior_of(self.options, "background 'strive'")
        self.decoder = FastDecoder(self.prior.traffic.decoder)

    def search(self, task: SearchTask) -> SearchResult:
        """Return the futures of the latents after all rounds of the search."""
        start = self._start(task)
        if self.options.rounds:
            result = self._search_rounds(task, start)
        else:
            result = _natural_result(start, task.memory.surrogate)
        with torch.no_grad():
            rollout = self._decode(start, result.epsilon, result.forced)
        attackers = self._attackers(task, start, rollout, result.share)
        latents = self._latents(start, result.epsilon)
        scaled = self.prior.codec.scale(latents[:, None])[:, 0]
        drawn = Drawn(rollout, _by_name(task, start.natural), attackers, scaled)
        memory = replace(
            task.memory,
            searched=_by_name(task, result.epsilon),
            natural=_by_name(task, start.natural),
            attackers=attackers,
            surrogate=result.surrogate,
        )
        return SearchResult(drawn, memory, result.losses)

    def loss(self, start: _Start, epsilon: Tensor, forced: Forced | None) -> Terms:
        """Return the loss of standardised latents *epsilon* (A, Z) if the target drives *forced*."""
        rollout = self._decode(start, epsilon, forced, HORIZON_STEPS)
        latents = epsilon, start.natural
        return strive_loss(
            rollout, start.batch, start.moved, start.may_attack, latents, self.options, start.edges
        )

    def _start(self, task: SearchTask) -> _Start:
        batch = task.view.batch.to(self.prior.device)
        with torch.no_grad():
            context: Context = self.prior.traffic.encoder(batch)
        share, generator = self.options.persistence, torch.Generator().manual_seed(task.seed)
        fresh = torch.randn(context.prior.mean.shape[1:], generator=generator)
        noise = self.options.temperature * fresh
        previous, known = _rows_of_view(task, task.memory.natural, noise)
        mixed = share * previous + (1.0 - share**2) ** 0.5 * noise
        natural = torch.where(known[:, None], mixed, noise).to(self.prior.device)
        searched, known = _rows_of_view(task, task.memory.searched, noise)
        change = torch.where(known[:, None], share * (searched - previous), 0.0).to(self.prior.device)
        moved = torch.from_numpy(task.view.moved).to(self.prior.device)
        start = _Start(batch, context, RoadEdges.of(batch), moved, moved, natural, natural + change)
        return replace(start, may_attack=self._may_attack(task, start).to(moved.device))

    @torch.no_grad()
    def _may_attack(self, task: SearchTask, start: _Start) -> Tensor:
        """Return (A,) which vehicles may attack under the licence, by their natural futures."""
        futures = futures_of(task.view.now, self._decode(start, start.natural, None))
        return torch.from_numpy(can_attack(futures, task.view.moved, self.options.licence))

    def _search_rounds(self, task: SearchTask, start: _Start) -> _Result:
        options, answer = self.options, self.ask(task)
        surrogate = task.memory.surrogate if answer is None else answer.memory
        if not start.may_attack.any():
            return _natural_result(start, surrogate)
        epsilon, adam, forced = start.warm_start, Adam(options.rate), None
        losses, share = [], np.zeros(len(start.moved))
        for number in range(options.rounds):
            if number % options.refresh == 0:
                with torch.no_grad():
                    decoded = self._decode(start, epsilon, forced, HORIZON_STEPS)
                forced = self.react(task, answer, decoded)
            epsilon = epsilon.detach().requires_grad_(True)
            terms = self.loss(start, epsilon, forced)
            (gradient,) = torch.autograd.grad(terms.total, epsilon)
            finite = torch.isfinite(gradient) & start.moved[:, None]
            epsilon = adam.step(epsilon.detach(), torch.where(finite, gradient, 0.0))
            losses.append(float(terms.total.detach()))
            share = terms.share.cpu().numpy().astype(np.float64)
        return _Result(epsilon.detach(), forced, surrogate, tuple(losses), share)

    def _latents(self, start: _Start, epsilon: Tensor) -> Tensor:
        prior = start.context.prior
        return prior.mean[0] + torch.exp(0.5 * prior.logvar[0]) * epsilon

    def _decode(
        self, start: _Start, epsilon: Tensor, forced: Forced | None, steps: int = FUTURE_STEPS
    ) -> Rollout:
        z = self._latents(start, epsilon)[None]
        return self.decoder(z, start.context.h, start.batch, steps, forced)

    def _attackers(
        self, task: SearchTask, start: _Start, rollout: Rollout, share: FloatArray
    ) -> tuple[str, ...]:
        """Return the ids with the largest shares in the attack, among vehicles that may attack and come near enough."""
        near = closest_m(futures_of(task.view.now, rollout)) < FARTHEST_M
        score = np.where(start.may_attack.cpu().numpy() & near, share, 0.0)
        order = np.argsort(-score, kind="stable")[: self.options.attackers]
        return tuple(task.view.ids[row] for row in order.tolist() if score[row] > 0.0)


def _natural_result(start: _Start, surrogate: Any) -> _Result:
    """Return natural traffic, the result without rounds or without a vehicle that may attack."""
    return _Result(start.natural, None, surrogate, (), np.zeros(len(start.moved)))


def _rows_of_view(task: SearchTask, by_name: Mapping[str, FloatArray], like: Tensor) -> tuple[Tensor, Tensor]:
    """Return the values (A, Z) of *by_name* for the agents of the view, 0 where missing, and which are known (A,)."""
    rows, known = torch.zeros_like(like), torch.zeros(len(like), dtype=torch.bool)
    for row, name in enumerate(task.view.ids):
        if name in by_name:
            rows[row], known[row] = torch.from_numpy(by_name[name]).to(like.dtype), True
    return rows, known


def _by_name(task: SearchTask, values: Tensor) -> dict[str, FloatArray]:
    rows = values.detach().cpu().numpy().astype(np.float64)
    return {name: rows[row] for row, name in enumerate(task.view.ids)}
