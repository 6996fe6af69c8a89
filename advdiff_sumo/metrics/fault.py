"""Who caused a collision, by stated rules.

The classes follow nuPlan's at-fault metric (Karnchanachari et al. 2024, "Towards learning-based planning: the
nuPlan benchmark", arXiv:2403.04133): a vehicle that stands is not at fault, one that runs into another with its
front is, one that is hit from behind is not, and one that is hit at the side is when it was out of its lane.
Added here: cut-ins judged by the gap they leave (Shalev-Shwartz, Shammah and Shashua 2017, "On a formal model of
safe and scalable self-driving cars", arXiv:1708.06374, Definition 1), precedence at junctions by the net's own
right-of-way rows, red lights, and the wrong way. The rules stand in ``docs/metrics.md``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from advdiff_sumo.metrics.breaches.conduct_rules import reversing
from advdiff_sumo.metrics.breaches.junction_rules import (
    ARRIVAL_MARGIN_S,
    disregarded,
    joined_safely,
    later_by_s,
    must_yield,
    ran_red,
    way_is_unknown,
)
from advdiff_sumo.metrics.breaches.striking_rules import pushed_by
from advdiff_sumo.metrics.collision_type import CollisionType
from advdiff_sumo.metrics.encounter import Encounter, Party
from advdiff_sumo.metrics.lane_entry import LaneEntry
from advdiff_sumo.metrics.traffic_view import TrafficView


class AtFault(StrEnum):
    """Who caused the collision."""

    TARGET = "target"
    OTHER = "other"
    UNCLEAR = "unclear"


@dataclass(frozen=True)
class Fault:
    """Who caused a collision and why.

    Attributes:
        at_fault: who.
        reason: one sentence for people.
    """

    at_fault: AtFault
    reason: str


OFF_ROAD = Fault(AtFault.TARGET, "The target left the road.")
_NOT_KNOWN = Fault(AtFault.UNCLEAR, "What the light there showed is not recorded.")

_Rule = Callable[[TrafficView, Encounter, CollisionType], Fault | None]


def fault_of(view: TrafficView, met: Encounter, kind: CollisionType) -> Fault:
    """Return what the first rule that applies says of a collision with another agent."""
    rules: tuple[_Rule, ...] = (_pushed, _standing, _wrong_way, _reversing, _on_foot, _RULES[kind])
    for rule in rules:
        fault = rule(view, met, kind)
        if fault is not None:
            return fault
    return Fault(AtFault.UNCLEAR, "No rule says which of the two caused it.")


def _pushed(view: TrafficView, met: Encounter, _kind: CollisionType) -> Fault | None:
    third = pushed_by(view, met, 0)
    if third is None or met.target.face != "front":
        return None
    return Fault(AtFault.OTHER, f"'{view.tracks.ids[third]}' had run into the target before.")


def _standing(_view: TrafficView, met: Encounter, _kind: CollisionType) -> Fault | None:
    if met.target.stands and not met.other.stands:
        return Fault(AtFault.OTHER, f"The target stood still when '{met.other.name}' ran into it.")
    if met.other.stood and not met.target.stands:
        return Fault(AtFault.TARGET, f"The target ran into '{met.other.name}', which was standing.")
    return None


def _wrong_way(_view: TrafficView, met: Encounter, _kind: CollisionType) -> Fault | None:
    if met.other.wrong_way and not met.target.wrong_way:
        return Fault(AtFault.OTHER, f"'{met.other.name}' drove against the direction of its lane.")
    if met.target.wrong_way and not met.other.wrong_way:
        return Fault(AtFault.TARGET, "The target drove against the direction of its lane.")
    return None


def _reversing(view: TrafficView, met: Encounter, _kind: CollisionType) -> Fault | None:
    target_back, other_back = (reversing(view, met, which) is not None for which in (0, 1))
    if other_back and not target_back:
        return Fault(AtFault.OTHER, f"'{met.other.name}' was reversing.")
    if target_back and not other_back:
        return Fault(AtFault.TARGET, "The target was reversing.")
    return None


def _on_foot(view: TrafficView, met: Encounter, _kind: CollisionType) -> Fault | None:
    """Judge contacts with somebody who walks by how the vehicle came there, before any rule of lanes."""
    by_target, by_other = disregarded(view, met, 1), disregarded(view, met, 0)
    if by_target is not None:
        return Fault(AtFault.TARGET, f"The target {by_target.text}.")
    if by_other is not None:
        return Fault(AtFault.OTHER, f"'{met.other.name}' {by_other.text}.")
    walks = any(party.is_pedestrian for party in met.parties)
    return _NOT_KNOWN if walks and way_is_unknown(view, met) else None


def _striking(view: TrafficView, met: Encounter, kind: CollisionType) -> Fault:
    rear_end = Fault(AtFault.TARGET, f"The target ran into the rear of '{met.other.name}'.")
    return _joined_unsafely(view, met, kind, met.other) or rear_end


def _struck(view: TrafficView, met: Encounter, kind: CollisionType) -> Fault:
    rear_end = Fault(AtFault.OTHER, f"'{met.other.name}' ran into the rear of the target.")
    return _joined_unsafely(view, met, kind, met.target) or rear_end


def _joined_unsafely(view: TrafficView, met: Encounter, kind: CollisionType, struck: Party) -> Fault | None:
    """Judge a rear end just beyond a junction as one on it, where the one ahead joined without the safe gap."""
    entry = met.cut_in
    if met.merged is None or entry is None or entry.row != struck.row or entry.safe or entry.recovered:
        return None
    return _junction(view, met, kind)


def _cut_in(_view: TrafficView, met: Encounter, _kind: CollisionType) -> Fault | None:
    return None if met.cut_in is None else _by_gap(met, met.cut_in)


def _by_gap(met: Encounter, entry: LaneEntry) -> Fault:
    numbers = f"{entry.gap_m:.1f} m ahead at {entry.time_s:.1f} s, where {entry.needed_m:.1f} m are needed"
    if entry.row == met.target.row:
        blame = AtFault.OTHER if entry.safe else AtFault.TARGET
        return Fault(blame, f"The target entered the lane of '{met.other.name}' {numbers}.")
    blame = AtFault.TARGET if entry.safe else AtFault.OTHER
    return Fault(blame, f"'{met.other.name}' entered the target's lane {numbers}.")


def _lane_keeping(_view: TrafficView, met: Encounter, kind: CollisionType) -> Fault | None:
    """Judge side and head-on collisions: whoever left its lane, or entered the other's, is at fault."""
    if met.cut_in is not None and not met.crossing:
        return _entered(met, met.cut_in, kind)
    target, other = met.target.leaves_lane, met.other.leaves_lane
    if other and not target:
        return Fault(AtFault.OTHER, f"'{met.other.name}' was out of its lane, the target was not.")
    if target and not other:
        return Fault(AtFault.TARGET, f"The target was out of its lane, '{met.other.name}' was not.")
    if kind is CollisionType.SIDE:
        return _fronts(met)
    return Fault(AtFault.UNCLEAR, "Both or neither of the two were out of their lanes.")


def _entered(met: Encounter, entry: LaneEntry, kind: CollisionType) -> Fault | None:
    if entry.gap_m >= 0.0 and not entry.oncoming and kind is not CollisionType.HEAD_ON:
        return _by_gap(met, entry)
    where = "of oncoming traffic" if entry.oncoming else "beside it"
    if entry.row == met.target.row:
        return Fault(AtFault.TARGET, f"The target moved into the lane of '{met.other.name}' {where}.")
    return Fault(AtFault.OTHER, f"'{met.other.name}' moved into the target's lane {where}.")


def _fronts(met: Encounter) -> Fault | None:
    """Judge by the fronts when both or neither left their lanes: who hit with the front could have braked."""
    target, other = met.target.face == "front", met.other.face == "front"
    if target and not other:
        return Fault(AtFault.TARGET, f"The target ran into the side of '{met.other.name}' with its front.")
    if other and not target:
        return Fault(AtFault.OTHER, f"'{met.other.name}' ran into the side of the target with its front.")
    return None


def _junction(view: TrafficView, met: Encounter, _kind: CollisionType) -> Fault | None:
    red = ran_red(view, met.target), ran_red(view, met.other)
    if red == (True, False):
        return Fault(AtFault.TARGET, "The target entered the junction on red.")
    if red == (False, True):
        return Fault(AtFault.OTHER, f"'{met.other.name}' entered the junction on red.")
    if red == (True, True):
        return Fault(AtFault.UNCLEAR, f"The target and '{met.other.name}' both entered the junction on red.")
    rear_end = _joined(met)
    if rear_end is not None:
        return rear_end
    if way_is_unknown(view, met):
        return _NOT_KNOWN
    yields = must_yield(view, met.target, met.other), must_yield(view, met.other, met.target)
    if yields == (True, False):
        return Fault(AtFault.TARGET, f"The target had to give way to '{met.other.name}' at the junction.")
    if yields == (False, True):
        return Fault(AtFault.OTHER, f"'{met.other.name}' had to give way to the target at the junction.")
    return _first_come(view, met)


def _joined(met: Encounter) -> Fault | None:
    """Judge front against rear where two ways join: who joined with a safe gap is a leader like any other."""
    if joined_safely(met, 1):
        return Fault(AtFault.TARGET, f"The target ran into the rear of '{met.other.name}'.")
    if joined_safely(met, 0):
        return Fault(AtFault.OTHER, f"'{met.other.name}' ran into the rear of the target.")
    return None


def _first_come(view: TrafficView, met: Encounter) -> Fault | None:
    """Judge where the net gives neither or both the way, such as all-way stops: the first to come goes."""
    later_s = later_by_s(view, met)
    if later_s is None:
        return None
    if later_s > ARRIVAL_MARGIN_S:
        return Fault(
            AtFault.TARGET, f"'{met.other.name}' was on the junction {later_s:.1f} s before the target."
        )
    if later_s < -ARRIVAL_MARGIN_S:
        return Fault(
            AtFault.OTHER, f"The target was on the junction {-later_s:.1f} s before '{met.other.name}'."
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
