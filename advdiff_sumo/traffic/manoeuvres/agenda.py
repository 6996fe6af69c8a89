"""The agenda of an episode of "any": the order in which the kinds of manoeuvre have their turns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from advdiff_sumo.maps.junction_priority import priority_links
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.traffic.manoeuvres.priority_traffic import REACH_M, SLOWEST_TARGET_MPS
from advdiff_sumo.traffic.manoeuvres.repertoire import SLOW_ENTRIES
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.slow_places import can_insert_slow_vehicle
from advdiff_sumo.traffic.manoeuvres.staging import NO_LEADER_WITHIN_M, can_insert_cut_out, is_first_plan
from advdiff_sumo.traffic.manoeuvres.standing_traffic import QUEUE, can_insert_queue

TURN_S = 7.0
"""Duration of a turn."""
TURNING_KINDS = ("cut-out", "hard-stop", "cut-in", "crossing")
"""Kinds that have turns; a cut-out only at the first instant."""
_CROSSING_FIRST, _CUT_OUT_FIRST, _QUEUE_FIRST = 0.5, 0.4, 0.2
"""Shares of the episodes with a crossing before a cut-in; with a cut-out first; with a queue after that."""
_SLOW_FIRST = 0.2  # share of the episodes that begin with a given slow entry
_ONLY_FIRST = ("cut-out", QUEUE, *SLOW_ENTRIES)
"""Kinds that have a turn only at the beginning."""
_AFTER_CROSSING = ("cut-in", "hard-stop")
"""Kinds that give up their turn before a junction where the target must yield."""
_FORESIGHT_S = 8.0


@dataclass(frozen=True)
class Agenda:
    """Which kinds an episode aims for, and when.

    Attributes:
        order: kinds in the order of their turns, the present one first; empty if all may come at any time.
        since_s: when the present turn began.
        crosses_any_time: whether a vehicle with priority may come in the turn of another kind.
    """

    order: tuple[str, ...] = ()
    since_s: float = 0.0
    crosses_any_time: bool = True

    @staticmethod
    def draw(rng: np.random.Generator, slow: Sequence[str] = ()) -> Agenda:
        """Return a random agenda; kinds that are rarely possible come first.

        Half of the episodes begin with a crossing, the others with a cut-in. A hard stop comes last, as its inserted
        leader would leave no room for a cut-in. Before these, two of five have a cut-out, and half of these a queue
        after it. Each of *slow*, kinds of slow entries, comes first of all in one of five episodes.
        """
        crossing_first = rng.random() < _CROSSING_FIRST
        order = ("crossing", "cut-in", "hard-stop") if crossing_first else ("cut-in", "crossing", "hard-stop")
        number = rng.spawn(1)[0].random()  # a draw of a child leaves the later draws of rng unchanged
        first = (
            ("cut-out", QUEUE) if number < _QUEUE_FIRST else ("cut-out",) if number < _CUT_OUT_FIRST else ()
        )
        slow_first = tuple(kind for kind in slow if rng.spawn(1)[0].random() < _SLOW_FIRST)
        return Agenda((*slow_first, *first, *order))

    def without(self, kind: str, time_s: float) -> Agenda:
        """Return the agenda with the turn of *kind* ended, if it is the present one; the next begins at *time_s*."""
        return replace(self, order=self.order[1:], since_s=time_s) if self.now == kind else self

    @property
    def prioritises_crossing(self) -> bool:
        """Whether a junction where the target may have to yield comes before the kind whose turn it is."""
        return bool(self.order) and self.crosses_any_time

    @property
    def now(self) -> str:
        """The kind whose turn it is; "" for all."""
        return self.order[0] if self.order else ""

    def updated(self, view: SituationView) -> Agenda:
        """Return the agenda in the scene of *view*: a turn ends after ``TURN_S``, or if its kind is not possible."""
        if not self.order:
            return self
        now, order = view.scene.time_s, self.order
        if order[0] in _AFTER_CROSSING and self.prioritises_crossing and approaches_yield_line(view):
            crossing_first = ("crossing", *(kind for kind in order if kind != "crossing"))
            return replace(self, order=crossing_first, since_s=now)
        if now - self.since_s < TURN_S and is_possible(view, order[0]):
            return self
        if order[0] in _ONLY_FIRST:
            return replace(self, order=order[1:], since_s=now).updated(view)
        if order[0] == "crossing" and is_possible(view, "crossing"):
            return self  # wait until the target reaches the junction
        rotated = [(*order[k:], *order[:k]) for k in range(1, len(order))]
        next_order = next((kinds for kinds in rotated if is_possible(view, kinds[0])), order)
        return replace(self, order=next_order, since_s=now)


def is_possible(view: SituationView, kind: str) -> bool:
    """Return whether the road and the traffic around the target leave room for *kind*."""
    target = view.target
    if target is None or kind == "hard-stop":
        return True
    if kind in SLOW_ENTRIES:
        return not is_first_plan(view) or can_insert_slow_vehicle(view, kind)
    if kind in _ONLY_FIRST:
        can_insert = can_insert_cut_out if kind == "cut-out" else can_insert_queue
        return not is_first_plan(view) or can_insert(view)
    if kind == "cut-in":
        has_lane_beside = any(view.neighbour_way(view.scene.target, side) for side in ("left", "right"))
        return has_lane_beside and view.is_clear_to(NO_LEADER_WITHIN_M)
    return bool(_links_with_priority(view, REACH_M))


def approaches_yield_line(view: SituationView) -> bool:
    """Return whether the target soon reaches, unhindered, a junction where others have priority and no light is red.

    This is the rarest of all encounters. No vehicle may lead the target then, as it would keep it from the junction.
    """
    target = view.target
    reach_m = max(_FORESIGHT_S * target.speed_mps, 0.5 * REACH_M) if target is not None else 0.0
    return any(not view.is_red(link) for link in _links_with_priority(view, reach_m))


def has_red_ahead(view: SituationView) -> bool:
    """Return whether the target has a red light at the next junction, where only one that runs it meets anybody."""
    target = view.target
    links = target.way.links if target is not None else ()
    return any(view.is_red(link) for line_m, link in links[:1] if 0.0 < line_m < REACH_M)


def _links_with_priority(view: SituationView, reach_m: float) -> Sequence[Link]:
    """Return the target's links within *reach_m* where others have priority, and which it will reach unhindered."""
    target = view.target
    if target is None or target.speed_mps <= SLOWEST_TARGET_MPS:
        return ()
    near = ((line_m, link) for line_m, link in target.way.links if 0.0 < line_m < reach_m)
    reachable = (link for line_m, link in near if view.is_clear_on_arrival(line_m))
    return [link for link in reachable if priority_links(view.road, link, view.scene.signals)]
