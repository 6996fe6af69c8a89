"""Manoeuvres that vehicles around the target could drive: such as people drive, and no rule forbids.

Each function proposes manoeuvres for one vehicle. ``licence_rules`` judges whether a proposal is lawful in the scene,
``required_braking`` which braking it requires of the target.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from advdiff_sumo.core.scene import HEAVY_CLASSES
from advdiff_sumo.maps.lanes import Link, edge_of_lane
from advdiff_sumo.metrics.safe_gap import safe_gap_m
from advdiff_sumo.traffic.licence import LAWFUL
from advdiff_sumo.traffic.manoeuvres.manoeuvre import LATERAL_MPS, Manoeuvre
from advdiff_sumo.traffic.manoeuvres.required_braking import TargetWay
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import SpeedProfile
from advdiff_sumo.traffic.manoeuvres.ways import Way

DOUBLE = "double"
"""The kind of a leader that stops while other vehicles are nearer, see ``hidden_stop``."""
STOPPING_KINDS = ("hard-stop", "blocked-lane", DOUBLE)
"""Kinds that end with a stop in the lane."""
ENDS_STANDING = (*STOPPING_KINDS, "cut-in")
"""Kinds after which the attacker may stand in the target's lane."""
CLOSE_PASSING = "close-pass"
"""The kind of a vehicle that passes on the lane beside, see ``close_pass``."""
BLIND_SPOT = "blind-spot"
"""The kind of a vehicle that stays beside and a little behind the target, see ``blind_spot``."""
BESIDE_KINDS = (CLOSE_PASSING, BLIND_SPOT)
"""Kinds on the lane beside, which demand nothing of a target that keeps its lane."""
SLOW_MERGE, PULL_OUT = "slow-merge", "pull-out"
SLOW_ENTRIES = (SLOW_MERGE, PULL_OUT)
"""Kinds that enter the target's lane at much less than its speed, and drive on; see ``slow_entries``."""
MAX_DEMAND_MPS2: Mapping[str, float] = {SLOW_MERGE: 5.0, PULL_OUT: 4.0}
"""Highest required deceleration: with more a careful driver, whose braking takes time to build up, may be late."""
HARD_BRAKING_MPS2 = (4.5, 6.0, 7.5, 8.5)
"""Decelerations of a leader that brakes for something that only it sees."""
HEAVY_MAX_BRAKING_MPS2 = 7.0
"""Hardest braking of lorries and buses, SUMO's default ``emergencyDecel`` of trucks."""
GENTLE_BRAKING_MPS2 = (2.0, 3.0)
"""Decelerations of a vehicle that stops in its lane as at a kerb."""
AFTER_CUT_IN_MPS2 = (2.0, 3.5, 5.0, 6.5, 8.0)
"""Decelerations of a vehicle that has changed lanes and comes to a queue."""
CROSSING_ACCELS_MPS2 = (2.0, 1.0, 0.0, -1.0, -2.0)
"""Accelerations by which a vehicle with priority adjusts its arrival; of equal merit, the earliest arrival is taken."""
_REVEALS_S = (2.0, 2.5, 3.0, 3.5, 4.0)  # times before a leader would reach the vehicle that it hides
_REVEALED_WITHIN_M, _MIN_CLOSING_MPS = 90.0, 12.0
"""Farthest distance of that vehicle from the leader; by how much it is slower unless it stands."""
_MAX_DELAY_S = 3.0
STANDING_BELOW_MPS = 0.5
"""A slower vehicle counts as standing: others need not expect it to move on."""
_ACCEL_DURATIONS_S = (1.5, 3.0)
_HESITATION_MPS2, _GO_MPS2 = (1.0, 2.0, 3.0), 2.5
_HESITATION_S = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.25, 2.5, 3.0)
"""A vehicle at a green light slows as if to stop, for so long, and then goes."""
IN_LANE_SHARE = 0.8
"""Share of the time of a lane change after which the vehicle changes speed: a tenth of the lateral distance is left."""
_CRAWL_SHARE, _STOP_FROM_MPS2 = 0.3, 3.0
"""A vehicle that brakes harder than this after a cut-in stops; others slow to this share of the target's speed."""
IN_LANE_M, BESIDE_M = 1.2, 5.5
"""Lateral offset up to which a vehicle is on a way; and up to which it is on the lane beside."""
BEHIND_M, AHEAD_M, MIN_HEADING_COSINE = -10.0, 55.0, 0.9
"""Range ahead of the target within which a vehicle is beside it; least cosine of headings in the same direction."""
_CROSSING_M = 60.0  # junctions farther away than this are ignored
LEADER_RANGE_M = 68.0
"""Distance within which a vehicle leads the target: at 40 m/s 1.5 s ahead."""
_NOWHERE = (np.inf, np.inf)
_MIN_SPEED_MPS = 2.0
MIN_STOPPING_SPEED_MPS = 5.0
"""Only a faster vehicle can be made to stop."""
_CROSSING_SPEED_SHARE = 0.45
"""Share of the limit below which a vehicle with priority does not slow."""
_SPARE_M, _CLOSING_PER_S = 2.0, 0.6
"""Spare gap to cut in; speed difference per metre of gap that is missing."""
_LEAD_SPEED_SHARE, _LEAD_CLOSING_PER_S = 0.75, 0.4
"""Share of the target's speed at which a leader lets it close up; speed difference per metre of gap."""
HEADWAY_S, _STANDING_GAP_M = 1.5, 2.0
"""Headway that a leader keeps, as people do; and the gap on top of it."""
_LEAD_BRAKING_MPS2, _LEAD_ACCEL_MPS2 = 1.0, 2.0


def hard_stop(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """Yield hard stops of the target's leader, and leading at a steady gap until one begins."""
    yield from _stops(view, row, "hard-stop", HARD_BRAKING_MPS2)
    if view.target is not None and leads(view, row) and view.is_clear_to(view.on_target_way[row][0]):
        steady = steady_lead_profile(view, view.target, row)
        yield Manoeuvre("hard-stop", row, view.ways[row], steady, is_positioning=True)


def steady_lead_profile(view: SituationView, target: TargetWay, row: int) -> SpeedProfile:
    """Return the speed with which *row* leads the target at the headway that people keep, or gently gets there."""
    limit, speed = view.ways[row].lane.speed_mps, view.speed(row)
    gap = view.gap_m(view.on_target_way[row][0], row, view.scene.target)
    excess_m = gap - (HEADWAY_S * target.speed_mps + _STANDING_GAP_M)
    slowest = min(max(_LEAD_SPEED_SHARE * target.speed_mps, MIN_STOPPING_SPEED_MPS + 1.0), limit)
    wish = float(np.clip(target.speed_mps - _LEAD_CLOSING_PER_S * excess_m, slowest, limit))
    lowest = min(slowest, speed)
    return SpeedProfile.adapting(wish, speed, _LEAD_BRAKING_MPS2, _LEAD_ACCEL_MPS2, lowest, limit)


def blocked_lane(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """Yield gentle stops of a vehicle well ahead in the target's lane, which then stays."""
    yield from _stops(view, row, "blocked-lane", GENTLE_BRAKING_MPS2)


def stop_and_go(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """Yield manoeuvres of the target's leader that slows to walking speed and accelerates again."""
    for braking in HARD_BRAKING_MPS2[:2]:
        if leads(view, row):
            slowing = SpeedProfile(-braking, 2.5, 1.5, 1.0, view.ways[row].lane.speed_mps)
            yield Manoeuvre("stop-and-go", row, view.ways[row], slowing)


def cut_in(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """Yield cut-ins of a vehicle ahead on the next lane, which then slows; and getting into position for them."""
    target = view.target
    if target is None or not _is_beside(view, row) or view.speed(row) < _MIN_SPEED_MPS:
        return
    goal = way_on_target_lane(view, row)
    if goal is None:
        return
    way, limit = view.ways[row], view.ways[row].lane.speed_mps
    change_s = abs(view.on_target_way[row][1]) / LATERAL_MPS
    for braking in _possible_braking(view, row, AFTER_CUT_IN_MPS2):
        lowest = _CRAWL_SHARE * target.speed_mps if braking < _STOP_FROM_MPS2 else 0.0
        profile = SpeedProfile(0.0, IN_LANE_SHARE * change_s, -braking, lowest, limit)
        yield Manoeuvre("cut-in", row, way, profile, goal)
    yield Manoeuvre("cut-in", row, way, positioning_profile(view, target, row), is_positioning=True)


def positioning_profile(
    view: SituationView, target: TargetWay, row: int, spare_gap_m: float = 0.0
) -> SpeedProfile:
    """Return the speed that brings *row* to where it may just enter the target's lane, with *spare_gap_m* more."""
    limit, speed = view.ways[row].lane.speed_mps, view.speed(row)
    safe_m = safe_gap_m(target.speed_mps + 0.5, min(target.speed_mps, limit))
    wanted_m = LAWFUL.gap_share * safe_m + LAWFUL.spare_m + _SPARE_M + spare_gap_m
    half_lengths_m = 0.5 * float(view.size(row)[0] + target.size_m[0])
    missing_m = wanted_m - (view.on_target_way[row][0] - half_lengths_m)
    wish = float(np.clip(target.speed_mps + _CLOSING_PER_S * missing_m, 0.6 * target.speed_mps, limit))
    return SpeedProfile.adapting(wish, speed, 2.0, 2.0, _MIN_SPEED_MPS, limit)


def crossing(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """Yield manoeuvres of a vehicle with priority that crosses the target's way when the target gets there."""
    links = crossing_links(view, row)
    target = view.target
    if links is None or target is None or view.speed(row) < _MIN_SPEED_MPS:
        return
    line_m = next((line_m for line_m, link in target.way.links if link is links[1]), None)
    # not if the target is on the junction already, or waits behind another vehicle
    if line_m is not None and view.is_clear_on_arrival(line_m):
        yield from _timed_crossings(view, row, links[1])


def continued_crossings(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """Yield how a crossing goes on: without acceleration while the target, on the junction, is before the vehicle."""
    links = crossing_links(view, row)
    if links is None:
        return
    is_on_junction = links[1] is view.target_link
    for manoeuvre in _timed_crossings(view, row, links[1]):
        accelerates = manoeuvre.profile.first_mps2 > 0.0 or manoeuvre.profile.then_mps2 > 0.0
        if not (is_on_junction and accelerates) or view.is_red(links[1]):
            yield manoeuvre


def _timed_crossings(view: SituationView, row: int, target_link: Link) -> Iterator[Manoeuvre]:
    """Yield the speeds at which *row* may cross; if the target has a red light, it may first look as if it stopped."""
    way = view.ways[row]
    limit = way.lane.speed_mps
    for accel in CROSSING_ACCELS_MPS2:
        for duration_s in _ACCEL_DURATIONS_S if accel else _ACCEL_DURATIONS_S[:1]:
            slowest = _MIN_SPEED_MPS if view.is_red(target_link) else _CROSSING_SPEED_SHARE * limit
            timed = SpeedProfile(accel, duration_s, 0.0, slowest, limit)
            yield Manoeuvre("crossing", row, way, timed)
    for braking in _HESITATION_MPS2 if view.is_red(target_link) else ():
        for duration_s in _HESITATION_S:
            hesitant = SpeedProfile(-braking, duration_s, _GO_MPS2, _MIN_SPEED_MPS, limit)
            yield Manoeuvre("crossing", row, way, hesitant)


def cut_out(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """Yield late lane changes of the target's leader that reveal a standing or much slower vehicle."""
    yield from cut_out_at(view, row, _REVEALS_S)


def cut_out_at(view: SituationView, row: int, reveals_s: Sequence[float]) -> Iterator[Manoeuvre]:
    """Yield each :func:`cut_out` that begins soon, *reveals_s* before *row* would reach the hidden vehicle."""
    hidden = _hidden_ahead(view, row) if leads(view, row) else None
    if hidden is None or view.speed(row) < _MIN_SPEED_MPS:
        return
    other, gap_m = hidden
    closing_mps = view.speed(row) - (view.speed(other) if view.speed(other) > STANDING_BELOW_MPS else 0.0)
    for side in ("left", "right"):
        goal = view.neighbour_way(row, side)
        for time_s in reveals_s if goal is not None else ():
            delay_s = gap_m / closing_mps - time_s
            if 0.0 <= delay_s <= _MAX_DELAY_S:
                yield Manoeuvre(
                    "cut-out", row, view.ways[row], SpeedProfile(), goal, delay_s=delay_s, revealed_row=other
                )


KINDS: Mapping[str, Callable[[SituationView, int], Iterator[Manoeuvre]]] = {
    "hard-stop": hard_stop,
    "cut-in": cut_in,
    "crossing": crossing,
    "blocked-lane": blocked_lane,
    "stop-and-go": stop_and_go,
    "cut-out": cut_out,
}
"""Every kind of manoeuvre by name."""


def crossing_links(view: SituationView, row: int) -> tuple[Link, Link] | None:
    """Return the links of *row* and of the target at the first junction where their ways conflict, else None.

    A junction that the target is on counts; one that *row* is on does not.
    """
    target = view.target
    if target is None:
        return None
    target_links = {
        link.junction_id: link for line_m, link in reversed(target.way.links) if line_m < _CROSSING_M
    }
    if view.target_link is not None:
        target_links[view.target_link.junction_id] = view.target_link
    for line_m, link in view.ways[row].links:
        other = target_links.get(link.junction_id)
        if other is None or line_m > _CROSSING_M or link is other:
            continue
        foes = view.road.junctions[link.junction_id].foes.get(link.request_index, frozenset())
        from_edge, other_edge = edge_of_lane(link.from_lane), edge_of_lane(other.from_lane)
        if other.request_index in foes and from_edge != other_edge:
            return link, other
    return None


def _stops(view: SituationView, row: int, kind: str, braking_mps2: tuple[float, ...]) -> Iterator[Manoeuvre]:
    """Yield stops of *row* with each of *braking_mps2*, if it leads the target and is fast enough."""
    if leads(view, row) and view.speed(row) > MIN_STOPPING_SPEED_MPS:
        for braking in _possible_braking(view, row, braking_mps2):
            yield Manoeuvre(kind, row, view.ways[row], SpeedProfile(then_mps2=-braking))


def _possible_braking(view: SituationView, row: int, braking_mps2: Sequence[float]) -> list[float]:
    """Return *braking_mps2*, limited to what the class of *row* can do, each value once."""
    is_heavy = view.scene.history.classes[row] in HEAVY_CLASSES
    return list(dict.fromkeys(min(b, HEAVY_MAX_BRAKING_MPS2) if is_heavy else b for b in braking_mps2))


def leads(view: SituationView, row: int) -> bool:
    """Return whether *row* is ahead in the target's lane, on the target's way."""
    target = view.target
    if target is None:
        return False
    ahead, left = view.on_target_way[row]
    way_yaw = target.way.line.at(target.way.lane.s_m + ahead)[1]
    cosine = np.cos(view.scene.history.yaw_rad[row, -1] - way_yaw)
    return bool(0.0 < ahead < LEADER_RANGE_M and abs(left) < IN_LANE_M and cosine > MIN_HEADING_COSINE)


def _is_beside(view: SituationView, row: int) -> bool:
    ahead, left = view.on_target_way.get(row, _NOWHERE)
    return BEHIND_M < ahead < AHEAD_M and IN_LANE_M < abs(left) < BESIDE_M


def way_on_target_lane(view: SituationView, row: int) -> Way | None:
    """Return the way of *row* on a neighbouring lane that lies on the target's way; None if there is none."""
    target = view.target
    target_lanes = {lane.id for lane in target.way.lane.lanes} if target is not None else set()
    for side in ("left", "right"):
        goal = view.neighbour_way(row, side)
        if goal is not None and goal.present_lane.id in target_lanes:
            return goal
    return None


def _hidden_ahead(view: SituationView, row: int) -> tuple[int, float] | None:
    """Return the next vehicle on the way of *row*, and the bumper gap to it; None if it is not much slower."""
    positions = ((other, *view.position_on(view.ways[row], other)) for other in view.ways if other != row)
    ahead = [(s, other) for other, s, left in positions if s > 0.0 and abs(left) < IN_LANE_M]
    distance_m, other = min(ahead, default=(np.inf, row))
    if distance_m > _REVEALED_WITHIN_M or other == view.scene.target:
        return None
    is_slow = view.speed(row) - view.speed(other) >= _MIN_CLOSING_MPS
    if view.speed(other) > STANDING_BELOW_MPS and not is_slow:
        return None
    return other, view.gap_m(distance_m, row, other)
