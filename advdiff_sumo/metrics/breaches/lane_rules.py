"""Rules of lanes: on the right side and way, and entering the lane of another only with room."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.metrics.breaches.breach import Breach, BreachKind
from advdiff_sumo.metrics.breaches.junction_rules import disregarded, way_is_unknown
from advdiff_sumo.metrics.encounter import WRONG_WAY_RAD, Encounter, Party, ways_meet
from advdiff_sumo.metrics.lane_entry import OPPOSITE_RAD
from advdiff_sumo.metrics.placement import Placement
from advdiff_sumo.metrics.traffic_view import TrafficView

#: Headings that differ by less than this go the same way (45°).
SAME_WAY_RAD = 0.7853981633974483
#: Nearer to the edge of its lane than this, a vehicle that moves sideways has used its lane up.
_AT_EDGE_M = 0.2
#: Moving sideways slower than this is keeping to the lane's middle.
_DRIFT_MPS = 0.1


def wrong_side(view: TrafficView, met: Encounter, which: int) -> Breach | None:
    """Return the breach of driving against the lane, or over its edge into oncoming traffic.

    It concerns the collision unless the other ran into its rear, or came over to its side first. Where their ways over
    a junction meet, giving way is the rule: a long vehicle that turns there reaches out of its lane.
    """
    party = met.parties[which]
    if party.is_pedestrian or party.stands or met.is_run_into(which):
        return None
    step, entry = met.collision.step, met.entry
    if party.wrong_way:
        return _breach(view, met, BreachKind.WRONG_SIDE, party, "drove against the direction of its lane")
    if entry is not None and entry.oncoming and entry.row != party.row:
        return None
    opposed = met.collision.heading_difference_rad > OPPOSITE_RAD and not met.crossing
    over = opposed and party.leaves_lane and party.intrudes
    comes_over = entry is not None and entry.oncoming and entry.row == party.row and entry.leaves_lane
    entered = comes_over and not _ways_meet(view, met)
    if over or entered or on_opposite_lane(view, party.row, party.lanes, step - met.start, met.start):
        return _breach(view, met, BreachKind.WRONG_SIDE, party, "was on the wrong side of the road")
    return None


def _ways_meet(view: TrafficView, met: Encounter) -> bool:
    """Return whether the ways of the two over a common junction cross or join in the net."""
    first, second = (party.link for party in met.parties)
    return met.crossing and first is not None and second is not None and ways_meet(view.road, first, second)


def on_opposite_lane(view: TrafficView, row: int, lanes: Placement, at: int, start: int) -> bool:
    """Return whether the centre of *row* is out of its lane and on one of the opposite direction.

    Args:
        view: the traffic.
        row: of whom.
        lanes: its lanes.
        at: instant of them.
        start: their first instant.
    """
    if lanes.lane[at] is not None and abs(lanes.d_m[at]) <= lanes.half_width_m[at]:
        return False
    xy, yaw = view.tracks.xy_m[row, start + at], float(view.tracks.yaw_rad[row, start + at])
    nearest = view.road.locate(xy, internal=False)
    if nearest is None or abs(nearest.d_m) > 0.5 * view.road.lanes[nearest.lane_id].width_m:
        return False
    _, lane_yaw = view.road.to_world(nearest.lane_id, nearest.s_m)
    return bool(abs(wrap_angle(yaw - lane_yaw)) > WRONG_WAY_RAD)


def lane_entry_breach(view: TrafficView, met: Encounter, which: int) -> Breach | None:
    """Return the breach of entering the lane of the other with less than the safe gap, or sideways into it.

    An entry after which the gap was a safe one again did not lead to the collision. Where ways of different
    approaches cross or join, giving way is the rule instead, and also where somebody who walks had the way.
    """
    party, entry = met.parties[which], met.entry
    if party.stood or entry is None or entry.row != party.row:
        return _sideways(view, met, which)
    if met.crossing or entry.oncoming or not (entry.leaves_lane or party.is_pedestrian):
        return None
    if entry.safe or entry.recovered or disregarded(view, met, which) is not None:
        return None
    if party.is_pedestrian and way_is_unknown(view, met):
        return None
    whose = "lane" if met.parties[1 - which].is_pedestrian else f"lane of '{met.parties[1 - which].name}'"
    if entry.gap_m < 0.0:
        return Breach(BreachKind.SIDEWAYS, party.row, entry.time_s, f"moved sideways into the {whose}")
    numbers = f"{entry.gap_m:.1f} m ahead, where {entry.needed_m:.1f} m are needed"
    return Breach(BreachKind.UNSAFE_LANE_ENTRY, party.row, entry.time_s, f"entered the {whose} {numbers}")


def _sideways(view: TrafficView, met: Encounter, which: int) -> Breach | None:
    """Return the breach of moving sideways into another that goes the same way and does not keep its lane either."""
    party, other = met.parties[which], met.parties[1 - which]
    if met.entry is not None or met.crossing or party.is_pedestrian or party.stands:
        return None
    if met.collision.heading_difference_rad > SAME_WAY_RAD or {"front", "rear"} >= {party.face, other.face}:
        return None
    if (
        not (party.overhang_m > -_AT_EDGE_M or party.changed_lane)
        or sideways_mps(view, met, which) <= _DRIFT_MPS
    ):
        return None
    return _breach(view, met, BreachKind.SIDEWAYS, party, f"moved sideways into '{other.name}'")


def sideways_mps(view: TrafficView, met: Encounter, which: int) -> float:
    """Return how fast the party moves across its lane towards the other; 0 off any lane."""
    party, collision = met.parties[which], met.collision
    if party.lanes.lane[-1] is None:
        return 0.0
    step = collision.step
    lane_yaw = float(view.tracks.yaw_rad[party.row, step]) - float(party.lanes.yaw_error_rad[-1])
    left = np.array((-np.sin(lane_yaw), np.cos(lane_yaw)))
    towards = np.sign(float((collision.xy_m[1 - which] - collision.xy_m[which]) @ left))
    return float(towards * (collision.velocity_mps[which] @ left))


def _breach(view: TrafficView, met: Encounter, kind: BreachKind, party: Party, text: str) -> Breach:
    return Breach(kind, party.row, view.time_s(met.collision.step), text)
