"""Base class of the baselines: view the scene, search a plan, pass it through licence and safeguard."""

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
    plausible_plan,
    remaining_plan,
    steps_driven,
    view_and_lanes,
)
from advdiff_sumo.traffic.baselines.baseline_networks import FrozenPrior
from advdiff_sumo.traffic.baselines.baseline_options import BaselineOptions
from advdiff_sumo.traffic.baselines.surrogate import Answer, Surrogate, ask, drive_surrogate, make_surrogate
from advdiff_sumo.traffic.diffusion.diffusion_policy import Listener
from advdiff_sumo.traffic.diffusion.guidance import HORIZON_STEPS
from advdiff_sumo.traffic.planning.drawn import Drawn
from advdiff_sumo.traffic.planning.futures import futures_of

if TYPE_CHECKING:
    from advdiff_sumo.maps import RoadMap


@dataclass(frozen=True)
class BaselineMemory:
    """Memory of a baseline from plan to plan.

    Attributes:
        searched: id → result of the previous search for the vehicle.
        natural: id → standardised latent from which that search started.
        attackers: ids of the previous attackers.
        surrogate: memory of the surrogate.
        plan: the previous plan, at its own clock.
        driven: number of its model steps that had been driven at the previous call.
    """

    searched: Mapping[str, FloatArray] = field(default_factory=dict)
    natural: Mapping[str, FloatArray] = field(default_factory=dict)
    attackers: tuple[str, ...] = ()
    surrogate: Any = None
    plan: Tracks | None = None
    driven: int = 0


@dataclass(frozen=True)
class SearchTask:
    """The input of one search.

    Attributes:
        road: the map.
        view: the scene as the networks see it.
        memory: memory after the previous search.
        seed: seed of all random numbers.
    """

    road: RoadMap
    view: View
    memory: BaselineMemory
    seed: int

    def attacked_before(self) -> BoolArray:
        """Return (A,) whether the vehicle attacked in the previous plan."""
        return np.isin(self.view.ids, self.memory.attackers)


@dataclass(frozen=True)
class SearchResult:
    """The result of a search.

    Attributes:
        drawn: the proposed plan.
        memory: memory for the next search, without the plan itself.
        losses: the search's objective after each round.
    """

    drawn: Drawn
    memory: BaselineMemory
    losses: tuple[float, ...]


class BaselinePolicy(ABC):
    """A background policy that searches a new plan every ``replan`` model steps.

    Attributes:
        surrogate: planner that represents the target; None: the traffic model's prediction does.
        listener: called with every proposal, as in ``diffusion``.
    """

    options: BaselineOptions
    prior: FrozenPrior

    def __init__(self, options: BaselineOptions) -> None:
        self.options = options
        self.surrogate: Surrogate | None = make_surrogate(options.surrogate)
        self.listener: Listener | None = None

    @abstractmethod
    def search(self, task: SearchTask) -> SearchResult:
        """Return the plan found for *task*."""

    def start(
        self,
        road: RoadMap,
        scene: Scene,
        log: Tracks | None,  # noqa: ARG002 - the contract
        rng: np.random.Generator,
    ) -> BaselineMemory:
        """Return an empty memory, after the map has made its table of pieces."""
        _ = road.pieces(self.prior.map_view)
        if self.surrogate is None:
            return BaselineMemory()
        surrogate_rng = np.random.default_rng(int(rng.integers(2**62)))
        return BaselineMemory(surrogate=self.surrogate.start(road, scene, surrogate_rng))

    @one_thread()
    def plan(
        self, road: RoadMap, scene: Scene, memory: BaselineMemory, rng: np.random.Generator
    ) -> tuple[JointPlan, BaselineMemory]:
        """Return the futures of all movable vehicles, 6 s at 2 Hz, and the memory for the next plan."""
        remaining = remaining_plan(road, memory.plan, memory.driven, scene, self.options.replan)
        if remaining is not None:
            return JointPlan(remaining), replace(memory, driven=steps_driven(memory.plan, scene))
        view, lanes = view_and_lanes(road, scene, self.prior.map_view)
        seed = int(rng.integers(2**62))
        if not view.moved.any():
            return JointPlan(empty_plan(scene), attack=AttackState("any")), replace(memory, plan=None)
        result = self.search(SearchTask(road, view, memory, seed))
        if self.listener is not None:
            self.listener(view, result.drawn)
        rules = Rules(self.options.licence, self.options.attackers)
        plan = plausible_plan(
            road, view, lanes, result.drawn, (memory.plan, steps_driven(memory.plan, scene)), rules
        )
        state = AttackState("any", plan.attackers)
        memory = replace(result.memory, plan=plan.tracks, driven=0)
        return JointPlan(plan.tracks, attack=state, safeguarded=plan.safeguarded), memory

    def ask(self, task: SearchTask) -> Answer | None:
        """Return the surrogate's present plan; None if the traffic model's prediction represents the target."""
        if self.surrogate is None:
            return None
        return ask(task.road, self.surrogate, task.view, task.memory.surrogate, task.seed)

    def react(self, task: SearchTask, answer: Answer | None, rollout: Rollout) -> Forced | None:
        """Return the surrogate's states if the others drive *rollout*; they begin with *answer*."""
        if self.surrogate is None or answer is None:
            return None
        futures = futures_of(task.view.now, rollout)
        states = drive_surrogate(task.road, self.surrogate, task.view, futures, answer, HORIZON_STEPS)
        return forced_target(states, task.view, rollout.xy.device)


def forced_target(states: FloatArray, view: View, device: torch.device) -> Forced:
    """Return *states* (T, 4) of the target, in the world frame, as states that the decoder must keep."""
    forced = torch.zeros(1, len(view.rows), FUTURE_STEPS, 4, device=device)
    mask = torch.zeros(forced.shape[:3], dtype=torch.bool, device=device)
    local = states - np.array([*view.now.xy_m[0, -1], 0.0, 0.0])
    forced[0, 0, : len(states)] = torch.as_tensor(local, dtype=forced.dtype, device=device)
    mask[0, 0, : len(states)] = True
    return Forced(forced, mask)


def with_target(rollout: Rollout, forced: Forced | None) -> Rollout:
    """Return *rollout* with the states of *forced* for the target."""
    if forced is None:
        return rollout
    steps = rollout.yaw.shape[2]
    states, mask = forced.states[:, :, :steps], forced.mask[:, :, :steps]
    return replace(
        rollout,
        xy=torch.where(mask[..., None], states[..., :2], rollout.xy),
        yaw=torch.where(mask, states[..., 2], rollout.yaw),
        speed=torch.where(mask, states[..., 3], rollout.speed),
    )


def cut(rollout: Rollout, steps: int) -> Rollout:
    """Return the first *steps* instants."""
    return Rollout(*(part[:, :, :steps] for part in parts(rollout)))


def parts(rollout: Rollout) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Return positions, headings, speeds, accelerations and curvatures."""
    return rollout.xy, rollout.yaw, rollout.speed, rollout.accel, rollout.curvature


def halves(rollout: Rollout, pose: Tensor) -> Rollout:
    """Return *rollout* at half steps: its instants and the midpoints before each of them.

    Args:
        rollout: futures (B, A, T).
        pose: (B, A, 4) states now.
    """
    xy = torch.cat((pose[:, :, None, :2], rollout.xy), dim=2)
    yaw = torch.cat((pose[:, :, None, 2], rollout.yaw), dim=2)
    centre = 0.5 * (xy[:, :, 1:] + xy[:, :, :-1])
    heading = yaw[:, :, :-1] + 0.5 * _turn(yaw)
    all_xy = torch.stack((centre, rollout.xy), dim=3).flatten(2, 3)
    all_yaw = torch.stack((heading, rollout.yaw), dim=3).flatten(2, 3)
    repeated = (
        part.repeat_interleave(2, dim=2) for part in (rollout.speed, rollout.accel, rollout.curvature)
    )
    return Rollout(all_xy, all_yaw, *repeated)


def _turn(yaw: Tensor) -> Tensor:
    change = torch.diff(yaw, dim=2)
    return torch.atan2(torch.sin(change), torch.cos(change))
