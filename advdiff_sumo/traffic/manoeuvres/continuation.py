"""Manoeuvres under way: what remains of each, and which ones have ended or are no longer lawful."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.metrics.breaches.lane_rules import SAME_WAY_RAD
from advdiff_sumo.metrics.lane_entry import INTRUSION_M
from advdiff_sumo.traffic.licence import Licence
from advdiff_sumo.traffic.manoeuvres.blind_spot import blind_spot
from advdiff_sumo.traffic.manoeuvres.choice import rank
from advdiff_sumo.traffic.manoeuvres.close_pass import continued_pass
from advdiff_sumo.traffic.manoeuvres.commitments import LEADER_KINDS, SUPPORT_KINDS, Commitment, Commitments
from advdiff_sumo.traffic.manoeuvres.demanded_braking import demanded_braking
from advdiff_sumo.traffic.manoeuvres.follower import FOLLOWS, still_follows
from advdiff_sumo.traffic.manoeuvres.intensity import Intensity
from advdiff_sumo.traffic.manoeuvres.licence_rules import lawful_mask
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, futures_of_manoeuvres
from advdiff_sumo.traffic.manoeuvres.oncoming import suited_crossings
from advdiff_sumo.traffic.manoeuvres.prescribed_severity import target_brakes
from advdiff_sumo.traffic.manoeuvres.repertoire import (
    BLIND_SPOT,
    CLOSE_PASSING,
    DOUBLE,
    ENDS_STANDING,
    KINDS,
    PULL_OUT,
    SLOW_ENTRIES,
    SLOW_MERGE,
    STANDING_BELOW_MPS,
    continued_crossings,
)
from advdiff_sumo.traffic.manoeuvres.required_braking import BRAKING_MPS2
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.slow_entries import slow_body
from advdiff_sumo.traffic.manoeuvres.ways import Way

_MAX_DURATION_S: Mapping[str, float] = {
    "blocked-lane": 14.0,
    "hard-stop": 9.0,
    DOUBLE: 9.0,
    "stop-and-go": 6.0,
    SLOW_MERGE: 10.0,
    PULL_OUT: 12.0,
    CLOSE_PASSING: 14.0,
    BLIND_SPOT: 14.0,
}
_DEFAULT_MAX_DURATION_S = 7.0
_OVER_LINE_M = 0.2  # a box that reaches so far into the goal lane has entered it
_IN_WAY_M = 1.2  # lateral offset up to which the target is on the way of a vehicle
_OFF_CENTRE_M = 0.2  # offset above which a slow entry still moves to the middle of the goal lane


def continue_manoeuvres(
    view: SituationView, memory: Commitments, pause_s: float, licence: Licence | None
) -> tuple[list[Manoeuvre], Commitments]:
    """Return the manoeuvres under way that go on within the licence, and the memory without the others."""
    index, now = view.scene.history.index, view.scene.time_s
    going: list[Manoeuvre] = []
    active, rested = dict(memory.active), dict(memory.rested_s)
    for name, under_way in memory.active.items():
        row = index.get(name)
        manoeuvre = _remaining(view, row, under_way, memory, licence) if row in view.movable else None
        if manoeuvre is not None and still_lawful(view, manoeuvre, licence):
            going.append(manoeuvre)
            active[name] = replace(under_way, profile=manoeuvre.profile, timed_s=now)
            continue
        del active[name]
        rested[name] = now + (0.0 if under_way.is_positioning or under_way.kind == FOLLOWS else pause_s)
    if all(m.kind in SUPPORT_KINDS for m in going):  # without an attack, SUMO drives the follower
        going = [m for m in going if m.kind != FOLLOWS]
        active = {name: under_way for name, under_way in active.items() if under_way.kind != FOLLOWS}
    return going, replace(memory, active=active, rested_s=rested)


def _remaining(
    view: SituationView,
    row: int | None,
    under_way: Commitment,
    memory: Commitments,
    licence: Licence | None,
) -> Manoeuvre | None:
    """Return what remains of a manoeuvre; None if it has ended."""
    passed_s = view.scene.time_s - under_way.since_s
    max_duration_s = _MAX_DURATION_S.get(under_way.kind, _DEFAULT_MAX_DURATION_S)
    if row is None or under_way.is_positioning or passed_s >= max_duration_s:
        return None
    if under_way.kind in ENDS_STANDING and _target_stands(view) and view.speed(row) < STANDING_BELOW_MPS:
        return None  # both stand: the encounter is over
    if under_way.kind in LEADER_KINDS and not _is_ahead(view, row):
        return None  # the target has left its lane, or has passed the leader
    if under_way.kind == CLOSE_PASSING:
        return continued_pass(view, row)
    if under_way.kind == BLIND_SPOT:
        return next(blind_spot(view, row), None)
    return _remaining_motion(view, row, under_way, memory, licence)


def _remaining_motion(
    view: SituationView, row: int, under_way: Commitment, memory: Commitments, licence: Licence | None
) -> Manoeuvre | None:
    """Return the rest of a manoeuvre's speeds and lane change; None if it has ended."""
    intensity = memory.intensity
    if under_way.kind == "crossing":
        if _target_leads(view, row):
            return None  # the target now drives ahead of it, as its leader
        crossings = continued_crossings(view, row)
        timed = list(suited_crossings(view, crossings, memory.stage))
        ranked = rank(view, timed, {"crossing": 1.0}, licence, intensity, begun=True)
        keeps_profile = intensity.is_prescribed_for("crossing") and target_brakes(view)
        if ranked and not keeps_profile and not (ranked[0].needed_mps2 == 0.0 and _target_stands(view)):
            return ranked[0].manoeuvre
        if _target_stands(view):
            return None
    profile = under_way.profile
    switch_s = max(profile.switch_s - (view.scene.time_s - under_way.timed_s), 0.0)
    profile = replace(profile, switch_s=switch_s)
    if under_way.kind == "crossing":  # a lane of a junction may have another limit
        limit = max(view.ways[row].lane.speed_mps, view.speed(row))
        profile = replace(profile, highest_mps=min(profile.highest_mps, limit))
    goal = _goal(view, row, under_way)
    delay_s = max(under_way.delay_s - (view.scene.time_s - under_way.since_s), 0.0)
    body = slow_body(view, row) if under_way.kind in SLOW_ENTRIES else None
    manoeuvre = Manoeuvre(under_way.kind, row, view.ways[row], profile, goal, delay_s=delay_s, body=body)
    if under_way.kind == "cut-in" and licence is not None:
        return _remaining_cut_in(view, manoeuvre, intensity)
    return manoeuvre if under_way.kind != FOLLOWS or still_follows(view, manoeuvre) else None


def _remaining_cut_in(view: SituationView, manoeuvre: Manoeuvre, intensity: Intensity) -> Manoeuvre | None:
    """Return the cut-in, which brakes only once it is over the line; None if no braking of the target would suffice."""
    goal = manoeuvre.goal
    is_over = goal is None or _over_line_m(view, manoeuvre.row, goal) > INTRUSION_M
    if goal is None or (is_over and manoeuvre.profile.switch_s == 0.0):
        return manoeuvre
    delayed = manoeuvre if is_over else _braking_once_over(view, manoeuvre, goal)
    return delayed if intensity.is_prescribed_for("cut-in") or _can_target_avoid(view, delayed) else None


def _braking_once_over(view: SituationView, manoeuvre: Manoeuvre, goal: Way) -> Manoeuvre:
    """Return *manoeuvre* with braking only on the lane of *goal*, however long it takes to get there."""
    row = manoeuvre.row
    within_m = _half_widths_m(view, row, goal) - INTRUSION_M
    enters_s = manoeuvre.enters_s(view.scene.history.xy_m[row, -1], within_m)
    profile = manoeuvre.profile
    return replace(manoeuvre, profile=replace(profile, switch_s=max(profile.switch_s, enters_s)))


def _can_target_avoid(view: SituationView, manoeuvre: Manoeuvre) -> bool:
    """Return whether some braking keeps the target clear of *manoeuvre*; True if the target is on no lane."""
    if view.target is None:
        return True
    futures = futures_of_manoeuvres([manoeuvre], np.array([view.speed(manoeuvre.row)]))
    return bool(demanded_braking(view, view.target, [manoeuvre], futures)[0] <= BRAKING_MPS2[-1])


def _target_leads(view: SituationView, row: int) -> bool:
    """Return whether the target drives ahead of *row* on its way, in the same direction."""
    target = view.target
    if target is None:
        return False
    ahead, left = view.position_on(view.ways[row], view.scene.target)
    yaw = view.scene.history.yaw_rad[:, -1]
    same_way = abs(float(wrap_angle(float(yaw[row] - yaw[view.scene.target])))) < SAME_WAY_RAD
    return same_way and ahead > 0.0 and abs(left) < _IN_WAY_M


def _is_ahead(view: SituationView, row: int) -> bool:
    """Return whether *row* is ahead of the target, and their boxes overlap laterally."""
    target = view.target
    if target is None:
        return True
    ahead, left = view.on_target_way[row]
    return ahead > 0.0 and abs(left) < 0.5 * float(view.size(row)[1] + target.size_m[1])


def _target_stands(view: SituationView) -> bool:
    return view.target is None or view.target.speed_mps < STANDING_BELOW_MPS


def _goal(view: SituationView, row: int, under_way: Commitment) -> Way | None:
    """Return the way that *row* is still changing to; None once it is on it."""
    if under_way.kind in SLOW_ENTRIES and view.ways[row].present_lane.id == under_way.goal_lane:
        return view.ways[row] if abs(view.ways[row].lane.offset_m) > _OFF_CENTRE_M else None
    if under_way.kind in ("cut-out", *SLOW_ENTRIES):
        ways = (view.neighbour_way(row, side) for side in ("left", "right"))
        return next((way for way in ways if way and way.present_lane.id == under_way.goal_lane), None)
    if under_way.kind != "cut-in":
        return None
    goals = [m.goal for m in KINDS["cut-in"](view, row) if m.goal is not None]
    return goals[0] if goals else None


def still_lawful(view: SituationView, manoeuvre: Manoeuvre, licence: Licence | None) -> bool:
    """Return whether *manoeuvre* may go on.

    It must leave the gap of the rule, without a margin, and none any more once it is over the line.
    """
    futures = futures_of_manoeuvres([manoeuvre], np.array([view.speed(manoeuvre.row)]))
    if licence is not None:
        licence = replace(licence, gap_share=min(licence.gap_share, 1.0), spare_m=0.0)
    goal = manoeuvre.goal
    if goal is not None and _has_entered(view, manoeuvre, goal):
        manoeuvre = replace(manoeuvre, goal=None)
    return bool(lawful_mask(view, [manoeuvre], futures, licence, begun=True)[0])


def _has_entered(view: SituationView, manoeuvre: Manoeuvre, goal: Way) -> bool:
    if manoeuvre.body is not None:
        return manoeuvre.enters_s(view.scene.history.xy_m[manoeuvre.row, -1]) == 0.0
    return _over_line_m(view, manoeuvre.row, goal) > _OVER_LINE_M


def _over_line_m(view: SituationView, row: int, goal: Way) -> float:
    """Return by how much the box of *row* reaches into the lane of *goal*; negative if it does not."""
    across = abs(float(goal.line.project(view.scene.history.xy_m[row, -1])[1]))
    return _half_widths_m(view, row, goal) - across


def _half_widths_m(view: SituationView, row: int, goal: Way) -> float:
    """Return half the width of *goal*'s lane and of *row*: the distance of their centres when their edges touch."""
    return 0.5 * float(goal.present_lane.width_m + view.size(row)[1])
