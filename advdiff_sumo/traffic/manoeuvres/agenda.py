"""The agenda of an episode of "any": which kind it is for now, so that every kind gets its turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.traffic.manoeuvres.priority_traffic import REACH_M, SLOWEST_TARGET_MPS, priority_links
from advdiff_sumo.traffic.manoeuvres.repertoire import SLOW_ENTRIES
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.slow_places import can_insert_slow_vehicle
from advdiff_sumo.traffic.manoeuvres.staging import NO_LEADER_WITHIN_M, can_insert_cut_out, is_first_plan
from advdiff_sumo.traffic.manoeuvres.standing_traffic import QUEUE, can_insert_queue

TURN_S = 7.0
"""For so long an episode is for one kind."""
TURNING_KINDS = ("cut-out", "hard-stop", "cut-in", "crossing")
"""Kinds that have turns; a cut-out at the first instant alone."""
_CROSSING_FIRST, _CUT_OUT_FIRST, _QUEUE_FIRST = 0.5, 0.4, 0.2
_SLOW_FIRST = 0.2
_AT_FIRST = ("cut-out", QUEUE, *SLOW_ENTRIES)
"""Kinds that have a turn at the beginning alone."""
_LATER = ("cut-in", "hard-stop")
_FORESEES_S = 8.0


@dataclass(frozen=True)
class Agenda:
    """What an episode is for.

    Attributes:
        order: kinds in the order of their turns, the present one first; empty where all are wanted at any time.
        since_s: when the present turn began.
        crosses_any_time: whether somebody with priority may come in the turn of another kind.
    """

    order: tuple[str, ...] = ()
    since_s: float = 0.0
    crosses_any_time: bool = True

    @staticmethod
    def draw(rng: np.random.Generator, slow: Sequence[str] = ()) -> Agenda:
        """Return one that begins with what is rarest to be possible: crossing in half of the episodes.

        A cut-in comes before a hard stop: a leader that came in for one leaves no room for the other. In two of five a
        cut-out precedes all, which is possible at the first instant alone; in one of five the end of a queue does where
        no cut-out is possible. One of five begins with each of *slow*, kinds that enter slowly, where that is possible.
        """
        crossing_first = rng.random() < _CROSSING_FIRST
        order = ("crossing", "cut-in", "hard-stop") if crossing_first else ("cut-in", "crossing", "hard-stop")
        drawn = rng.spawn(1)[0].random()  # without a draw, which would change all that is drawn after
        first = ("cut-out", QUEUE) if drawn < _QUEUE_FIRST else ("cut-out",) if drawn < _CUT_OUT_FIRST else ()
        slow_first = tuple(kind for kind in slow if rng.spawn(1)[0].random() < _SLOW_FIRST)
        return Agenda((*slow_first, *first, *order))

    def without(self, kind: str, time_s: float) -> Agenda:
        """Return the agenda without *kind* if its turn is first, so that the next one's begins at *time_s*."""
        return replace(self, order=self.order[1:], since_s=time_s) if self.now == kind else self

    @property
    def prioritises_crossing(self) -> bool:
        """Whether a place where the target may have to yield comes before the kind whose turn it is."""
        return bool(self.order) and self.crosses_any_time

    @property
    def now(self) -> str:
        """The kind whose turn it is; "" for all."""
        return self.order[0] if self.order else ""

    def updated(self, view: SituationView) -> Agenda:
        """Return the agenda in the scene of *view*: a turn is over after ``TURN_S``, or where its kind cannot be."""
        if not self.order:
            return self
        now, order = view.scene.time_s, self.order
        if order[0] in _LATER and self.prioritises_crossing and approaches_yield_line(view):
            first = ("crossing", *(kind for kind in order if kind != "crossing"))
            return replace(self, order=first, since_s=now)
        if now - self.since_s < TURN_S and is_possible(view, order[0]):
            return self
        if order[0] in _AT_FIRST:
            return replace(self, order=order[1:], since_s=now).updated(view)
        if order[0] == "crossing" and is_possible(view, "crossing"):
            return self  # a junction takes as long as it takes to get there
        later = [(*order[k:], *order[:k]) for k in range(1, len(order))]
        turned = next((one for one in later if is_possible(view, one[0])), order)
        return replace(self, order=turned, since_s=now)


def is_possible(view: SituationView, kind: str) -> bool:
    """Return whether the road and the traffic around the target leave room for *kind*."""
    target = view.target
    if target is None or kind == "hard-stop":
        return True
    if kind in SLOW_ENTRIES:
        return not is_first_plan(view) or can_insert_slow_vehicle(view, kind)
    if kind in _AT_FIRST:
        return not is_first_plan(view) or (
            can_insert_cut_out(view) if kind == "cut-out" else can_insert_queue(view)
        )
    if kind == "cut-in":
        beside = any(view.neighbour_way(view.scene.target, side) for side in ("left", "right"))
        return beside and view.is_clear_to(NO_LEADER_WITHIN_M)
    return bool(_lets_pass(view, REACH_M))


def approaches_yield_line(view: SituationView) -> bool:
    """Return whether the target comes, alone, to where somebody may have the right of way, lights apart.

    That is the rarest of all encounters: nobody may lead the target then, who would keep it from the junction.
    """
    target = view.target
    reach_m = max(_FORESEES_S * target.speed_mps, 0.5 * REACH_M) if target is not None else 0.0
    return any(not view.is_red(link) for link in _lets_pass(view, reach_m))


def has_red_ahead(view: SituationView) -> bool:
    """Return whether the next junction shows the target a red light: only one that runs it meets anybody there."""
    target = view.target
    ahead = target.way.links if target is not None else ()
    return any(view.is_red(link) for reach, link in ahead[:1] if 0.0 < reach < REACH_M)


def _lets_pass(view: SituationView, reach_m: float) -> Sequence[Link]:
    """Return the links ahead, within *reach_m*, where a target that moves arrives alone and others go first."""
    target = view.target
    if target is None or target.speed_mps <= SLOWEST_TARGET_MPS:
        return ()
    ahead = (
        link for reach, link in target.way.links if 0.0 < reach < reach_m and view.is_clear_on_arrival(reach)
    )
    return [link for link in ahead if priority_links(view, link)]
