"""The background policy ``diffusion``: encode, sample with guidance, decode, keep it plausible (Alg. 1)."""

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
    outlook,
    plausible_plan,
    remaining_plan,
    steps_driven,
)
from advdiff_sumo.traffic.diffusion.diffusion_networks import Networks, networks_of
from advdiff_sumo.traffic.diffusion.diffusion_options import DiffusionOptions, Traj2TrajOptions
from advdiff_sumo.traffic.diffusion.draw import draw_plan
from advdiff_sumo.traffic.licence import licence_of
from advdiff_sumo.traffic.manoeuvres.commitments import Commitments
from advdiff_sumo.traffic.manoeuvres.licensed_attack import PAUSE_S, situation_of
from advdiff_sumo.traffic.manoeuvres.schedule import advance, let_in
from advdiff_sumo.traffic.manoeuvres.staging import Newcomer, plan_with
from advdiff_sumo.traffic.manoeuvres.standing_traffic import with_standing
from advdiff_sumo.traffic.planning.drawn import Drawn

if TYPE_CHECKING:
    from advdiff_sumo.maps import RoadMap

Listener: TypeAlias = Callable[[View, Drawn], None]


@dataclass(frozen=True)
class DiffusionMemory:
    """What a policy remembers from plan to plan.

    Attributes:
        noise: id → starting noise of the vehicle, (Z,).
        shifts: id of who was guided last → what its latent was shifted by, (Z,).
        plan: the last plan, at its own clock.
        driven: model steps of it that had been driven when it was handed out last.
        commitments: manoeuvres under way; None where the licence asks for none.
    """

    noise: Mapping[str, FloatArray] = field(default_factory=dict)
    shifts: Mapping[str, FloatArray] = field(default_factory=dict)
    plan: Tracks | None = None
    driven: int = 0
    commitments: Commitments | None = None


class DiffusionTraffic:
    """Moves the background by guided latent diffusion; options are those of :class:`DiffusionOptions`.

    Vehicles that come to where the road ends are left to SUMO, which takes them off the net.

    Attributes:
        options: checked.
        networks: the trained networks.
        listener: told of every plan that is drawn; for warm-up and for measurements.
    """

    Options: ClassVar[type[DiffusionOptions]] = DiffusionOptions
    name: ClassVar[str] = "diffusion"
    _rehearsed: ClassVar[bool] = False

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
        """Return an empty memory, and let the map make its table of pieces."""
        _ = road.pieces(self.networks.bundle.options.model.map_view)
        memory = DiffusionMemory()
        if self.options.licence != "reckless" and self.options.guided:
            options, preference = self.options, self.preference
            memory = DiffusionMemory(
                commitments=Commitments.start(options.manoeuvre, rng, options.staged, preference=preference)
            )
        if not self._rehearsed:
            self._rehearse(road, scene, memory)
        return memory

    def _rehearse(self, road: RoadMap, scene: Scene, memory: DiffusionMemory) -> None:
        """Make a plan for nothing, once a process: what is set up with the first one is in no plan's time then."""
        DiffusionTraffic._rehearsed = True
        listener, self.listener = self.listener, None
        self.plan(road, scene, memory, np.random.default_rng(0))
        self.listener = listener

    @one_thread()
    def plan(
        self, road: RoadMap, scene: Scene, memory: DiffusionMemory, rng: np.random.Generator
    ) -> tuple[JointPlan, DiffusionMemory]:
        """Return the futures of all movable vehicles, 6 s at 2 Hz, and the memory for the next plan."""
        kept = remaining_plan(road, memory.plan, memory.driven, scene, self.options.replan)
        if kept is not None:
            plan = _with_standing(JointPlan(kept), memory.commitments, scene)
            return plan, replace(memory, driven=steps_driven(memory.plan, scene))
        return self._afresh(road, scene, memory, rng)

    def _afresh(
        self, road: RoadMap, scene: Scene, memory: DiffusionMemory, rng: np.random.Generator
    ) -> tuple[JointPlan, DiffusionMemory]:
        view, lanes = outlook(road, scene, self.networks.bundle.options.model.map_view)
        seed = int(rng.integers(2**62))
        if not view.moved.any():
            return self._alone(road, view, memory)
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
        """Return who is in a position for the attack: who is guided to it, or drives a manoeuvre of its kind."""
        if not self.options.guided:
            return None
        asked, term = self.options.attack, self.options.attack_term
        aimed = guided if asked == "any" or term != "any" else ()  # the guide has no term of this kind
        driving = () if commitments is None else commitments.attacking
        manoeuvres = {} if commitments is None else commitments.manoeuvres
        does = {**dict.fromkeys(guided, "guided"), **manoeuvres}
        return AttackState(asked, tuple(dict.fromkeys((*aimed, *driving))), does)

    def _alone(self, road: RoadMap, view: View, memory: DiffusionMemory) -> tuple[JointPlan, DiffusionMemory]:
        """Return the plan where nobody may be moved: of who comes in, if anybody, for the kind whose turn it is."""
        kept, newcomers = memory.commitments, tuple[Newcomer, ...]()
        if kept is not None:
            situation, licence = situation_of(road, view), licence_of(self.options.licence)
            _, kept = advance(situation, kept, self.options.attackers, PAUSE_S, licence)
            newcomers, kept = let_in(situation, kept)
        plan = plan_with(empty_plan(view.scene), newcomers, self._state((), None))
        return _with_standing(plan, kept, view.scene), replace(memory, plan=None, commitments=kept)


def _with_standing(plan: JointPlan, kept: Commitments | None, scene: Scene) -> JointPlan:
    """Return *plan* with who stands for an encounter."""
    return plan if kept is None else with_standing(plan, kept.standing, scene.time_s)


class Traj2Traj(DiffusionTraffic):
    """The paper's ablation in closed loop: trajectories are diffused, without decoder, bicycle model or guide."""

    Options: ClassVar[type[DiffusionOptions]] = Traj2TrajOptions
    name: ClassVar[str] = "traj2traj"
