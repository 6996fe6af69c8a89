"""The background ``scripted``: a few vehicles drive lawful manoeuvres against the target; SUMO drives the rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeAlias

import numpy as np
from pydantic import Field

from advdiff_sumo.config import Options
from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.traffic.manoeuvres.choice import Chosen, rank
from advdiff_sumo.traffic.manoeuvres.licence_rules import lawful
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, futures_of_manoeuvres
from advdiff_sumo.traffic.manoeuvres.profiles import CHECK_DT_S, PLAN_DT_S, SpeedProfile
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.ways import Way

if TYPE_CHECKING:
    from advdiff_sumo.maps import RoadMap

Kind: TypeAlias = Literal["any", "hard-stop", "cut-in", "crossing", "blocked-lane", "stop-and-go", "cut-out"]
_EVERY = round(PLAN_DT_S / CHECK_DT_S)
_LONGEST_S: Mapping[str, float] = {"blocked-lane": 14.0, "hard-stop": 9.0, "stop-and-go": 6.0}
_LONGEST_DEFAULT_S = 7.0
_POSITIONING_S = 5.0


class ScriptedOptions(Options):
    """Options of ``scripted``.

    Attributes:
        attack: the kind of manoeuvre; "any": whichever asks most of the target.
        attackers: most vehicles that are in a manoeuvre at a time.
        pause_s: rest of a vehicle after a manoeuvre.
    """

    attack: Kind = "any"
    attackers: int = Field(2, ge=1, le=8)
    pause_s: float = Field(8.0, ge=0.0, le=600.0)


@dataclass(frozen=True)
class Commitment:
    """A manoeuvre under way.

    Attributes:
        kind: which.
        profile: its speed, as chosen.
        since_s: when it began.
        sets_up: whether it only gets into position.
    """

    kind: str
    profile: SpeedProfile
    since_s: float
    sets_up: bool


@dataclass(frozen=True)
class Memory:
    """What the policy remembers from plan to plan.

    Attributes:
        weights: kind → how much it is wanted in this episode.
        active: id → its manoeuvre.
        rested_s: id → when it may take part again.
    """

    weights: Mapping[str, float]
    active: Mapping[str, Commitment] = field(default_factory=dict)
    rested_s: Mapping[str, float] = field(default_factory=dict)


class ScriptedTraffic:
    """Lawful manoeuvres against the target; options are those of :class:`ScriptedOptions`."""

    Options: ClassVar[type[ScriptedOptions]] = ScriptedOptions

    def __init__(self, **options: Any) -> None:
        """Check the options.

        Raises:
            ConfigError: an option has no such name or value.
        """
        self.options = self.Options.parse(options, "options of background 'scripted'")

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> Memory:  # noqa: ARG002 - the contract
        """Return which kinds this episode prefers, so that episodes differ."""
        kinds = list(KINDS) if self.options.attack == "any" else [self.options.attack]
        return Memory(dict(zip(kinds, (1.0 - 0.7 * rng.random(len(kinds))).tolist(), strict=True)))

    def plan(
        self,
        road: RoadMap,
        scene: Scene,
        memory: Memory,
        rng: np.random.Generator,  # noqa: ARG002 - the contract
    ) -> tuple[JointPlan, Memory]:
        """Return the plans of the vehicles in a manoeuvre, 6 s at 2 Hz; SUMO drives everybody else."""
        view = SituationView.of(road, scene)
        going, memory = _carry_on(view, memory, self.options.pause_s)
        room = self.options.attackers - len(going)
        fresh = self._begin(view, memory, {m.row for m in going}, room) if room > 0 else []
        now = scene.time_s
        names = scene.history.ids
        begun = {
            names[c.manoeuvre.row]: Commitment(
                c.manoeuvre.kind, c.manoeuvre.profile, now, c.manoeuvre.sets_up
            )
            for c in fresh
        }
        driven = [*going, *(c.manoeuvre for c in fresh)]
        return JointPlan(tracks_of_manoeuvres(view, driven)), replace(
            memory, active={**memory.active, **begun}
        )

    def _begin(self, view: SituationView, memory: Memory, busy: set[int], room: int) -> list[Chosen]:
        """Return the best new manoeuvres, one a vehicle, at most *room*."""
        names, now = view.scene.history.ids, view.scene.time_s
        free = [r for r in view.movable if r not in busy and memory.rested_s.get(names[r], -1.0) <= now]
        proposals = [m for row in free for kind in memory.weights for m in KINDS[kind](view, row)]
        out: list[Chosen] = []
        for chosen in rank(view, proposals, memory.weights):
            if len(out) < room and all(chosen.manoeuvre.row != other.manoeuvre.row for other in out):
                out.append(chosen)
        return out


def _carry_on(view: SituationView, memory: Memory, pause_s: float) -> tuple[list[Manoeuvre], Memory]:
    """Return the manoeuvres under way that go on lawfully, and the memory without the others."""
    index, now = view.scene.history.index, view.scene.time_s
    going: list[Manoeuvre] = []
    active, rested = dict(memory.active), dict(memory.rested_s)
    for name, under_way in memory.active.items():
        row = index.get(name)
        manoeuvre = _continued(view, row, under_way, now) if row in view.movable else None
        if manoeuvre is not None and _still_lawful(view, manoeuvre):
            going.append(manoeuvre)
            continue
        del active[name]
        rested[name] = now + (0.0 if under_way.sets_up else pause_s)
    return going, replace(memory, active=active, rested_s=rested)


def _continued(view: SituationView, row: int | None, under_way: Commitment, now_s: float) -> Manoeuvre | None:
    """Return the rest of a manoeuvre; None where it is over."""
    passed = now_s - under_way.since_s
    longest = _LONGEST_S.get(under_way.kind, _LONGEST_DEFAULT_S)
    if row is None or under_way.sets_up or passed >= longest:
        return None
    if under_way.kind == "crossing":
        again = rank(view, list(KINDS["crossing"](view, row)), {"crossing": 1.0})
        if again:
            return again[0].manoeuvre
    begun = under_way.profile
    rest = replace(begun, switch_s=max(begun.switch_s - passed, 0.0))
    goal = _goal(view, row, under_way.kind)
    return Manoeuvre(under_way.kind, row, view.ways[row], rest, goal)


def _goal(view: SituationView, row: int, kind: str) -> Way | None:
    if kind not in ("cut-in", "cut-out"):
        return None
    again = [m.goal for m in KINDS[kind](view, row) if m.goal is not None]
    return again[0] if again else None


def _still_lawful(view: SituationView, manoeuvre: Manoeuvre) -> bool:
    futures = futures_of_manoeuvres([manoeuvre], np.array([view.speed(manoeuvre.row)]))
    return bool(lawful(view, [manoeuvre], futures)[0])


def tracks_of_manoeuvres(view: SituationView, manoeuvres: Sequence[Manoeuvre]) -> Tracks:
    """Return the plans of *manoeuvres* at the model step."""
    begin = view.scene.time_s + PLAN_DT_S
    if not manoeuvres:
        return Tracks.empty(steps=1, dt_s=PLAN_DT_S, t0_s=begin)
    rows = [m.row for m in manoeuvres]
    futures = futures_of_manoeuvres(manoeuvres, np.array([view.speed(row) for row in rows]))
    at = slice(_EVERY - 1, None, _EVERY)
    now = view.scene.history.rows(rows)
    return Tracks(
        ids=now.ids,
        classes=now.classes,
        size_m=now.size_m,
        xy_m=futures.xy_m[:, at],
        yaw_rad=futures.yaw_rad[:, at],
        speed_mps=futures.speed_mps[:, at],
        valid=np.ones((len(rows), futures.yaw_rad[:, at].shape[1]), dtype=np.bool_),
        t0_s=begin,
        dt_s=PLAN_DT_S,
    )
