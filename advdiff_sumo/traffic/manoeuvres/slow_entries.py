"""Vehicles that enter the target's lane at much less than its speed: from a slower lane, or from a standstill.

They do not brake, and drive on. The target must perceive how slow a vehicle is that entered with the lawful gap.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from advdiff_sumo.core.scene import HEAVY_CLASSES
from advdiff_sumo.metrics.safe_gap import safe_gap_m
from advdiff_sumo.traffic.licence import LAWFUL, Licence
from advdiff_sumo.traffic.manoeuvres.licence_rules import entry_margin_m
from advdiff_sumo.traffic.manoeuvres.manoeuvre import LATERAL_MPS, Manoeuvre, SlowBody
from advdiff_sumo.traffic.manoeuvres.repertoire import (
    BESIDE_M,
    IN_LANE_M,
    IN_LANE_SHARE,
    KINDS,
    MAX_DEMAND_MPS2,
    PULL_OUT,
    SLOW_ENTRIES,
    SLOW_MERGE,
    STANDING_BELOW_MPS,
    way_on_target_lane,
)
from advdiff_sumo.traffic.manoeuvres.situation_view import NEAR_M, SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import PLAN_DT_S, SpeedProfile
from advdiff_sumo.traffic.manoeuvres.ways import Way

SLOWEST_SHARE, FASTEST_SHARE = 0.2, 0.75
"""Range of the speed of a slow merge, as shares of the target's speed."""
AIMS_SHARE = 0.3
"""Share to which a vehicle slows before a slow merge."""
_ENTERS_S = 1.0  # about the time from the beginning of a lane change until a car is over the line
SLOWEST_MPS = 2.0
"""Lowest speed of a merging vehicle."""
_MERGE_ACCEL_MPS2, _SLOWING_MPS2 = 0.5, 1.5
SETS_OFF_MPS2: Mapping[bool, float] = {True: 1.2, False: 1.8}
"""Acceleration of a heavy vehicle, and of another one, from a standstill (SUMO's buses: 1.2 m/s², lorries: 1.3)."""
PULLS_OUT_MPS = (2.5, 3.5, 5.0)
"""Speeds to which a vehicle that pulls out sets off; it then accelerates more gently."""
_LATER_ACCEL_MPS2 = 0.3


def slow_merge(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """Yield slow changes into the target's lane by a vehicle ahead on the next lane, and slowing gently for them."""
    target, goal = view.target, _goal(view, row)
    speed = view.speed(row)
    if target is None or goal is None or speed < SLOWEST_MPS:
        return
    way = view.ways[row]
    if SLOWEST_SHARE <= speed / max(target.speed_mps, SLOWEST_MPS) <= FASTEST_SHARE:
        change_s = abs(view.on_target_way[row][1]) / LATERAL_MPS
        merging = SpeedProfile(0.0, IN_LANE_SHARE * change_s, _MERGE_ACCEL_MPS2, 0.0, way.lane.speed_mps)
        yield Manoeuvre(SLOW_MERGE, row, way, merging, goal, body=slow_body(view, row))
    end_mps = max(SLOWEST_MPS, AIMS_SHARE * target.speed_mps)
    slowing_s = max(speed - end_mps, 0.0) / _SLOWING_MPS2
    lost_m = slowing_s * (target.speed_mps - 0.5 * (speed + end_mps))
    gap_m = view.gap_m(view.on_target_way[row][0], row, view.scene.target)
    if gap_m - lost_m >= entry_gap_m(target.speed_mps, end_mps, end_mps, _ENTERS_S):
        slowing = SpeedProfile(-_SLOWING_MPS2, slowing_s, 0.0, end_mps, way.lane.speed_mps)
        yield Manoeuvre(SLOW_MERGE, row, way, slowing, is_positioning=True)


def pull_out(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """Yield departures into the target's lane of a vehicle that stands on the lane beside, towards the kerb."""
    goal = _goal(view, row)
    if goal is None or view.speed(row) > STANDING_BELOW_MPS or _side_of(view, goal, row) != kerb_side(view):
        return
    way = view.ways[row]
    accel = SETS_OFF_MPS2[view.scene.history.classes[row] in HEAVY_CLASSES]
    for speed_mps in PULLS_OUT_MPS:
        setting_off = SpeedProfile(accel, speed_mps / accel, _LATER_ACCEL_MPS2, 0.0, way.lane.speed_mps)
        yield Manoeuvre(PULL_OUT, row, way, setting_off, goal, body=slow_body(view, row))


PROPOSALS: Mapping[str, Callable[[SituationView, int], Iterator[Manoeuvre]]] = {
    **KINDS,
    SLOW_MERGE: slow_merge,
    PULL_OUT: pull_out,
}
"""Every kind of manoeuvre by name, also those for which warm-ups predict nothing."""


def entry_gap_m(target_mps: float, mean_mps: float, speed_mps: float, enters_s: float) -> float:
    """Return the least bumper gap to the target with which a vehicle may begin to enter its lane.

    Args:
        target_mps: speed of the target.
        mean_mps: mean speed of the other until it enters.
        speed_mps: its speed as it enters.
        enters_s: time until it enters.
    """
    lawful_m = LAWFUL.gap_share * safe_gap_m(target_mps + 0.5, speed_mps) + LAWFUL.spare_m
    return lawful_m + enters_s * (target_mps - mean_mps)


def slow_body(view: SituationView, row: int) -> SlowBody:
    """Return the box of *row* for a slow lane change."""
    length, width = view.size(row).tolist()
    return SlowBody(view.speed(row), length, width, 0.5 * float(view.size(view.scene.target)[1]))


def kerb_side(view: SituationView) -> str:
    """Return the side of the target on which the kerb is."""
    return "left" if view.road.lefthand else "right"


def can_begin_later(
    view: SituationView,
    manoeuvre: Manoeuvre,
    needed_mps2: float,
    licence: Licence | None,
    spare_gap_m: float | None = None,
) -> bool:
    """Return whether *manoeuvre*, which requires *needed_mps2* of the target, can also begin at the next plan.

    By then the gap is smaller: a slow entry begins with the smallest gap that the licence allows, or with a prescribed
    *spare_gap_m* more.
    """
    if manoeuvre.kind not in SLOW_ENTRIES or manoeuvre.is_positioning:
        return False
    if needed_mps2 == 0.0 and spare_gap_m is None:
        return False
    target_mps, speed_mps = view.speed(view.scene.target), view.speed(manoeuvre.row)
    lost_m = PLAN_DT_S * (target_mps - speed_mps)
    if needed_mps2 > 0.0:
        perceivable_s = manoeuvre.perceivable_s(view.scene.history.xy_m[manoeuvre.row, -1])
        closing_mps = target_mps - manoeuvre.mean_and_end_speed(perceivable_s, speed_mps)[1]
        braking_m = 0.5 * closing_mps**2 / needed_mps2 - lost_m  # left for braking
        if 0.5 * closing_mps**2 > MAX_DEMAND_MPS2[manoeuvre.kind] * braking_m:
            return False
    return slow_entry_margin_m(view, manoeuvre, licence or LAWFUL) >= lost_m + (spare_gap_m or 0.0)


def slow_entry_margin_m(view: SituationView, manoeuvre: Manoeuvre, licence: Licence) -> float:
    """Return the gap to the target that a slow entry leaves beyond the one that *licence* demands."""
    enters_s = manoeuvre.enters_s(view.scene.history.xy_m[manoeuvre.row, -1])
    speeds_mps = manoeuvre.mean_and_end_speed(enters_s, view.speed(manoeuvre.row))
    return entry_margin_m(view, manoeuvre.row, view.scene.target, enters_s, licence, speeds_mps)


def _goal(view: SituationView, row: int) -> Way | None:
    """Return the way on the target's lane for *row*, which is ahead on the lane beside; None if there is none."""
    ahead, left = view.on_target_way.get(row, (0.0, 0.0))
    if view.target is None or not (0.0 < ahead < NEAR_M and IN_LANE_M < abs(left) < BESIDE_M):
        return None
    return way_on_target_lane(view, row)


def _side_of(view: SituationView, goal: Way, row: int) -> str:
    """Return the side of *goal* on which *row* is."""
    return "left" if float(goal.line.project(view.scene.history.xy_m[row, -1])[1]) > 0.0 else "right"
