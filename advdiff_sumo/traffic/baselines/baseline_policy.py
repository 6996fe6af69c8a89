"""What the baselines share: they look, search, and hand their plan to the safeguard of ``diffusion``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.plan import AttackState, JointPlan
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.core.threads import one_thread
from advdiff_sumo.models.decoder import Forced, Rollout
from advdiff_sumo.models.model_options import FUTURE_STEPS
from advdiff_sumo.models.view import View
from advdiff_sumo.traffic.background_plan import (
    Rules,
    empty_plan,
    outlook,
    plausible_plan,
    remaining_plan,
    steps_driven,
)
from advdiff_sumo.traffic.baselines.baseline_networks import FrozenPrior
from advdiff_sumo.traffic.baselines.baseline_options import BaselineOptions
from advdiff_sumo.traffic.baselines.surrogate import Answer, Surrogate, ask, imagine, make_surrogate
from advdiff_sumo.traffic.diffusion.diffusion_policy import Listener
from advdiff_sumo.traffic.diffusion.guidance import HORIZON_STEPS
from advdiff_sumo.traffic.planning.drawn import Drawn
from advdiff_sumo.traffic.planning.futures import futures_of

if TYPE_CHECKING:
    from advdiff_sumo.maps import RoadMap


@dataclass(frozen=True)
class BaselineMemory:
    """What a baseline remembers from plan to plan.

    Attributes:
        searched: id → what the last search found for the vehicle.
        natural: id → the standardised latent that its search started from.
        attackers: ids that attacked last.
        surrogate: memory of the surrogate.
        plan: the last plan, at its own clock.
        driven: model steps of it that had been driven when it was handed out last.
    """

    searched: Mapping[str, FloatArray] = field(default_factory=dict)
    natural: Mapping[str, FloatArray] = field(default_factory=dict)
    attackers: tuple[str, ...] = ()
    surrogate: Any = None
    plan: Tracks | None = None
    driven: int = 0


@dataclass(frozen=True)
class SearchTask:
    """One search.

    Attributes:
        road: the map.
        view: what is seen.
        memory: of the last search.
        seed: of all random numbers.
    """

    road: RoadMap
    view: View
    memory: BaselineMemory
    seed: int

    def before(self) -> BoolArray:
        """Return (A,) who attacked last."""
        return np.isin(self.view.ids, self.memory.attackers)


@dataclass(frozen=True)
class SearchResult:
    """What a search came to.

    Attributes:
        drawn: the plan.
        memory: for the next one, but for the plan itself.
        losses: the search's objective, round by round.
    """

    drawn: Drawn
    memory: BaselineMemory
    losses: tuple[float, ...]


class BaselinePolicy(ABC):
    """A background policy that searches a plan anew every ``replan`` model steps.

    Attributes:
        surrogate: stands for the target; None: the traffic model's prediction does.
        listener: told of every plan before the safeguard, as of ``diffusion``.
    """

    options: BaselineOptions
    prior: FrozenPrior

    def __init__(self, options: BaselineOptions) -> None:
        self.options = options
        self.surrogate: Surrogate | None = make_surrogate(options.surrogate)
        self.listener: Listener | None = None

    @abstractmethod
    def search(self, task: SearchTask) -> SearchResult:
        """Return the plan that was found for the view of *task*."""

    def start(
        self,
        road: RoadMap,
        scene: Scene,
        log: Tracks | None,  # noqa: ARG002 - the contract
        rng: np.random.Generator,
    ) -> BaselineMemory:
        """Return an empty memory, and let the map make its table of pieces."""
        _ = road.pieces(self.prior.map_view)
        if self.surrogate is None:
            return BaselineMemory()
        own = np.random.default_rng(int(rng.integers(2**62)))
        return BaselineMemory(surrogate=self.surrogate.start(road, scene, own))

    @one_thread()
    def plan(
        self, road: RoadMap, scene: Scene, memory: BaselineMemory, rng: np.random.Generator
    ) -> tuple[JointPlan, BaselineMemory]:
        """Return the futures of all movable vehicles, 6 s at 2 Hz, and the memory for the next plan."""
        kept = remaining_plan(road, memory.plan, memory.driven, scene, self.options.replan)
        if kept is not None:
            return JointPlan(kept), replace(memory, driven=steps_driven(memory.plan, scene))
        view, lanes = outlook(road, scene, self.prior.map_view)
        seed = int(rng.integers(2**62))
        if not view.moved.any():
            return JointPlan(empty_plan(scene), attack=AttackState("any")), replace(memory, plan=None)
        proposal = self.search(SearchTask(road, view, memory, seed))
        if self.listener is not None:
            self.listener(view, proposal.drawn)
        rules = Rules(self.options.licence, self.options.attackers)
        plan = plausible_plan(
            road, view, lanes, proposal.drawn, (memory.plan, steps_driven(memory.plan, scene)), rules
        )
        state = AttackState("any", plan.attackers)
        memory = replace(proposal.memory, plan=plan.tracks, driven=0)
        return JointPlan(plan.tracks, attack=state, safeguarded=plan.safeguarded), memory

    def ask(self, task: SearchTask) -> Answer | None:
        """Return what the surrogate does now; None where the traffic model's prediction stands for the target."""
        if self.surrogate is None:
            return None
        return ask(task.road, self.surrogate, task.view, task.memory.surrogate, task.seed)

    def react(self, task: SearchTask, answer: Answer | None, rollout: Rollout) -> Forced | None:
        """Return what the surrogate does, first of all *answer*, while the others drive *rollout*."""
        if self.surrogate is None or answer is None:
            return None
        futures = futures_of(task.view.now, rollout)
        states = imagine(task.road, self.surrogate, task.view, futures, answer, HORIZON_STEPS)
        return forced_target(states, task.view, rollout.xy.device)


def forced_target(states: FloatArray, view: View, device: torch.device) -> Forced:
    """Return *states* (T, 4) of the target, world frame, as what the decoder is to take for granted."""
    given = torch.zeros(1, len(view.rows), FUTURE_STEPS, 4, device=device)
    mask = torch.zeros(given.shape[:3], dtype=torch.bool, device=device)
    local = states - np.array([*view.now.xy_m[0, -1], 0.0, 0.0])
    given[0, 0, : len(states)] = torch.as_tensor(local, dtype=given.dtype, device=device)
    mask[0, 0, : len(states)] = True
    return Forced(given, mask)


def with_target(rollout: Rollout, forced: Forced | None) -> Rollout:
    """Return *rollout* with the target where *forced* puts it."""
    if forced is None:
        return rollout
    steps = rollout.yaw.shape[2]
    given, mask = forced.states[:, :, :steps], forced.mask[:, :, :steps]
    return replace(
        rollout,
        xy=torch.where(mask[..., None], given[..., :2], rollout.xy),
        yaw=torch.where(mask, given[..., 2], rollout.yaw),
        speed=torch.where(mask, given[..., 3], rollout.speed),
    )


def cut(rollout: Rollout, steps: int) -> Rollout:
    """Return the first *steps* instants."""
    return Rollout(*(part[:, :, :steps] for part in parts(rollout)))


def parts(rollout: Rollout) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Return positions, headings, speeds, accelerations and curvatures."""
    return rollout.xy, rollout.yaw, rollout.speed, rollout.accel, rollout.curvature


def halves(rollout: Rollout, pose: Tensor) -> Rollout:
    """Return *rollout* with the middles between its instants, and of now and the first one, put in.

    Args:
        rollout: futures (B, A, T).
        pose: (B, A, 4) states now.
    """
    xy = torch.cat((pose[:, :, None, :2], rollout.xy), dim=2)
    yaw = torch.cat((pose[:, :, None, 2], rollout.yaw), dim=2)
    centre = 0.5 * (xy[:, :, 1:] + xy[:, :, :-1])
    heading = yaw[:, :, :-1] + 0.5 * _turn(yaw)
    twice = torch.stack((centre, rollout.xy), dim=3).flatten(2, 3)
    turned = torch.stack((heading, rollout.yaw), dim=3).flatten(2, 3)
    rest = (part.repeat_interleave(2, dim=2) for part in (rollout.speed, rollout.accel, rollout.curvature))
    return Rollout(twice, turned, *rest)


def _turn(yaw: Tensor) -> Tensor:
    change = torch.diff(yaw, dim=2)
    return torch.atan2(torch.sin(change), torch.cos(change))
