"""Manoeuvres under way: what is left of each, and which are over or no longer lawful."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.metrics.breaches.lane_rules import SAME_WAY_RAD
from advdiff_sumo.metrics.lane_entry import INTRUSION_M
from advdiff_sumo.traffic.licence import Licence
from advdiff_sumo.traffic.manoeuvres.answers import BRAKING_MPS2
from advdiff_sumo.traffic.manoeuvres.choice import rank
from advdiff_sumo.traffic.manoeuvres.commitments import LEADER_KINDS, SUPPORT_KINDS, Commitment, Commitments
from advdiff_sumo.traffic.manoeuvres.demanded_braking import demanded_braking
from advdiff_sumo.traffic.manoeuvres.follower import FOLLOWS, still_follows
from advdiff_sumo.traffic.manoeuvres.graded import target_brakes
from advdiff_sumo.traffic.manoeuvres.intensity import Intensity
from advdiff_sumo.traffic.manoeuvres.licence_rules import lawful_mask
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, futures_of_manoeuvres
from advdiff_sumo.traffic.manoeuvres.oncoming import filter_oncoming
from advdiff_sumo.traffic.manoeuvres.repertoire import (
    AS_GOOD_AS_STANDS_MPS,
    DOUBLE,
    ENDS_STANDING,
    KINDS,
    PULL_OUT,
    SLOW_ENTRIES,
    SLOW_MERGE,
    continued_crossings,
)
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.slow_entries import slow_body
from advdiff_sumo.traffic.manoeuvres.ways import Way

_LONGEST_S: Mapping[str, float] = {
    "blocked-lane": 14.0,
    "hard-stop": 9.0,
    DOUBLE: 9.0,
    "stop-and-go": 6.0,
    SLOW_MERGE: 10.0,
    PULL_OUT: 12.0,
}
_LONGEST_DEFAULT_S = 7.0
_OVER_LINE_M, _IN_WAY_M, _OFF_MIDDLE_M = 0.2, 1.2, 0.2


def continue_manoeuvres(
    view: SituationView, kept: Commitments, pause_s: float, licence: Licence | None
) -> tuple[list[Manoeuvre], Commitments]:
    """Return the manoeuvres under way that go on within the licence, and the memory without the others."""
    index, now = view.scene.history.index, view.scene.time_s
    going: list[Manoeuvre] = []
    active, rested = dict(kept.active), dict(kept.rested_s)
    for name, under_way in kept.active.items():
        row = index.get(name)
        manoeuvre = _continued(view, row, under_way, kept, licence) if row in view.movable else None
        if manoeuvre is not None and still_lawful(view, manoeuvre, licence):
            going.append(manoeuvre)
            active[name] = replace(under_way, profile=manoeuvre.profile, timed_s=now)
            continue
        del active[name]
        rested[name] = now + (0.0 if under_way.sets_up or under_way.kind == FOLLOWS else pause_s)
    if all(m.kind in SUPPORT_KINDS for m in going):  # nobody attacks: who follows is its own driver again
        going = [m for m in going if m.kind != FOLLOWS]
        active = {name: under_way for name, under_way in active.items() if under_way.kind != FOLLOWS}
    return going, replace(kept, active=active, rested_s=rested)


def _continued(
    view: SituationView,
    row: int | None,
    under_way: Commitment,
    kept: Commitments,
    licence: Licence | None,
) -> Manoeuvre | None:
    """Return the rest of a manoeuvre; None where it is over."""
    intensity = kept.intensity
    passed = view.scene.time_s - under_way.since_s
    longest = _LONGEST_S.get(under_way.kind, _LONGEST_DEFAULT_S)
    if row is None or under_way.sets_up or passed >= longest:
        return None
    if under_way.kind in ENDS_STANDING and _target_stands(view) and view.speed(row) < AS_GOOD_AS_STANDS_MPS:
        return None  # both stand: the question is answered
    if under_way.kind in LEADER_KINDS and not _is_ahead(view, row):
        return None  # the target has left its lane, or is past it
    if under_way.kind == "crossing":
        if _is_before(view, row):
            return None  # who has come out ahead of it is a leader
        timed = list(filter_oncoming(view, continued_crossings(view, row), kept.stage.only_oncoming))
        again = rank(view, timed, {"crossing": 1.0}, licence, intensity, begun=True)
        holds = intensity.is_prescribed_for("crossing") and target_brakes(view)
        if again and not holds and not (again[0].needed_mps2 == 0.0 and _target_stands(view)):
            return again[0].manoeuvre
        if _target_stands(view):
            return None
    begun = under_way.profile
    rest = replace(begun, switch_s=max(begun.switch_s - (view.scene.time_s - under_way.timed_s), 0.0))
    if under_way.kind == "crossing":  # a lane of a junction may have another limit
        limit = max(view.ways[row].lane.speed_mps, view.speed(row))
        rest = replace(rest, highest_mps=min(rest.highest_mps, limit))
    goal = _goal(view, row, under_way)
    delay_s = max(under_way.delay_s - passed, 0.0)
    body = slow_body(view, row) if under_way.kind in SLOW_ENTRIES else None
    manoeuvre = Manoeuvre(under_way.kind, row, view.ways[row], rest, goal, delay_s=delay_s, body=body)
    if under_way.kind == "cut-in" and licence is not None:
        return _cutting_in(view, manoeuvre, intensity)
    return manoeuvre if under_way.kind != FOLLOWS or still_follows(view, manoeuvre) else None


def _cutting_in(view: SituationView, manoeuvre: Manoeuvre, intensity: Intensity) -> Manoeuvre | None:
    """Return *manoeuvre* as it slows once it is over the line; None where that would leave the target no answer."""
    goal = manoeuvre.goal
    over = goal is None or _over_line_m(view, manoeuvre.row, goal) > INTRUSION_M
    if goal is None or (over and manoeuvre.profile.switch_s == 0.0):
        return manoeuvre
    later = manoeuvre if over else _slowing_once_over(view, manoeuvre, goal)
    return later if intensity.is_prescribed_for("cut-in") or _is_answerable(view, later) else None


def _slowing_once_over(view: SituationView, manoeuvre: Manoeuvre, goal: Way) -> Manoeuvre:
    """Return *manoeuvre*, which slows on the lane of *goal* alone, however long it takes to get there."""
    row = manoeuvre.row
    within_m = _half_widths_m(view, row, goal) - INTRUSION_M
    enters_s = manoeuvre.enters_s(view.scene.history.xy_m[row, -1], within_m)
    profile = manoeuvre.profile
    return replace(manoeuvre, profile=replace(profile, switch_s=max(profile.switch_s, enters_s)))


def _is_answerable(view: SituationView, manoeuvre: Manoeuvre) -> bool:
    """Return whether some braking keeps the target clear of who cuts in, from when it is there and slows on."""
    if view.target is None:
        return True
    futures = futures_of_manoeuvres([manoeuvre], np.array([view.speed(manoeuvre.row)]))
    return bool(demanded_braking(view, view.target, [manoeuvre], futures)[0] <= BRAKING_MPS2[-1])


def _is_before(view: SituationView, row: int) -> bool:
    """Return whether the target drives ahead of *row* on its way, in the same direction."""
    target = view.target
    if target is None:
        return False
    ahead, left = view.position_on(view.ways[row], view.scene.target)
    yaw = view.scene.history.yaw_rad[:, -1]
    same_way = abs(float(wrap_angle(float(yaw[row] - yaw[view.scene.target])))) < SAME_WAY_RAD
    return same_way and ahead > 0.0 and abs(left) < _IN_WAY_M


def _is_ahead(view: SituationView, row: int) -> bool:
    """Return whether *row* is ahead of the target on its way, or not wholly beside it."""
    target = view.target
    if target is None:
        return True
    ahead, left = view.on_target_way[row]
    return ahead > 0.0 and abs(left) < 0.5 * float(view.size(row)[1] + target.size_m[1])


def _target_stands(view: SituationView) -> bool:
    return view.target is None or view.target.speed_mps < AS_GOOD_AS_STANDS_MPS


def _goal(view: SituationView, row: int, under_way: Commitment) -> Way | None:
    """Return the way that *row* is still changing to; None once it is on it."""
    if under_way.kind in SLOW_ENTRIES and view.ways[row].present_lane.id == under_way.goal_lane:
        return view.ways[row] if abs(view.ways[row].lane.offset_m) > _OFF_MIDDLE_M else None
    if under_way.kind in ("cut-out", *SLOW_ENTRIES):
        sides = (view.neighbour_way(row, side) for side in ("left", "right"))
        return next((way for way in sides if way and way.present_lane.id == under_way.goal_lane), None)
    if under_way.kind != "cut-in":
        return None
    again = [m.goal for m in KINDS["cut-in"](view, row) if m.goal is not None]
    return again[0] if again else None


def still_lawful(view: SituationView, manoeuvre: Manoeuvre, licence: Licence | None) -> bool:
    """Return whether *manoeuvre* goes on: with the gap that the rule asks for, and none once it is over the line."""
    futures = futures_of_manoeuvres([manoeuvre], np.array([view.speed(manoeuvre.row)]))
    if licence is not None:
        licence = replace(licence, gap_share=min(licence.gap_share, 1.0), spare_m=0.0)
    goal = manoeuvre.goal
    if goal is not None and _is_over_line(view, manoeuvre, goal):
        manoeuvre = replace(manoeuvre, goal=None)
    return bool(lawful_mask(view, [manoeuvre], futures, licence, begun=True)[0])


def _is_over_line(view: SituationView, manoeuvre: Manoeuvre, goal: Way) -> bool:
    if manoeuvre.body is not None:
        return manoeuvre.enters_s(view.scene.history.xy_m[manoeuvre.row, -1]) == 0.0
    return _over_line_m(view, manoeuvre.row, goal) > _OVER_LINE_M


def _over_line_m(view: SituationView, row: int, goal: Way) -> float:
    """Return by how much the box of *row* reaches into the lane of *goal*; negative where it does not."""
    across = abs(float(goal.line.project(view.scene.history.xy_m[row, -1])[1]))
    return _half_widths_m(view, row, goal) - across


def _half_widths_m(view: SituationView, row: int, goal: Way) -> float:
    """Return half the lane of *goal* and half of *row*: so far apart, their edges touch."""
    return 0.5 * float(goal.present_lane.width_m + view.size(row)[1])
