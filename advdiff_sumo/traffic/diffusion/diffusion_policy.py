"""The background policy ``diffusion``: encode, sample with guidance, decode, make plausible (Alg. 1)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.plan import AttackState, JointPlan
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.core.threads import one_thread
from advdiff_sumo.models.view import View
from advdiff_sumo.traffic.background_plan import (
    Rules,
    empty_plan,
    plausible_plan,
    remaining_plan,
    steps_driven,
    view_and_lanes,
)
from advdiff_sumo.traffic.diffusion.diffusion_networks import Networks, networks_of
from advdiff_sumo.traffic.diffusion.diffusion_options import DiffusionOptions, Traj2TrajOptions
from advdiff_sumo.traffic.diffusion.draw import draw_plan
from advdiff_sumo.traffic.licence import licence_of
from advdiff_sumo.traffic.manoeuvres.commitments import Commitments
from advdiff_sumo.traffic.manoeuvres.licensed_attack import PAUSE_S, situation_of
from advdiff_sumo.traffic.manoeuvres.schedule import insert_vehicles, update_manoeuvres
from advdiff_sumo.traffic.manoeuvres.staging import Newcomer, plan_with
from advdiff_sumo.traffic.manoeuvres.standing_traffic import with_standing
from advdiff_sumo.traffic.planning.drawn import Drawn

if TYPE_CHECKING:
    from advdiff_sumo.maps import RoadMap

Listener: TypeAlias = Callable[[View, Drawn], None]
"""Function that is called with every view and the proposal drawn for it."""


@dataclass(frozen=True)
class DiffusionMemory:
    """Memory of the policy from plan to plan.

    Attributes:
        noise: id → starting noise (Z,) of the vehicle.
        shifts: id of a vehicle guided in the previous plan → shift (Z,) of its latent.
        plan: the previous plan, at its own clock.
        driven: number of its model steps that had been driven at the previous call.
        commitments: manoeuvres under way; None under a licence without manoeuvres.
    """

    noise: Mapping[str, FloatArray] = field(default_factory=dict)
    shifts: Mapping[str, FloatArray] = field(default_factory=dict)
    plan: Tracks | None = None
    driven: int = 0
    commitments: Commitments | None = None


class DiffusionTraffic:
    """Moves the background by guided latent diffusion; options are those of :class:`DiffusionOptions`.

    Vehicles that reach the end of the road are left to SUMO, which removes them from the net.

    Attributes:
        options: the checked options.
        networks: the trained networks.
        listener: called with every proposal; for warm-up and for measurements.
    """

    Options: ClassVar[type[DiffusionOptions]] = DiffusionOptions
    name: ClassVar[str] = "diffusion"
    _has_planned: ClassVar[bool] = False

    def __init__(self, **options: Any) -> None:
        """Check the options and read the networks.

        Raises:
            ConfigError: an option has no such name or value.
            WeightsError: the networks are missing or unusable.
        """
        self.options = self.Options.parse(options, f"options of background '{self.name}'")
        self.preference = self.options.preference
        self.networks: Networks = networks_of(self.options)
        self.listener: Listener | None = None

    def start(
        self,
        road: RoadMap,
        scene: Scene,
        log: Tracks | None,  # noqa: ARG002 - the contract
        rng: np.random.Generator,
    ) -> DiffusionMemory:
        """Return an empty memory, after what is set up once: the map pieces, and the networks' first plan."""
        _ = road.pieces(self.networks.bundle.options.model.map_view)
        memory = DiffusionMemory()
        if self.options.licence != "reckless" and self.options.guided:
            options, preference = self.options, self.preference
            memory = DiffusionMemory(
                commitments=Commitments.start(
                    options.manoeuvre, rng, options.staged, options.intensity, preference
                )
            )
        if not self._has_planned:
            self._discard_first_plan(road, scene, memory)
        return memory

    def _discard_first_plan(self, road: RoadMap, scene: Scene, memory: DiffusionMemory) -> None:
        """Make one plan per process and discard it, so that set-up time counts in no plan."""
        DiffusionTraffic._has_planned = True
        listener, self.listener = self.listener, None
        self.plan(road, scene, memory, np.random.default_rng(0))
        self.listener = listener

    @one_thread()
    def plan(
        self, road: RoadMap, scene: Scene, memory: DiffusionMemory, rng: np.random.Generator
    ) -> tuple[JointPlan, DiffusionMemory]:
        """Return the futures of all movable vehicles, 6 s at 2 Hz, and the memory for the next plan."""
        remaining = remaining_plan(road, memory.plan, memory.driven, scene, self.options.replan)
        if remaining is not None:
            plan = _with_standing(JointPlan(remaining), memory.commitments, scene)
            return plan, replace(memory, driven=steps_driven(memory.plan, scene))
        return self._new_plan(road, scene, memory, rng)

    def _new_plan(
        self, road: RoadMap, scene: Scene, memory: DiffusionMemory, rng: np.random.Generator
    ) -> tuple[JointPlan, DiffusionMemory]:
        view, lanes = view_and_lanes(road, scene, self.networks.bundle.options.model.map_view)
        seed = int(rng.integers(2**62))
        if not view.moved.any():
            return self._plan_newcomers(road, view, memory)
        drawn = draw_plan(self.networks, self.options, view, memory.noise, memory.shifts, seed)
        if self.listener is not None:
            self.listener(view, drawn)
        rules = Rules(self.options.licence, self.options.attackers, memory.commitments)
        plan = plausible_plan(
            road, view, lanes, drawn, (memory.plan, steps_driven(memory.plan, scene)), rules
        )
        attack = plan.attack
        state = self._state(plan.attackers, attack.commitments)
        memory = DiffusionMemory(drawn.noise, drawn.shifts, plan.tracks, 0, attack.commitments)
        joint = _with_standing(plan_with(plan.tracks, attack.newcomers, state), attack.commitments, scene)
        return replace(joint, safeguarded=plan.safeguarded), memory

    def _state(self, guided: Sequence[str], commitments: Commitments | None) -> AttackState | None:
        """Return which vehicles are in a position for the attack: guided ones, and those in a manoeuvre of its kind."""
        if not self.options.guided:
            return None
        attack, term = self.options.attack, self.options.attack_term
        guided_to_attack = (
            guided if attack == "any" or term != "any" else ()
        )  # else the guide has no such term
        in_manoeuvre = () if commitments is None else commitments.attacking
        manoeuvres = {} if commitments is None else commitments.manoeuvres
        manoeuvre_of = {**dict.fromkeys(guided, "guided"), **manoeuvres}
        return AttackState(attack, tuple(dict.fromkeys((*guided_to_attack, *in_manoeuvre))), manoeuvre_of)

    def _plan_newcomers(
        self, road: RoadMap, view: View, memory: DiffusionMemory
    ) -> tuple[JointPlan, DiffusionMemory]:
        """Return a plan for a scene without moved vehicles, of newly inserted vehicles alone, if there are any."""
        commitments, newcomers = memory.commitments, tuple[Newcomer, ...]()
        if commitments is not None:
            situation, licence = situation_of(road, view, commitments), licence_of(self.options.licence)
            _, commitments = update_manoeuvres(
                situation, commitments, self.options.attackers, PAUSE_S, licence
            )
            newcomers, commitments = insert_vehicles(situation, commitments)
        plan = plan_with(empty_plan(view.scene), newcomers, self._state((), None))
        plan = _with_standing(plan, commitments, view.scene)
        return plan, replace(memory, plan=None, commitments=commitments)


def _with_standing(plan: JointPlan, commitments: Commitments | None, scene: Scene) -> JointPlan:
    """Return *plan* with the vehicles that stand still for an encounter."""
    return plan if commitments is None else with_standing(plan, commitments.standing, scene.time_s)


class Traj2Traj(DiffusionTraffic):
    """The paper's ablation in closed loop: trajectories are diffused, without decoder, bicycle model or guide."""

    Options: ClassVar[type[DiffusionOptions]] = Traj2TrajOptions
    name: ClassVar[str] = "traj2traj"
