"""Decide by stated rules which party caused a collision.

The classes follow nuPlan's at-fault metric (Karnchanachari et al. 2024, "Towards learning-based planning: the
nuPlan benchmark", arXiv:2403.04133). A vehicle that stands or is hit from behind is not at fault. One that runs into
another with its front is, and so is one that is hit at the side while it is out of its lane. Added here: cut-ins judged
by the gap that they leave (Shalev-Shwartz, Shammah and Shashua 2017, "On a formal model of safe and scalable
self-driving cars", arXiv:1708.06374, Definition 1), right of way at junctions by the net's rows, red lights, and
driving the wrong way. ``docs/metrics.md`` states the rules.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from advdiff_sumo.metrics.breaches.conduct_rules import reversing_breach
from advdiff_sumo.metrics.breaches.junction_rules import (
    ARRIVAL_MARGIN_S,
    breach_towards_pedestrian,
    joined_safely,
    later_by_s,
    must_yield,
    ran_red,
    red_light,
    right_of_way,
    signals_are_unknown,
)
from advdiff_sumo.metrics.breaches.lane_rules import sideways_breach
from advdiff_sumo.metrics.breaches.striking_rules import pushed_by
from advdiff_sumo.metrics.collision_type import CollisionType
from advdiff_sumo.metrics.encounter import Encounter, Party
from advdiff_sumo.metrics.lane_entry import LaneEntry
from advdiff_sumo.metrics.traffic_view import TrafficView


class AtFault(StrEnum):
    """The party that caused the collision."""

    TARGET = "target"
    OTHER = "other"
    UNCLEAR = "unclear"


@dataclass(frozen=True)
class Fault:
    """The party that caused a collision, and the reason.

    Attributes:
        at_fault: the party.
        reason: one sentence for the user.
    """

    at_fault: AtFault
    reason: str


OFF_ROAD = Fault(AtFault.TARGET, "The target left the road.")
_SIGNAL_UNKNOWN = Fault(AtFault.UNCLEAR, "What the light there showed is not recorded.")

_Rule = Callable[[TrafficView, Encounter, CollisionType], Fault | None]


def fault_of(view: TrafficView, case: Encounter, kind: CollisionType) -> Fault:
    """Return the fault in a collision with another agent, by the first rule that applies."""
    first_rules: tuple[_Rule, ...] = (_appeared, _pushed, _standing, _wrong_way, _reversing, _with_pedestrian)
    rules = (*first_rules, _RULES[kind])
    for rule in rules:
        fault = rule(view, case, kind)
        if fault is not None:
            return fault
    return Fault(AtFault.UNCLEAR, "No rule says which of the two caused it.")


def _appeared(_view: TrafficView, case: Encounter, _kind: CollisionType) -> Fault | None:
    late = case.late_appearance
    return Fault(AtFault.UNCLEAR, f"{late} the contact, too late to react to.") if late else None


def _pushed(view: TrafficView, case: Encounter, _kind: CollisionType) -> Fault | None:
    third = pushed_by(view, case, 0)
    if third is None or case.target.face != "front":
        return None
    return Fault(AtFault.OTHER, f"'{view.tracks.ids[third]}' had run into the target before.")


def _standing(view: TrafficView, case: Encounter, _kind: CollisionType) -> Fault | None:
    if case.target.stands and not case.other.stands and not _stopped_in_the_way(view, case):
        return Fault(AtFault.OTHER, f"The target stood still when '{case.other.name}' ran into it.")
    if case.other.stood and not case.target.stands:
        return Fault(AtFault.TARGET, f"The target ran into '{case.other.name}', which was standing.")
    return None


def _stopped_in_the_way(view: TrafficView, case: Encounter) -> bool:
    """Return whether the target stopped too late for the other, after it ran a red light or took the other's way."""
    came_by_breach = red_light(view, case, 0) is not None or right_of_way(view, case, 0) is not None
    return came_by_breach and not case.target.stood


def _wrong_way(_view: TrafficView, case: Encounter, _kind: CollisionType) -> Fault | None:
    if case.other.wrong_way and not case.target.wrong_way:
        return Fault(AtFault.OTHER, f"'{case.other.name}' drove against the direction of its lane.")
    if case.target.wrong_way and not case.other.wrong_way:
        return Fault(AtFault.TARGET, "The target drove against the direction of its lane.")
    return None


def _reversing(view: TrafficView, case: Encounter, _kind: CollisionType) -> Fault | None:
    target_reverses, other_reverses = (reversing_breach(view, case, i) is not None for i in (0, 1))
    if other_reverses and not target_reverses:
        return Fault(AtFault.OTHER, f"'{case.other.name}' was reversing.")
    if target_reverses and not other_reverses:
        return Fault(AtFault.TARGET, "The target was reversing.")
    return None


def _with_pedestrian(view: TrafficView, case: Encounter, _kind: CollisionType) -> Fault | None:
    """Judge a collision with a pedestrian by red lights and the right of way on crossings, before the lane rules."""
    by_target, by_other = breach_towards_pedestrian(view, case, 1), breach_towards_pedestrian(view, case, 0)
    if by_target is not None:
        return Fault(AtFault.TARGET, f"The target {by_target.text}.")
    if by_other is not None:
        return Fault(AtFault.OTHER, f"'{case.other.name}' {by_other.text}.")
    has_pedestrian = any(party.is_pedestrian for party in case.parties)
    return _SIGNAL_UNKNOWN if has_pedestrian and signals_are_unknown(view, case) else None


def _striking(view: TrafficView, case: Encounter, kind: CollisionType) -> Fault:
    rear_end = Fault(AtFault.TARGET, f"The target ran into the rear of '{case.other.name}'.")
    return _joined_unsafely(view, case, kind, case.other) or rear_end


def _struck(view: TrafficView, case: Encounter, kind: CollisionType) -> Fault:
    rear_end = Fault(AtFault.OTHER, f"'{case.other.name}' ran into the rear of the target.")
    return _joined_unsafely(view, case, kind, case.target) or rear_end


def _joined_unsafely(view: TrafficView, case: Encounter, kind: CollisionType, struck: Party) -> Fault | None:
    """Judge a rear end just beyond a junction as one on it, if the *struck* party joined without the safe gap."""
    entry = case.cut_in
    if case.merged is None or entry is None or entry.row != struck.row or entry.safe or entry.recovered:
        return None
    return _junction(view, case, kind)


def _cut_in(_view: TrafficView, case: Encounter, kind: CollisionType) -> Fault | None:
    return None if case.cut_in is None else _by_lane_entry(case, case.cut_in, kind)


def _by_gap(case: Encounter, entry: LaneEntry) -> Fault:
    gaps = f"{entry.gap_m:.1f} m ahead at {entry.time_s:.1f} s, where {entry.needed_m:.1f} m are needed"
    if entry.row == case.target.row:
        at_fault = AtFault.OTHER if entry.safe else AtFault.TARGET
        return Fault(at_fault, f"The target entered the lane of '{case.other.name}' {gaps}.")
    at_fault = AtFault.TARGET if entry.safe else AtFault.OTHER
    return Fault(at_fault, f"'{case.other.name}' entered the target's lane {gaps}.")


def _lane_keeping(view: TrafficView, case: Encounter, kind: CollisionType) -> Fault | None:
    """Judge side and head-on collisions: the party that left its lane, entered the other's or moved sideways did it."""
    if case.cut_in is not None and not case.crossing:
        return _by_lane_entry(case, case.cut_in, kind)
    target_left, other_left = case.target.leaves_lane, case.other.leaves_lane
    if other_left and not target_left:
        return Fault(AtFault.OTHER, f"'{case.other.name}' was out of its lane, the target was not.")
    if target_left and not other_left:
        return Fault(AtFault.TARGET, f"The target was out of its lane, '{case.other.name}' was not.")
    if kind is CollisionType.SIDE:
        return _by_drift(view, case) or _by_fronts(case)
    return Fault(AtFault.UNCLEAR, "Both or neither of the two were out of their lanes.")


def _by_lane_entry(case: Encounter, entry: LaneEntry, kind: CollisionType) -> Fault | None:
    head_on = kind is CollisionType.HEAD_ON and not any(x.is_pedestrian for x in case.parties)
    if entry.gap_m >= 0.0 and not entry.oncoming and not head_on:
        return _by_gap(case, entry)
    name, oncoming = f"'{case.other.name}'", "the oncoming " if entry.oncoming else ""
    where = "" if entry.oncoming else " beside it" if entry.gap_m < 0.0 else " ahead of it"
    if entry.row == case.target.row:
        return Fault(AtFault.TARGET, f"The target moved into the lane of {oncoming}{name}{where}.")
    return Fault(AtFault.OTHER, f"{name} moved into the lane of {oncoming or 'the '}target{where}.")


def _by_drift(view: TrafficView, case: Encounter) -> Fault | None:
    """Judge by the motion across the lanes, where one alone moved sideways into the vehicle beside."""
    target_drifts, other_drifts = (sideways_breach(view, case, i) is not None for i in (0, 1))
    if target_drifts and not other_drifts:
        return Fault(AtFault.TARGET, f"The target moved sideways into '{case.other.name}'.")
    if other_drifts and not target_drifts:
        return Fault(AtFault.OTHER, f"'{case.other.name}' moved sideways into the target.")
    return None


def _by_fronts(case: Encounter) -> Fault | None:
    """Judge by the fronts if both or neither left their lanes: a party that hit with its front could have braked."""
    target_front, other_front = case.target.face == "front", case.other.face == "front"
    if target_front and not other_front:
        return Fault(AtFault.TARGET, f"The target ran into the side of '{case.other.name}' with its front.")
    if other_front and not target_front:
        return Fault(AtFault.OTHER, f"'{case.other.name}' ran into the side of the target with its front.")
    return None


def _junction(view: TrafficView, case: Encounter, _kind: CollisionType) -> Fault | None:
    red = ran_red(view, case.target), ran_red(view, case.other)
    if red == (True, False):
        return Fault(AtFault.TARGET, "The target entered the junction on red.")
    if red == (False, True):
        return Fault(AtFault.OTHER, f"'{case.other.name}' entered the junction on red.")
    if red == (True, True):
        return Fault(AtFault.UNCLEAR, f"The target and '{case.other.name}' both entered the junction on red.")
    rear_end = _joined_safely(case)
    if rear_end is not None:
        return rear_end
    if signals_are_unknown(view, case):
        return _SIGNAL_UNKNOWN
    obliged = (
        must_yield(view, case.target, case.other),
        must_yield(view, case.other, case.target),
    )
    if obliged == (True, False):
        return Fault(AtFault.TARGET, f"The target had to give way to '{case.other.name}' at the junction.")
    if obliged == (False, True):
        return Fault(AtFault.OTHER, f"'{case.other.name}' had to give way to the target at the junction.")
    return _first_come(view, case)


def _joined_safely(case: Encounter) -> Fault | None:
    """Judge front against rear where two ways join: a party that joined with a safe gap is an ordinary leader."""
    if joined_safely(case, 1):
        return Fault(AtFault.TARGET, f"The target ran into the rear of '{case.other.name}'.")
    if joined_safely(case, 0):
        return Fault(AtFault.OTHER, f"'{case.other.name}' ran into the rear of the target.")
    return None


def _first_come(view: TrafficView, case: Encounter) -> Fault | None:
    """Judge if the net obliges neither or both to yield, as at all-way stops: the first to come may go."""
    later_s = later_by_s(view, case)
    if later_s is None:
        return None
    if later_s > ARRIVAL_MARGIN_S:
        return Fault(
            AtFault.TARGET, f"'{case.other.name}' was on the junction {later_s:.1f} s before the target."
        )
    if later_s < -ARRIVAL_MARGIN_S:
        return Fault(
            AtFault.OTHER, f"The target was on the junction {-later_s:.1f} s before '{case.other.name}'."
        )
    return None


_RULES: dict[CollisionType, _Rule] = {
    CollisionType.JUNCTION: _junction,
    CollisionType.HEAD_ON: _lane_keeping,
    CollisionType.CUT_IN: _cut_in,
    CollisionType.REAR_END_STRIKING: _striking,
    CollisionType.REAR_END_STRUCK: _struck,
    CollisionType.SIDE: _lane_keeping,
    CollisionType.OFF_ROAD: lambda *_: OFF_ROAD,
}
