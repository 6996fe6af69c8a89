"""Manoeuvres over time: chosen, carried on while they are lawful and of use, and over."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from advdiff_sumo.traffic.manoeuvres.choice import Chosen, rank
from advdiff_sumo.traffic.manoeuvres.licence import LAWFUL, Licence
from advdiff_sumo.traffic.manoeuvres.licence_rules import lawful
from advdiff_sumo.traffic.manoeuvres.manoeuvre import ENTERS_SHARE, Manoeuvre, futures_of_manoeuvres
from advdiff_sumo.traffic.manoeuvres.plan_licence import CARELESS_ALLOWS, plan_breaches
from advdiff_sumo.traffic.manoeuvres.profiles import SpeedProfile
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.staging import Newcomer, Stage, come_in
from advdiff_sumo.traffic.manoeuvres.ways import Way

_LONGEST_S: Mapping[str, float] = {"blocked-lane": 14.0, "hard-stop": 9.0, "stop-and-go": 6.0}
_LONGEST_DEFAULT_S = 7.0
_LORRIES = 0.5
"""Share of episodes in which who comes in ahead is a lorry."""
_SOON_M, _SPACE_M = 110.0, 70.0
_OPENINGS = ("hard-stop", "cut-in", "crossing")
_PATIENT_S, _WORTH_IT = 7.0, 0.4
"""For so long an episode is for what it begins with, and less merit than this waits for a better moment."""
HARDEST_MPS2 = 9.0
"""Nobody brakes harder."""
_TRIED = 4
"""Manoeuvres that are checked in full, best first."""


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
class Commitments:
    """What is remembered from plan to plan.

    Attributes:
        weights: kind → how much it is wanted in this episode.
        active: id → its manoeuvre.
        rested_s: id → when it may take part again.
        stage: who has come in for an encounter, and may.
        first: the kind that an episode of "any" begins with; "" for all.
        hardest_mps2: strongest braking with which a manoeuvre is driven, however hard the one was that was chosen.
    """

    weights: Mapping[str, float]
    active: Mapping[str, Commitment] = field(default_factory=dict)
    rested_s: Mapping[str, float] = field(default_factory=dict)
    stage: Stage = field(default_factory=Stage)
    first: str = ""
    hardest_mps2: float = HARDEST_MPS2

    def wanted(self, now_s: float) -> tuple[str, ...]:
        """Return the kinds that may begin now: the episode's first one and crossing, later all."""
        early = (self.first, "crossing") if self.first and now_s < _PATIENT_S else tuple(self.weights)
        return tuple(kind for kind in self.weights if kind in early)

    @property
    def attacking(self) -> tuple[str, ...]:
        """Ids of those in a manoeuvre that are past getting into position for it."""
        return tuple(name for name, under_way in self.active.items() if not under_way.sets_up)

    @staticmethod
    def start(attack: str, rng: np.random.Generator, staged: int = 0) -> Commitments:
        """Return none, with preferences drawn for *attack*, a kind or "any", so that episodes differ.

        Args:
            attack: the kind.
            rng: for the draws.
            staged: most vehicles that may come in.
        """
        kinds = list(KINDS) if attack == "any" else [attack]
        weights = dict(zip(kinds, (1.0 - 0.7 * rng.random(len(kinds))).tolist(), strict=True))
        stage = Stage(staged, lorry=bool(rng.random() < _LORRIES))
        first = str(rng.choice(_OPENINGS)) if attack == "any" else ""
        return Commitments(weights, stage=stage, first=first)


def advance(
    view: SituationView, kept: Commitments, attackers: int, pause_s: float, licence: Licence | None = LAWFUL
) -> tuple[list[Manoeuvre], Commitments]:
    """Return the manoeuvres that are driven now, and what is remembered of them.

    Args:
        view: the scene.
        kept: from the plan before.
        attackers: most vehicles that are in a manoeuvre at a time.
        pause_s: rest of a vehicle after a manoeuvre.
        licence: what they may do; None: anything.
    """
    if kept.first and view.scene.time_s <= 0.0:
        kept = replace(kept, first=_opening(view, kept.first))
    going, kept = _carry_on(view, kept, pause_s, licence)
    room = attackers - len(going)
    fresh = _begin(view, kept, {m.row for m in going}, room, licence) if room > 0 else []
    names, now = view.scene.history.ids, view.scene.time_s
    begun = {names[m.row]: Commitment(m.kind, m.profile, now, m.sets_up) for m in fresh}
    return [*going, *fresh], replace(kept, active={**kept.active, **begun})


def let_in(view: SituationView, kept: Commitments) -> tuple[tuple[Newcomer, ...], Commitments]:
    """Return who comes in now, for the manoeuvres that may begin, and what is remembered of them."""
    newcomers, stage = come_in(view, kept.stage, kept.wanted(view.scene.time_s))
    return newcomers, replace(kept, stage=stage)


def _opening(view: SituationView, first: str) -> str:
    """Return what an episode that should begin with *first* can begin with."""
    target = view.target
    if first == "cut-in":
        beside = any(target and view.neighbour(view.scene.target, side) for side in ("left", "right"))
        return first if beside and view.is_first(_SPACE_M) else "hard-stop"
    links = target.way.links if target is not None else ()
    gives_way = any(reach < _SOON_M and view.road.yields_to(link) for reach, link in links)
    return "hard-stop" if first == "crossing" and not gives_way else first


def _begin(
    view: SituationView, kept: Commitments, busy: set[int], room: int, licence: Licence | None
) -> list[Manoeuvre]:
    """Return the best new manoeuvres, one a vehicle, at most *room*."""
    names, now = view.scene.history.ids, view.scene.time_s
    free = [r for r in view.movable if r not in busy and kept.rested_s.get(names[r], -1.0) <= now]
    proposals = [m for row in free for kind in kept.wanted(now) for m in KINDS[kind](view, row)]
    out: list[Manoeuvre] = []
    least = _WORTH_IT if now < _PATIENT_S else 0.0
    ranked = rank(view, proposals, kept.weights, licence)
    worthy = [one for one in ranked if one.manoeuvre.sets_up or one.merit >= least]
    for chosen in worthy[:_TRIED]:
        fits = all(chosen.manoeuvre.row != other.row for other in out)
        if len(out) < room and fits and _passes(view, chosen, licence):
            out.append(softened(chosen.manoeuvre, kept.hardest_mps2))
    return out


def softened(manoeuvre: Manoeuvre, hardest_mps2: float) -> Manoeuvre:
    """Return *manoeuvre* with braking of at most *hardest_mps2*."""
    first, then = (max(a, -hardest_mps2) for a in (manoeuvre.profile.first_mps2, manoeuvre.profile.then_mps2))
    return replace(manoeuvre, profile=replace(manoeuvre.profile, first_mps2=first, then_mps2=then))


def _passes(view: SituationView, chosen: Chosen, licence: Licence | None) -> bool:
    """Return whether the breach rules of the verdict find nothing in the plan of *chosen*."""
    if licence is None or chosen.manoeuvre.sets_up:
        return True
    future = chosen.futures
    rows = [chosen.manoeuvre.row]
    broken = plan_breaches(view, rows, future.xy_m, future.yaw_rad, future.speed_mps)[0]
    return not (broken - (CARELESS_ALLOWS if licence is not LAWFUL else frozenset()))


def _carry_on(
    view: SituationView, kept: Commitments, pause_s: float, licence: Licence | None
) -> tuple[list[Manoeuvre], Commitments]:
    """Return the manoeuvres under way that go on within the licence, and the memory without the others."""
    index, now = view.scene.history.index, view.scene.time_s
    going: list[Manoeuvre] = []
    active, rested = dict(kept.active), dict(kept.rested_s)
    for name, under_way in kept.active.items():
        row = index.get(name)
        manoeuvre = _continued(view, row, under_way, now, licence) if row in view.movable else None
        if manoeuvre is not None and _still_lawful(view, manoeuvre, licence):
            going.append(manoeuvre)
            continue
        del active[name]
        rested[name] = now + (0.0 if under_way.sets_up else pause_s)
    return going, replace(kept, active=active, rested_s=rested)


def _continued(
    view: SituationView, row: int | None, under_way: Commitment, now_s: float, licence: Licence | None
) -> Manoeuvre | None:
    """Return the rest of a manoeuvre; None where it is over."""
    passed = now_s - under_way.since_s
    longest = _LONGEST_S.get(under_way.kind, _LONGEST_DEFAULT_S)
    if row is None or under_way.sets_up or passed >= longest:
        return None
    if under_way.kind == "crossing":
        again = rank(view, list(KINDS["crossing"](view, row)), {"crossing": 1.0}, licence)
        if again:
            return again[0].manoeuvre
    begun = under_way.profile
    rest = replace(begun, switch_s=max(begun.switch_s - passed, 0.0))
    return Manoeuvre(under_way.kind, row, view.ways[row], rest, _goal(view, row, under_way.kind))


def _goal(view: SituationView, row: int, kind: str) -> Way | None:
    if kind not in ("cut-in", "cut-out"):
        return None
    again = [m.goal for m in KINDS[kind](view, row) if m.goal is not None]
    return again[0] if again else None


def _still_lawful(view: SituationView, manoeuvre: Manoeuvre, licence: Licence | None) -> bool:
    """Return whether *manoeuvre* goes on: with the gap that the rule asks for, and none once it is over the line."""
    futures = futures_of_manoeuvres([manoeuvre], np.array([view.speed(manoeuvre.row)]))
    if licence is not None:
        licence = replace(licence, gap_share=min(licence.gap_share, 1.0), spare_m=0.0)
    goal = manoeuvre.goal
    if goal is not None:
        across = abs(float(goal.line.project(view.scene.history.xy_m[manoeuvre.row, -1])[1]))
        if across < (1.0 - ENTERS_SHARE) * goal.present_lane.width_m:
            manoeuvre = replace(manoeuvre, goal=None)
    return bool(lawful(view, [manoeuvre], futures, licence)[0])
