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

from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.collision_type import OPPOSITE_RAD, CollisionType
from advdiff_sumo.metrics.encounter import Encounter, LaneEntry, Party

#: Time a driver needs before braking (s).
RESPONSE_S = 0.75
#: Braking that both sides may be expected to reach (m/s²).
BRAKE_MPS2 = 6.0
#: A vehicle that has stood this long in the way could be seen.
STOOD_S = 1.0
#: At a junction without rule, whoever came this much later gives way.
ARRIVAL_MARGIN_S = 1.0
#: Driving backwards faster than this is reversing.
REVERSING_MPS = 0.1


class AtFault(StrEnum):
    """Who caused the collision."""

    TARGET = "target"
    OTHER = "other"
    UNCLEAR = "unclear"


@dataclass(frozen=True)
class Verdict:
    """Who caused a collision and why.

    Attributes:
        at_fault: who.
        reason: one sentence for people.
    """

    at_fault: AtFault
    reason: str


OFF_ROAD = Verdict(AtFault.TARGET, "The target left the road.")

_Rule = Callable[[EpisodeRecord, RoadMap, Encounter, CollisionType], Verdict | None]


def judge(record: EpisodeRecord, road: RoadMap, met: Encounter, kind: CollisionType) -> Verdict:
    """Return the verdict of the first rule that applies to a collision with another agent."""
    rules: tuple[_Rule, ...] = (_standing, _wrong_way, _reversing, _RULES[kind])
    for rule in rules:
        verdict = rule(record, road, met, kind)
        if verdict is not None:
            return verdict
    return Verdict(AtFault.UNCLEAR, "No rule says which of the two caused it.")


def safe_gap_m(follower_mps: float, leader_mps: float) -> float:
    """Return the gap that lets the follower stop behind a braking leader (RSS, Definition 1).

    v_f ρ + v_f² / 2b − v_l² / 2b, at least 0, with ρ = ``RESPONSE_S`` and b = ``BRAKE_MPS2`` for both and no
    acceleration during the response.
    """
    braking = (follower_mps**2 - leader_mps**2) / (2.0 * BRAKE_MPS2)
    return max(0.0, follower_mps * RESPONSE_S + braking)


def _standing(record: EpisodeRecord, _road: RoadMap, met: Encounter, _kind: CollisionType) -> Verdict | None:
    if met.target.stands and not met.other.stands:
        return Verdict(AtFault.OTHER, f"The target stood still when '{met.other.name}' ran into it.")
    if met.other.stands and not met.target.stands and _stood(record, met):
        return Verdict(AtFault.TARGET, f"The target ran into '{met.other.name}', which was standing.")
    return None


def _stood(record: EpisodeRecord, met: Encounter) -> bool:
    """Return whether the partner has stood for ``STOOD_S``, so that the target could react."""
    tracks, step = record.tracks, met.collision.step
    since = max(0, step - round(STOOD_S / tracks.dt_s))
    speed = tracks.speed_mps[met.other.row, since : step + 1]
    return bool((abs(speed) <= 0.05).all())


def _wrong_way(
    _record: EpisodeRecord, _road: RoadMap, met: Encounter, _kind: CollisionType
) -> Verdict | None:
    if met.other.wrong_way and not met.target.wrong_way:
        return Verdict(AtFault.OTHER, f"'{met.other.name}' drove against the direction of its lane.")
    if met.target.wrong_way and not met.other.wrong_way:
        return Verdict(AtFault.TARGET, "The target drove against the direction of its lane.")
    return None


def _reversing(
    _record: EpisodeRecord, _road: RoadMap, met: Encounter, _kind: CollisionType
) -> Verdict | None:
    other_back, target_back = (p.speed_mps < -REVERSING_MPS for p in (met.other, met.target))
    if other_back and not target_back:
        return Verdict(AtFault.OTHER, f"'{met.other.name}' was reversing.")
    if target_back and not other_back:
        return Verdict(AtFault.TARGET, "The target was reversing.")
    return None


def _striking(_record: EpisodeRecord, _road: RoadMap, met: Encounter, _kind: CollisionType) -> Verdict:
    return Verdict(AtFault.TARGET, f"The target ran into the rear of '{met.other.name}'.")


def _struck(_record: EpisodeRecord, _road: RoadMap, met: Encounter, _kind: CollisionType) -> Verdict:
    return Verdict(AtFault.OTHER, f"'{met.other.name}' ran into the rear of the target.")


def _cut_in(_record: EpisodeRecord, _road: RoadMap, met: Encounter, _kind: CollisionType) -> Verdict | None:
    entry = met.entry
    if entry is None:
        return None
    need = safe_gap_m(entry.follower_mps, entry.leader_mps)
    enough = entry.gap_m >= need
    numbers = f"{entry.gap_m:.1f} m ahead at {entry.time_s:.1f} s, where {need:.1f} m are needed"
    if entry.by_target:
        blame = AtFault.OTHER if enough else AtFault.TARGET
        return Verdict(blame, f"The target entered the lane of '{met.other.name}' {numbers}.")
    blame = AtFault.TARGET if enough else AtFault.OTHER
    return Verdict(blame, f"'{met.other.name}' entered the target's lane {numbers}.")


def _lane_keeping(
    _record: EpisodeRecord, _road: RoadMap, met: Encounter, kind: CollisionType
) -> Verdict | None:
    """Judge side and head-on collisions: whoever left its lane, or entered the other's, is at fault."""
    if met.entry is not None and kind is CollisionType.SIDE:
        return _entered(met, met.entry)
    target, other = met.target.leaves_lane, met.other.leaves_lane
    if other and not target:
        return Verdict(AtFault.OTHER, f"'{met.other.name}' was out of its lane, the target was not.")
    if target and not other:
        return Verdict(AtFault.TARGET, f"The target was out of its lane, '{met.other.name}' was not.")
    if not target and met.collision.heading_difference_rad < OPPOSITE_RAD:
        return _fronts(met)
    return Verdict(AtFault.UNCLEAR, "Both or neither of the two were out of their lanes.")


def _entered(met: Encounter, entry: LaneEntry) -> Verdict:
    if entry.by_target:
        return Verdict(AtFault.TARGET, f"The target moved into the lane of '{met.other.name}' beside it.")
    return Verdict(AtFault.OTHER, f"'{met.other.name}' moved into the target's lane beside it.")


def _fronts(met: Encounter) -> Verdict | None:
    """Judge by the fronts when both were in their lanes: who hit with the front could have braked."""
    target, other = met.target.face == "front", met.other.face == "front"
    if target and not other:
        return Verdict(AtFault.TARGET, f"The target ran into the side of '{met.other.name}' with its front.")
    if other and not target:
        return Verdict(AtFault.OTHER, f"'{met.other.name}' ran into the side of the target with its front.")
    return None


def _junction(record: EpisodeRecord, road: RoadMap, met: Encounter, _kind: CollisionType) -> Verdict | None:
    red = _ran_red(record, met.target), _ran_red(record, met.other)
    if red == (True, False):
        return Verdict(AtFault.TARGET, "The target entered the junction on red.")
    if red == (False, True):
        return Verdict(AtFault.OTHER, f"'{met.other.name}' entered the junction on red.")
    yields = _must_yield(road, met.target, met.other), _must_yield(road, met.other, met.target)
    if yields == (True, False):
        return Verdict(AtFault.TARGET, f"The target had to give way to '{met.other.name}' at the junction.")
    if yields == (False, True):
        return Verdict(AtFault.OTHER, f"'{met.other.name}' had to give way to the target at the junction.")
    return _first_come(record, met)


def _ran_red(record: EpisodeRecord, party: Party) -> bool:
    """Return whether the party entered the junction while its signal had been red for two instants."""
    link, step = party.link, party.entered_step
    if link is None or link.tls_id is None or link.tls_index is None or step is None:
        return False
    states = [s.get(link.tls_id, "") for s in record.signals[max(0, step - 1) : step + 1]]
    return bool(states) and all(len(s) > link.tls_index and s[link.tls_index] in "ru" for s in states)


def _must_yield(road: RoadMap, party: Party, to: Party) -> bool:
    if party.link is None or to.link is None or party.link.junction_id != to.link.junction_id:
        return False
    response = road.junctions[party.link.junction_id].response
    return to.link.request_index in response.get(party.link.request_index, frozenset())


def _first_come(record: EpisodeRecord, met: Encounter) -> Verdict | None:
    """Judge where the net gives neither or both the way, such as all-way stops: the first to come goes."""
    target, other = met.target.entered_step, met.other.entered_step
    if target is None or other is None:
        return None
    later_s = (target - other) * record.tracks.dt_s
    if later_s > ARRIVAL_MARGIN_S:
        return Verdict(
            AtFault.TARGET, f"'{met.other.name}' was on the junction {later_s:.1f} s before the target."
        )
    if later_s < -ARRIVAL_MARGIN_S:
        return Verdict(
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
