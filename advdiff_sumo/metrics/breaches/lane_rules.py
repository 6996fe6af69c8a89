"""Rules about lanes: driving on the right side, and entering the lane of another only with a safe gap."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.metrics.breaches.breach import Breach, BreachKind
from advdiff_sumo.metrics.breaches.junction_rules import breach_towards_pedestrian, signals_are_unknown
from advdiff_sumo.metrics.encounter import WRONG_WAY_RAD, Encounter, Party
from advdiff_sumo.metrics.lane_entry import OPPOSITE_RAD, LaneEntry
from advdiff_sumo.metrics.placement import Placement
from advdiff_sumo.metrics.traffic_view import TrafficView

#: Headings that differ by at most this are the same direction (45°).
SAME_WAY_RAD = 0.7853981633974483
#: A vehicle nearer to the edge of its lane than this is at the edge.
_AT_EDGE_M = 0.2
#: A vehicle that moves sideways at most this fast keeps its lateral position.
_DRIFT_MPS = 0.1


def wrong_side(view: TrafficView, case: Encounter, index: int) -> Breach | None:
    """Return the breach of driving against the lane, or over its edge into oncoming traffic.

    It did not lead to the collision if the other ran into its rear, or came over to its side first. If their ways over
    a junction meet and the other is on it, the rule is giving way instead, since a long vehicle that turns there
    reaches out of its lane.
    """
    party = case.parties[index]
    if party.is_pedestrian or party.stands or case.is_run_into(index):
        return None
    at, entry = case.collision.step - case.start, case.entry
    if party.wrong_way:
        return _breach(view, case, BreachKind.WRONG_SIDE, party, "drove against the direction of its lane")
    if entry is not None and entry.oncoming and entry.row != party.row:
        return None
    facing = case.collision.heading_difference_rad > OPPOSITE_RAD and not case.crossing
    reaches_over = facing and party.leaves_lane and party.intrudes
    enters = entry is not None and entry.oncoming and entry.row == party.row and entry.leaves_lane
    turns_across = case.crossing and case.ways_meet and case.parties[1 - index].drove_link
    entered = enters and not turns_across
    if reaches_over or entered or on_opposite_lane(view, party.row, party.lanes, at, case.start):
        return _breach(view, case, BreachKind.WRONG_SIDE, party, "was on the wrong side of the road")
    return None


def on_opposite_lane(view: TrafficView, row: int, lanes: Placement, at: int, start: int) -> bool:
    """Return whether the centre of agent *row* is out of its lane and on one of the opposite direction.

    Args:
        view: the traffic.
        row: row of the agent.
        lanes: its lanes.
        at: instant in *lanes*.
        start: first instant of *lanes*.
    """
    if lanes.lane[at] is not None and abs(lanes.d_m[at]) <= lanes.half_width_m[at]:
        return False
    xy, yaw = view.tracks.xy_m[row, start + at], float(view.tracks.yaw_rad[row, start + at])
    nearest = view.road.locate(xy, internal=False)
    if nearest is None or abs(nearest.d_m) > 0.5 * view.road.lanes[nearest.lane_id].width_m:
        return False
    _, lane_yaw = view.road.to_world(nearest.lane_id, nearest.s_m)
    return bool(abs(wrap_angle(yaw - lane_yaw)) > WRONG_WAY_RAD)


def lane_entry_breach(view: TrafficView, case: Encounter, index: int) -> Breach | None:
    """Return the breach of entering the lane of the other with less than the safe gap, or of moving sideways into it.

    An entry after which the gap became safe again did not lead to the collision. The rule is giving way instead if ways
    from different approaches cross or join, or if the party is a pedestrian with the right of way.
    """
    party, entry = case.parties[index], case.entry
    if party.stood or entry is None or entry.row != party.row:
        return sideways_breach(view, case, index)
    if case.crossing or entry.oncoming or not (entry.leaves_lane or party.is_pedestrian):
        return None
    if entry.safe or entry.recovered or breach_towards_pedestrian(view, case, index) is not None:
        return None
    if party.is_pedestrian and signals_are_unknown(view, case):
        return None
    other = case.parties[1 - index]
    lane = "lane" if other.is_pedestrian else f"lane of '{other.name}'"
    return unsafe_entry_breach(entry, lane, "walked" if party.is_pedestrian else "moved sideways")


def unsafe_entry_breach(entry: LaneEntry, lane: str, moved: str = "moved sideways") -> Breach:
    """Return the breach of *entry* into *lane* ("lane of 'x'"); *moved* is what it did if it was beside the other."""
    if entry.gap_m < 0.0:
        return Breach(BreachKind.SIDEWAYS, entry.row, entry.time_s, f"{moved} into the {lane}, beside it")
    gaps = f"{entry.gap_m:.1f} m ahead ({entry.needed_m:.1f} m are needed)"
    return Breach(BreachKind.UNSAFE_LANE_ENTRY, entry.row, entry.time_s, f"entered the {lane} {gaps}")


def sideways_breach(view: TrafficView, case: Encounter, index: int) -> Breach | None:
    """Return the breach of moving sideways into a vehicle beside, if neither entered the other's lane."""
    party, other = case.parties[index], case.parties[1 - index]
    if case.entry is not None or case.crossing or party.is_pedestrian or party.stands:
        return None
    end_to_end = {"front", "rear"} >= {party.face, other.face}
    if case.collision.heading_difference_rad > SAME_WAY_RAD or end_to_end:
        return None
    keeps_lane = not (party.overhang_m > -_AT_EDGE_M or party.changed_lane)
    if (keeps_lane and not _abreast(party, other)) or sideways_mps(view, case, index) <= _DRIFT_MPS:
        return None
    return _breach(view, case, BreachKind.SIDEWAYS, party, f"moved sideways into '{other.name}'")


def _abreast(party: Party, other: Party) -> bool:
    """Return whether the two touched side by side within one lane, as when a car passes a bicycle there."""
    sides = {"left", "right"} >= {party.face, other.face}
    return sides and party.lanes.lane[-1] == other.lanes.lane[-1]


def sideways_mps(view: TrafficView, case: Encounter, index: int) -> float:
    """Return the speed of the party across its lane towards the other; 0 off any lane."""
    party, collision = case.parties[index], case.collision
    if party.lanes.lane[-1] is None:
        return 0.0
    step = collision.step
    lane_yaw = float(view.tracks.yaw_rad[party.row, step]) - float(party.lanes.yaw_error_rad[-1])
    left = np.array((-np.sin(lane_yaw), np.cos(lane_yaw)))
    side = np.sign(float((collision.xy_m[1 - index] - collision.xy_m[index]) @ left))
    return float(side * (collision.velocity_mps[index] @ left))


def _breach(view: TrafficView, case: Encounter, kind: BreachKind, party: Party, text: str) -> Breach:
    return Breach(kind, party.row, view.time_s(case.collision.step), text)
