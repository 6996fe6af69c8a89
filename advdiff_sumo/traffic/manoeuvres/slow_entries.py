"""Who enters the target's lane at much less than its speed, and goes on: from a slower lane, or from where it stood.

Nobody brakes in it: what is asked of the target is to see how slow somebody is who has the lawful gap.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from advdiff_sumo.core.scene import HEAVY_CLASSES
from advdiff_sumo.metrics.safe_gap import safe_gap_m
from advdiff_sumo.traffic.licence import LAWFUL, Licence
from advdiff_sumo.traffic.manoeuvres.licence_rules import entry_margin_m
from advdiff_sumo.traffic.manoeuvres.manoeuvre import LATERAL_MPS, Manoeuvre, SlowBody
from advdiff_sumo.traffic.manoeuvres.repertoire import (
    AS_GOOD_AS_STANDS_MPS,
    BESIDE_M,
    IN_LANE_M,
    IN_LANE_SHARE,
    KINDS,
    MAX_DEMAND_MPS2,
    PULL_OUT,
    SLOW_ENTRIES,
    SLOW_MERGE,
    way_on_target_lane,
)
from advdiff_sumo.traffic.manoeuvres.situation_view import NEAR_M, SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import PLAN_DT_S, SpeedProfile
from advdiff_sumo.traffic.manoeuvres.ways import Way

SLOWEST_SHARE, FASTEST_SHARE = 0.2, 0.75
"""Shares of the target's speed between which somebody merges slowly."""
AIMS_SHARE = 0.3
"""The share at which somebody aims who slows for it."""
_ENTERS_S = 1.0
"""So long after the beginning of a lane change a car is over the line, about."""
SLOWEST_MPS = 2.0
"""Who merges is no slower."""
_GAINS_MPS2, _SLOWS_MPS2 = 0.5, 1.5
SETS_OFF_MPS2: Mapping[bool, float] = {True: 1.2, False: 1.8}
"""How fast a heavy vehicle, and another one, gains speed from a stop (SUMO's buses: 1.2 m/s², lorries: 1.3)."""
PULLS_OUT_MPS = (2.5, 3.5, 5.0)
"""To which somebody sets off who pulls out; it then gains speed more gently."""
_GAINS_ON_MPS2 = 0.3


def slow_merge(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """Somebody ahead on the next lane changes into the target's, slow as it is, or slows gently for it."""
    target, goal = view.target, _goal(view, row)
    speed = view.speed(row)
    if target is None or goal is None or speed < SLOWEST_MPS:
        return
    way = view.ways[row]
    if SLOWEST_SHARE <= speed / max(target.speed_mps, SLOWEST_MPS) <= FASTEST_SHARE:
        lateral_s = abs(view.on_target_way[row][1]) / LATERAL_MPS
        after = SpeedProfile(0.0, IN_LANE_SHARE * lateral_s, _GAINS_MPS2, 0.0, way.lane.speed_mps)
        yield Manoeuvre(SLOW_MERGE, row, way, after, goal, body=slow_body(view, row))
    aims = max(SLOWEST_MPS, AIMS_SHARE * target.speed_mps)
    slows_s = max(speed - aims, 0.0) / _SLOWS_MPS2
    loses_m = slows_s * (target.speed_mps - 0.5 * (speed + aims))
    gap_m = view.gap_m(view.on_target_way[row][0], row, view.scene.target)
    if gap_m - loses_m >= entry_gap_m(target.speed_mps, aims, aims, _ENTERS_S):
        slowing = SpeedProfile(-_SLOWS_MPS2, slows_s, 0.0, aims, way.lane.speed_mps)
        yield Manoeuvre(SLOW_MERGE, row, way, slowing, sets_up=True)


def pull_out(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """Somebody who stands on the lane beside, towards the kerb, sets off into the target's."""
    goal = _goal(view, row)
    if (
        goal is None
        or view.speed(row) > AS_GOOD_AS_STANDS_MPS
        or _side_of(view, goal, row) != kerb_side(view)
    ):
        return
    way = view.ways[row]
    gains = SETS_OFF_MPS2[view.scene.history.classes[row] in HEAVY_CLASSES]
    for drives in PULLS_OUT_MPS:
        setting_off = SpeedProfile(gains, drives / gains, _GAINS_ON_MPS2, 0.0, way.lane.speed_mps)
        yield Manoeuvre(PULL_OUT, row, way, setting_off, goal, body=slow_body(view, row))


PROPOSALS: Mapping[str, Callable[[SituationView, int], Iterator[Manoeuvre]]] = {
    **KINDS,
    SLOW_MERGE: slow_merge,
    PULL_OUT: pull_out,
}
"""Every kind of manoeuvre by name, also those that warm-ups know nothing of."""


def entry_gap_m(target_mps: float, mean_mps: float, speed_mps: float, enters_s: float) -> float:
    """Return the bumper gap to the target with which somebody may just begin to enter its lane.

    Args:
        target_mps: speed of the target.
        mean_mps: mean speed of the other until it enters.
        speed_mps: its speed by then.
        enters_s: when.
    """
    lawful_m = LAWFUL.gap_share * safe_gap_m(target_mps + 0.5, speed_mps) + LAWFUL.spare_m
    return lawful_m + enters_s * (target_mps - mean_mps)


def slow_body(view: SituationView, row: int) -> SlowBody:
    """Return *row* as somebody who changes lanes slowly."""
    length, width = view.size(row).tolist()
    return SlowBody(view.speed(row), length, width, 0.5 * float(view.size(view.scene.target)[1]))


def kerb_side(view: SituationView) -> str:
    """Return the side of the target at which somebody stands as at a kerb."""
    return "left" if view.road.lefthand else "right"


def can_begin_later(
    view: SituationView, manoeuvre: Manoeuvre, needed_mps2: float, licence: Licence | None
) -> bool:
    """Return whether *manoeuvre*, which demands *needed_mps2* of the target, can begin lawfully at the next plan, too.

    By then the gap is less: who enters slowly does so with the gap that the licence just allows.
    """
    if manoeuvre.kind not in SLOW_ENTRIES or manoeuvre.sets_up or needed_mps2 == 0.0:
        return False
    row, target = manoeuvre.row, view.scene.target
    loses_m = PLAN_DT_S * (view.speed(target) - view.speed(row))
    now = view.scene.history.xy_m[row, -1]
    closing_mps = (
        view.speed(target) - manoeuvre.mean_and_end_speed(manoeuvre.perceivable_s(now), view.speed(row))[1]
    )
    left_m = 0.5 * closing_mps**2 / needed_mps2 - loses_m  # of what braking takes
    if 0.5 * closing_mps**2 > MAX_DEMAND_MPS2[manoeuvre.kind] * left_m:
        return False
    enters_s = manoeuvre.enters_s(now)
    drives = manoeuvre.mean_and_end_speed(enters_s, view.speed(row))
    return entry_margin_m(view, row, target, enters_s, licence or LAWFUL, drives) >= loses_m


def _goal(view: SituationView, row: int) -> Way | None:
    """Return the way on the target's lane that *row*, ahead on the lane beside, would change to; None without one."""
    ahead, left = view.on_target_way.get(row, (0.0, 0.0))
    if view.target is None or not (0.0 < ahead < NEAR_M and IN_LANE_M < abs(left) < BESIDE_M):
        return None
    return way_on_target_lane(view, row)


def _side_of(view: SituationView, goal: Way, row: int) -> str:
    """Return the side of *goal* on which *row* is."""
    return "left" if float(goal.line.project(view.scene.history.xy_m[row, -1])[1]) > 0.0 else "right"
