"""The background policy ``advsim``: a black-box search over the attackers' action sequences.

After Wang, Pun, Tu, Manivasagam, Sadat, Casas, Ren and Urtasun (2021), "AdvSim: Generating Safety-Critical
Scenarios for Self-Driving Vehicles", doi:10.1109/CVPR46437.2021.00978. Ours differs from the paper: it runs in
closed loop; each search starts from the previous result; SimNet's actions are the initial ones (Xie et al. 2024,
Sec. IV-C); CMA-ES replaces the paper's black-box methods; other vehicles do not evade within the search; planners get
states; plans pass the safeguard. Every ``refresh`` rounds the surrogate reacts to the best candidate, which is kept
only if it is better than the best one so far.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, TypeAlias

import cmaes
import numpy as np
import torch
from torch import Tensor

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import WeightsError
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.model_options import FUTURE_STEPS, ModelOptions
from advdiff_sumo.models.shipped_weights import find_weights
from advdiff_sumo.models.simnet import load_simnet
from advdiff_sumo.traffic.background_plan import steps_driven
from advdiff_sumo.traffic.baselines.advsim_actions import Initial, drive, initial_of
from advdiff_sumo.traffic.baselines.advsim_cost import (
    Ground,
    attack_cost,
    discomfort,
    ground_of,
    keeps_constraints,
    search_cost,
    violation,
)
from advdiff_sumo.traffic.baselines.baseline_networks import prior_of
from advdiff_sumo.traffic.baselines.baseline_options import AdvSimOptions
from advdiff_sumo.traffic.baselines.baseline_policy import (
    BaselinePolicy,
    SearchResult,
    SearchTask,
    cut,
    parts,
    with_target,
)
from advdiff_sumo.traffic.baselines.surrogate import Answer
from advdiff_sumo.traffic.diffusion.guidance import HORIZON_STEPS
from advdiff_sumo.traffic.planning.attackers import can_attack, choose
from advdiff_sumo.traffic.planning.drawn import Drawn
from advdiff_sumo.traffic.planning.futures import futures_of

Driver: TypeAlias = Callable[[SceneBatch], Rollout]
"""Function that returns the initial futures of all road users."""


@dataclass(frozen=True)
class _Case:
    """One search.

    Attributes:
        task: the search task.
        batch: the scene.
        rollout: initial futures (1, A, T) of all road users.
        rows: (R,) rows of the attackers.
        initial: their initial actions.
        answer: present plan of the surrogate.
    """

    task: SearchTask
    batch: SceneBatch
    rollout: Rollout
    rows: Tensor
    initial: Initial
    answer: Answer | None


@dataclass(frozen=True)
class _Best:
    """The best changes so far, judged with the target's reaction to them.

    Attributes:
        changes: (R, H, 2) changes of the attackers' actions.
        cost: distance to the reacting target, less its weighted discomfort; lower is better.
        ground: motions of the other road users with that reaction.
        is_valid: whether the constraints are kept.
    """

    changes: Tensor
    cost: float
    ground: Ground
    is_valid: bool


class AdvSim(BaselinePolicy):
    """Moves the background by SimNet and attackers by searched actions; options are :class:`AdvSimOptions`.

    Attributes:
        options: the checked options.
        driver: returns the initial futures of all road users.
    """

    Options: ClassVar[type[AdvSimOptions]] = AdvSimOptions
    options: AdvSimOptions

    def __init__(self, **options: Any) -> None:
        """Check the options and read the networks.

        Raises:
            ConfigError: an option has no such name or value.
            WeightsError: the networks are missing or unusable.
        """
        super().__init__(AdvSimOptions.parse(options, "options of background 'advsim'"))
        self.prior = prior_of(self.options, "background 'advsim'")
        self.model: ModelOptions = self.prior.traffic.options
        self.driver: Driver = self._simnet() if self.options.initial == "simnet" else self._decoder

    def search(self, task: SearchTask) -> SearchResult:
        """Return the initial futures with the attackers' actions replaced by those found."""
        batch = task.view.batch.to(self.prior.device)
        with torch.no_grad():
            rollout = self.driver(batch)
            case = self._case(task, batch, rollout) if self.options.rounds else None
            if case is None:
                return self._natural(task, batch, rollout)
            best, losses = self._search_rounds(case)
            planned = self._with_changes(case, best.changes)
        return self._result(case, planned, best, losses)

    def _case(self, task: SearchTask, batch: SceneBatch, rollout: Rollout) -> _Case | None:
        """Return the search for the chosen attackers; None if no vehicle can attack."""
        futures = futures_of(task.view.now, rollout)
        candidates = can_attack(futures, task.view.moved, self.options.licence)
        rows = choose(futures, candidates, "any", self.options.attackers, task.attacked_before())
        if not len(rows):
            return None
        attackers = torch.from_numpy(rows).to(self.prior.device)
        return _Case(task, batch, rollout, attackers, initial_of(rollout, batch, attackers), self.ask(task))

    def _search_rounds(self, case: _Case) -> tuple[_Best, tuple[float, ...]]:
        """Search in blocks of rounds; after each the surrogate reacts, and the best changes so far are kept."""
        zero = torch.zeros(len(case.rows), HORIZON_STEPS, 2, device=case.rows.device)
        best = self._judge(case, zero)
        mean = self._previous_changes(case)
        if mean.any():
            best = self._better(best, self._judge(case, mean, best.ground.allowed))
        optimiser = self._optimiser(case, mean)
        ground, losses, done = best.ground, list[float](), 0
        while done < self.options.rounds:
            block = min(self.options.refresh, self.options.rounds - done)
            block_best, costs = self._search_block(case, optimiser, ground, block)
            losses += costs
            done += block
            judged = self._judge(case, block_best, best.ground.allowed)
            ground = judged.ground
            best = self._better(best, judged)
        return best, tuple(losses)

    def _search_block(
        self, case: _Case, optimiser: Any, ground: Ground, rounds: int
    ) -> tuple[Tensor, list[float]]:
        """Return the best changes of *rounds* against *ground*, and the lowest cost so far after each round."""
        shape = (len(case.rows), HORIZON_STEPS, 2)
        lowest, best, costs = np.inf, torch.zeros(shape), list[float]()
        for _ in range(rounds):
            candidates = np.stack([optimiser.ask() for _ in range(optimiser.population_size)])
            changes = torch.from_numpy(candidates.reshape(-1, *shape)).to(case.rollout.xy)
            with torch.inference_mode():
                cost = search_cost(
                    self._attacker_futures(case, changes), ground, changes, self.options.effort
                )
            values = cost.cpu().numpy().astype(np.float64)
            optimiser.tell(list(zip(candidates, values.tolist(), strict=True)))
            first = int(values.argmin())
            if values[first] < lowest:
                lowest, best = float(values[first]), changes[first]
            costs.append(lowest)
        return best.to(case.rollout.xy), costs

    def _judge(self, case: _Case, changes: Tensor, allowed: float | None = None) -> _Best:
        """Return *changes* (R, H, 2) with their cost if the surrogate reacts to them.

        Args:
            case: the search.
            changes: changes to judge.
            allowed: violation of the constraints by the initial actions; None: *changes* are those.
        """
        planned = self._with_changes(case, changes, HORIZON_STEPS)
        forced = self.react(case.task, case.answer, planned)
        reacted = with_target(planned, forced)
        ground = ground_of(reacted, case.batch, case.rows, HORIZON_STEPS)
        attackers = Rollout(*(part[:, case.rows] for part in parts(planned)))
        violated = float(violation(attackers, ground))
        ground = replace(ground, allowed=violated if allowed is None else allowed)
        states = torch.cat((case.batch.pose[0, :1], reacted.states()[0, 0, :HORIZON_STEPS]))
        cost = float(attack_cost(attackers, ground)) - self.options.comfort * discomfort(states)
        return _Best(changes, cost, ground, keeps_constraints(violated, ground))

    def _better(self, best: _Best, other: _Best) -> _Best:
        return other if other.is_valid and other.cost < best.cost else best

    def _optimiser(self, case: _Case, mean: Tensor) -> Any:
        size = mean.numel()
        return cmaes.CMA(
            mean=mean.cpu().numpy().astype(np.float64).ravel(),
            sigma=self.options.spread,
            bounds=np.tile([-1.0, 1.0], (size, 1)),
            seed=case.task.seed % 2**32,
            population_size=self.options.candidates,
        )

    def _previous_changes(self, case: _Case) -> Tensor:
        """Return the changes (R, H, 2) found for the previous plan, shifted by the steps driven since."""
        steps = min(steps_driven(case.task.memory.plan, case.task.view.scene), HORIZON_STEPS)
        changes = np.zeros((len(case.rows), HORIZON_STEPS, 2))
        for attacker, row in enumerate(case.rows.tolist()):
            previous = case.task.memory.searched.get(case.task.view.ids[row])
            if previous is not None:
                changes[attacker, : HORIZON_STEPS - steps] = previous.reshape(HORIZON_STEPS, 2)[steps:]
        return torch.from_numpy(changes).to(case.rollout.xy)

    def _with_changes(self, case: _Case, changes: Tensor, steps: int = FUTURE_STEPS) -> Rollout:
        """Return all futures (1, A, T) with the attackers' *changes* (R, H, 2); T is at most *steps*."""
        attackers = drive(changes[None], case.initial, self.options, self.model, steps)
        pairs = zip(parts(cut(case.rollout, steps)), parts(attackers), strict=True)
        return Rollout(*(initial.index_copy(1, case.rows, changed) for initial, changed in pairs))

    def _attacker_futures(self, case: _Case, changes: Tensor) -> Rollout:
        """Return the attackers' futures (P, R, H) under *changes* (P, R, H, 2)."""
        return drive(changes, case.initial, self.options, self.model, HORIZON_STEPS)

    def _natural(self, task: SearchTask, batch: SceneBatch, rollout: Rollout) -> SearchResult:
        memory = replace(task.memory, searched={}, attackers=())
        return SearchResult(Drawn(rollout, {}, (), self._latents(batch)), memory, ())

    def _result(
        self, case: _Case, best_plan: Rollout, best: _Best, losses: tuple[float, ...]
    ) -> SearchResult:
        names = tuple(case.task.view.ids[row] for row in case.rows.tolist())
        changes: list[FloatArray] = [x.cpu().numpy().astype(np.float64).ravel() for x in best.changes]
        memory = replace(
            case.task.memory,
            searched=dict(zip(names, changes, strict=True)),
            attackers=names,
            surrogate=case.task.memory.surrogate if case.answer is None else case.answer.memory,
        )
        return SearchResult(Drawn(best_plan, {}, names, self._latents(case.batch)), memory, losses)

    def _latents(self, batch: SceneBatch) -> Tensor:
        """Return (A, Z) the scaled mean of the prior, for listeners: searched actions have no latents."""
        with torch.no_grad():
            context: Context = self.prior.traffic.encoder(batch)
        return self.prior.codec.scale(context.prior.mean[0][:, None])[:, 0]

    def _simnet(self) -> Driver:
        path = find_weights(self.options.simnet, "simnet")
        simnet = load_simnet(path)
        if simnet.options.map_view != self.prior.map_view:
            raise WeightsError(
                path,
                f"sees the {simnet.options.map_view} view of the map, and the weights of the option weights the "
                f"{self.prior.map_view} one",
                "give weights of the same view, or initial=model",
            )
        return simnet.eval().requires_grad_(False).to(self.prior.device)

    def _decoder(self, batch: SceneBatch) -> Rollout:
        context: Context = self.prior.traffic.encoder(batch)
        rollout: Rollout = self.prior.traffic.decoder(context.prior.mean, context.h, batch)
        return rollout
