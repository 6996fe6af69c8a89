"""The background ``scripted``: a few vehicles drive lawful manoeuvres against the target; SUMO drives the rest."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from pydantic import Field

from advdiff_sumo.core.kinematic_states import KinematicStates
from advdiff_sumo.core.plan import AttackState, JointPlan
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.traffic.attack_names import Kind
from advdiff_sumo.traffic.licence import LicenceName, licence_of
from advdiff_sumo.traffic.manoeuvres.commitments import Commitments
from advdiff_sumo.traffic.manoeuvres.encounter_preference import EncounterPreference
from advdiff_sumo.traffic.manoeuvres.intensity import SeverityOptions
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, planned_motions
from advdiff_sumo.traffic.manoeuvres.schedule import insert_vehicles, update_manoeuvres
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import PLAN_DT_S
from advdiff_sumo.traffic.manoeuvres.staging import DEFAULT_MAX_INSERTED, plan_with
from advdiff_sumo.traffic.manoeuvres.standing_traffic import with_standing

if TYPE_CHECKING:
    from advdiff_sumo.maps import RoadMap


class ScriptedOptions(SeverityOptions):
    """Options of ``scripted``, beside those that prescribe a severity.

    Attributes:
        attack: the kind of manoeuvre; "any": the one with the highest merit.
        licence: what attackers may do: "lawful", "careless" or "reckless".
        attackers: most vehicles in a manoeuvre at a time.
        pause_s: rest of a vehicle after a manoeuvre.
        staged: most vehicles that are inserted during an episode if an encounter lacks them; 0: none.
        reward: file of ``advdiff-sumo warmup``, to prefer encounters in which the target fails; empty: none.
    """

    attack: Kind = "any"
    licence: LicenceName = "lawful"
    attackers: int = Field(2, ge=1, le=8)
    pause_s: float = Field(8.0, ge=0.0, le=600.0)
    staged: int = Field(DEFAULT_MAX_INSERTED, ge=0, le=20)
    reward: str = ""


class ScriptedTraffic:
    """Lawful manoeuvres against the target; options are those of :class:`ScriptedOptions`."""

    Options: ClassVar[type[ScriptedOptions]] = ScriptedOptions

    def __init__(self, **options: Any) -> None:
        """Check the options.

        Raises:
            ConfigError: an option has no such name or value.
            WeightsError: ``reward`` cannot be used.
        """
        self.options = self.Options.parse(options, "options of background 'scripted'")
        reward = self.options.reward
        self.preference = EncounterPreference.read(Path(reward)) if reward else None

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> Commitments:  # noqa: ARG002 - the contract
        """Return the commitments of a new episode, with random weights of the kinds, so that episodes differ."""
        options = self.options
        return Commitments.start(options.attack, rng, options.staged, options.intensity, self.preference)

    def plan(
        self,
        road: RoadMap,
        scene: Scene,
        memory: Commitments,
        rng: np.random.Generator,  # noqa: ARG002 - the contract
    ) -> tuple[JointPlan, Commitments]:
        """Return the plans of the vehicles in a manoeuvre, 6 s at 2 Hz; SUMO drives all others."""
        view = SituationView.of(road, scene, memory.standing.hidden_names)
        options = self.options
        licence = licence_of(options.licence)
        driven, memory = update_manoeuvres(view, memory, options.attackers, options.pause_s, licence)
        state = AttackState(options.attack, memory.attacking, memory.manoeuvres)
        newcomers, memory = insert_vehicles(view, memory)
        plan = plan_with(tracks_of_manoeuvres(view, driven), newcomers, state)
        return with_standing(plan, memory.standing, scene.time_s), memory


def tracks_of_manoeuvres(view: SituationView, manoeuvres: Sequence[Manoeuvre]) -> Tracks:
    """Return the plans of *manoeuvres* at the model step."""
    begin_s = view.scene.time_s + PLAN_DT_S
    if not manoeuvres:
        return Tracks.empty(steps=1, dt_s=PLAN_DT_S, t0_s=begin_s)
    rows = [m.row for m in manoeuvres]
    plans = KinematicStates(*planned_motions(view, manoeuvres))
    return view.scene.history.rows(rows).with_states(plans, begin_s, PLAN_DT_S)
