"""What vehicles around the target could do: manoeuvres that people drive and no rule forbids.

Each function proposes for one vehicle; whether a proposal is lawful in this scene is judged in ``licence_rules``,
what it demands of the target in ``answers``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from advdiff_sumo.core.scene import HEAVY_CLASSES
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.metrics.safe_gap import safe_gap_m
from advdiff_sumo.traffic.licence import LAWFUL
from advdiff_sumo.traffic.manoeuvres.answers import TargetWay
from advdiff_sumo.traffic.manoeuvres.manoeuvre import LATERAL_MPS, Manoeuvre
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import SpeedProfile
from advdiff_sumo.traffic.manoeuvres.ways import Way

DOUBLE = "double"
"""The kind of a leader that stops while others are nearer, see ``hidden_stop``."""
STOPPING_KINDS = ("hard-stop", "blocked-lane", DOUBLE)
"""Kinds that end in a stop in the lane."""
ENDS_STANDING = (*STOPPING_KINDS, "cut-in")
"""Kinds after which who drove them may stand in the target's lane."""
SLOW_MERGE, PULL_OUT = "slow-merge", "pull-out"
SLOW_ENTRIES = (SLOW_MERGE, PULL_OUT)
"""Kinds that enter the target's lane at much less than its speed, and go on; see ``slow_entries``."""
MAX_DEMAND_MPS2: Mapping[str, float] = {SLOW_MERGE: 5.0, PULL_OUT: 4.0}
"""What they demand of the target at most: with more a careful driver, whose braking takes time to grow, may be late."""
HARD_BRAKING_MPS2 = (4.5, 6.0, 7.5, 8.5)
"""A leader that brakes for something it alone sees."""
HEAVY_MAX_BRAKING_MPS2 = 7.0
"""The hardest braking of lorries and buses, SUMO's default ``emergencyDecel`` of trucks."""
GENTLE_BRAKING_MPS2 = (2.0, 3.0)
"""A vehicle that stops in its lane as at a kerb."""
AFTER_CUT_IN_MPS2 = (2.0, 3.5, 5.0, 6.5, 8.0)
"""How somebody slows who has just changed lanes and finds the queue."""
CROSSING_ACCELS_MPS2 = (2.0, 1.0, 0.0, -1.0, -2.0)
"""How somebody with priority chooses when to arrive; of what serves alike, the sooner."""
_REVEALS_S = (2.0, 2.5, 3.0, 3.5, 4.0)
_LONGEST_DELAY_S = 2.0
AS_GOOD_AS_STANDS_MPS = 0.5
"""Who is slower counts as standing for what a manoeuvre asks: the others need not reckon with its going on."""
_TIMING_S = (1.5, 3.0)
_HESITATES_MPS2, _GOES_MPS2 = (1.0, 2.0, 3.0), 2.5
_HESITATES_S = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.25, 2.5, 3.0)
"""Somebody at a green light slows as if it were to stop, and goes after all."""
IN_LANE_SHARE = 0.8
"""Share of the time of a lane change after which somebody slows, or gains speed: a tenth of the way is left."""
_CRAWLS_SHARE, _STOPS_MPS2 = 0.3, 3.0
"""Who slows harder than this after a change of lanes stops; others go on at a share of the target's speed."""
IN_LANE_M, BESIDE_M = 1.2, 5.5
"""Who is nearer to the middle of a way is on it; who is on a lane beside it is no farther from it."""
BEHIND_M, AHEAD_M, SAME_WAY = -10.0, 55.0, 0.9
"""Between which somebody beside the target is near it; and the least cosine of who drives its way."""
_CROSSING_M = 60.0
LEADS_M = 68.0
"""Within which somebody leads the target: at 40 m/s 1.5 s ahead."""
_NOWHERE = (np.inf, np.inf)
_SLOWEST_MPS = 2.0
STOPS_FROM_MPS = 5.0
"""Who is to stop drives faster."""
_CROSSES_SHARE = 0.45
"""Share of the limit below which nobody slows who has priority."""
_SPARE_M, _CLOSES_PER_S, _SETTLES_S = 2.0, 0.6, 0.8
_CLOSES_UP_SHARE, _CLOSES_UP_PER_S = 0.75, 0.4
"""Share of the target's speed at which a leader lets it close up, and share of the way there that it gains a second."""
HEADWAY_S, _STANDING_GAP_M = 1.5, 2.0
"""At which a leader leads, which is what people keep, and on top of it."""
_GENTLY_MPS2, _GAINS_MPS2 = 1.0, 2.0


def hard_stop(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """The target's leader brakes hard to a stop, or leads it at a steady gap until then."""
    yield from _stops(view, row, "hard-stop", HARD_BRAKING_MPS2)
    if view.target is not None and _leads(view, row) and view.is_clear_to(view.on_target_way[row][0]):
        steady = steady_lead_profile(view, view.target, row)
        yield Manoeuvre("hard-stop", row, view.ways[row], steady, sets_up=True)


def steady_lead_profile(view: SituationView, target: TargetWay, row: int) -> SpeedProfile:
    """Return the speed with which *row* leads the target at the headway that people keep, or gently gets there."""
    limit, drives = view.ways[row].lane.speed_mps, view.speed(row)
    gap = view.gap_m(view.on_target_way[row][0], row, view.scene.target)
    more = gap - (HEADWAY_S * target.speed_mps + _STANDING_GAP_M)
    slow = min(max(_CLOSES_UP_SHARE * target.speed_mps, STOPS_FROM_MPS + 1.0), limit)
    aims = float(np.clip(target.speed_mps - _CLOSES_UP_PER_S * more, slow, limit))
    accel = float(np.clip((aims - drives) / _SETTLES_S, -_GENTLY_MPS2, _GAINS_MPS2))
    return SpeedProfile(accel, _SETTLES_S, 0.0, min(slow, drives), limit)


def blocked_lane(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """Somebody well ahead in the target's lane stops gently and stays."""
    yield from _stops(view, row, "blocked-lane", GENTLE_BRAKING_MPS2)


def stop_and_go(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """The target's leader slows to walking speed and goes again."""
    for brake in HARD_BRAKING_MPS2[:2]:
        if _leads(view, row):
            slowing = SpeedProfile(-brake, 2.5, 1.5, 1.0, view.ways[row].lane.speed_mps)
            yield Manoeuvre("stop-and-go", row, view.ways[row], slowing)


def cut_in(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """Somebody ahead on the next lane changes into the target's and slows, or gets into position for it."""
    target = view.target
    if target is None or not _beside(view, row) or view.speed(row) < _SLOWEST_MPS:
        return
    goal = way_on_target_lane(view, row)
    if goal is None:
        return
    way, limit = view.ways[row], view.ways[row].lane.speed_mps
    lateral = abs(view.on_target_way[row][1]) / LATERAL_MPS
    for brake in _possible(view, row, AFTER_CUT_IN_MPS2):
        lowest = _CRAWLS_SHARE * target.speed_mps if brake < _STOPS_MPS2 else 0.0
        after = SpeedProfile(0.0, IN_LANE_SHARE * lateral, -brake, lowest, limit)
        yield Manoeuvre("cut-in", row, way, after, goal)
    yield Manoeuvre("cut-in", row, way, positioning_profile(view, target, row), sets_up=True)


def positioning_profile(
    view: SituationView, target: TargetWay, row: int, spare_gap_m: float = 0.0
) -> SpeedProfile:
    """Return the speed that brings *row* to where it may just enter the target's lane, with *spare_gap_m* more."""
    limit, drives = view.ways[row].lane.speed_mps, view.speed(row)
    safe = safe_gap_m(target.speed_mps + 0.5, min(target.speed_mps, limit))
    wanted = LAWFUL.gap_share * safe + LAWFUL.spare_m + _SPARE_M + spare_gap_m
    between = 0.5 * float(view.size(row)[0] + target.size_m[0])
    lacks = wanted - (view.on_target_way[row][0] - between)
    aims = float(np.clip(target.speed_mps + _CLOSES_PER_S * lacks, 0.6 * target.speed_mps, limit))
    accel = float(np.clip((aims - drives) / _SETTLES_S, -2.0, 2.0))
    return SpeedProfile(accel, _SETTLES_S, 0.0, _SLOWEST_MPS, limit)


def crossing(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """Somebody with priority crosses the target's way when it gets there."""
    links = crossing_links(view, row)
    target = view.target
    if links is None or target is None or view.speed(row) < _SLOWEST_MPS:
        return
    reach = next((reach for reach, link in target.way.links if link is links[1]), None)
    if reach is not None and view.is_clear_on_arrival(
        reach
    ):  # not on the junction yet, nor waiting behind somebody
        yield from _timed(view, row, links[1])


def continued_crossings(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """Somebody who has begun to cross goes on: it does not hurry while a target that it lets pass is before it."""
    links = crossing_links(view, row)
    if links is None:
        return
    on_junction = links[1] is view.target_link
    for timed in _timed(view, row, links[1]):
        gains = timed.profile.first_mps2 > 0.0 or timed.profile.then_mps2 > 0.0
        if not (on_junction and gains) or view.is_red(links[1]):
            yield timed


def _timed(view: SituationView, row: int, link: Link) -> Iterator[Manoeuvre]:
    """Yield the speeds at which *row* may cross; before a target with a red light it may look as if it stopped."""
    way = view.ways[row]
    limit = way.lane.speed_mps
    for accel in CROSSING_ACCELS_MPS2:
        for until_s in _TIMING_S if accel else _TIMING_S[:1]:
            slowest = _SLOWEST_MPS if view.is_red(link) else _CROSSES_SHARE * limit
            timed = SpeedProfile(accel, until_s, 0.0, slowest, limit)
            yield Manoeuvre("crossing", row, way, timed)
    for slows in _HESITATES_MPS2 if view.is_red(link) else ():
        for until_s in _HESITATES_S:
            hesitant = SpeedProfile(-slows, until_s, _GOES_MPS2, _SLOWEST_MPS, limit)
            yield Manoeuvre("crossing", row, way, hesitant)


def cut_out(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """The target's leader changes lanes late and reveals somebody who stands."""
    yield from cut_out_at(view, row, _REVEALS_S)


def cut_out_at(view: SituationView, row: int, reveals_s: Sequence[float]) -> Iterator[Manoeuvre]:
    """Yield a :func:`cut_out` that begins each of *reveals_s* before *row* would reach who stands, if that is soon."""
    stands = _stands_before(view, row) if _leads(view, row) else None
    if stands is None or view.speed(row) < _SLOWEST_MPS:
        return
    other, gap_m = stands
    for side in ("left", "right"):
        goal = view.neighbour_way(row, side)
        for left_s in reveals_s if goal is not None else ():
            delay_s = gap_m / view.speed(row) - left_s
            if 0.0 <= delay_s <= _LONGEST_DELAY_S:
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
    """Return the links of *row* and of the target at the first junction where their ways meet, else None.

    A junction that the target is on counts, one that *row* is on does not.
    """
    target = view.target
    if target is None:
        return None
    theirs = {link.junction_id: link for reach, link in reversed(target.way.links) if reach < _CROSSING_M}
    if view.target_link is not None:
        theirs[view.target_link.junction_id] = view.target_link
    for reach, link in view.ways[row].links:
        other = theirs.get(link.junction_id)
        if other is None or reach > _CROSSING_M or link is other:
            continue
        foes = view.road.junctions[link.junction_id].foes.get(link.request_index, frozenset())
        if other.request_index in foes and link.from_lane.rpartition("_")[0] != _edge(other):
            return link, other
    return None


def _edge(link: Link) -> str:
    return link.from_lane.rpartition("_")[0]


def _stops(view: SituationView, row: int, kind: str, braking: tuple[float, ...]) -> Iterator[Manoeuvre]:
    if _leads(view, row) and view.speed(row) > STOPS_FROM_MPS:
        for brake in _possible(view, row, braking):
            yield Manoeuvre(kind, row, view.ways[row], SpeedProfile(then_mps2=-brake))


def _possible(view: SituationView, row: int, braking_mps2: Sequence[float]) -> list[float]:
    """Return *braking_mps2* without what the class of *row* cannot do, the hardest that it can in place of that."""
    heavy = view.scene.history.classes[row] in HEAVY_CLASSES
    return list(
        dict.fromkeys(min(brake, HEAVY_MAX_BRAKING_MPS2) if heavy else brake for brake in braking_mps2)
    )


def _leads(view: SituationView, row: int) -> bool:
    """Return whether *row* is ahead in the target's lane, on the target's way."""
    target = view.target
    if target is None:
        return False
    ahead, left = view.on_target_way[row]
    same = np.cos(view.scene.history.yaw_rad[row, -1] - target.way.line.at(target.way.lane.s_m + ahead)[1])
    return bool(0.0 < ahead < LEADS_M and abs(left) < IN_LANE_M and same > SAME_WAY)


def _beside(view: SituationView, row: int) -> bool:
    ahead, left = view.on_target_way.get(row, _NOWHERE)
    return BEHIND_M < ahead < AHEAD_M and IN_LANE_M < abs(left) < BESIDE_M


def way_on_target_lane(view: SituationView, row: int) -> Way | None:
    """Return the neighbouring way of *row* that lies on the target's way; None where there is none."""
    target = view.target
    on = {lane.id for lane in target.way.lane.lanes} if target is not None else set()
    for side in ("left", "right"):
        goal = view.neighbour_way(row, side)
        if goal is not None and goal.present_lane.id in on:
            return goal
    return None


def _stands_before(view: SituationView, row: int) -> tuple[int, float] | None:
    """Return who is next on the way of *row* and stands, and the bumper gap to it; None where it does not stand."""
    places = ((other, *view.position_on(view.ways[row], other)) for other in view.ways if other != row)
    ahead = [(s, other) for other, s, left in places if s > 0.0 and abs(left) < IN_LANE_M]
    distance, other = min(ahead, default=(np.inf, row))
    if distance > LEADS_M or other == view.scene.target or view.speed(other) > AS_GOOD_AS_STANDS_MPS:
        return None
    return other, view.gap_m(distance, row, other)
