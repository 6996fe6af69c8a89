"""Which manoeuvres break no rule: judged on what they would do, before anybody drives them.

The rules are those of ``docs/verdict.md``: red lights, right of way, the safe gap of RSS at an entry (Shalev-Shwartz
et al. 2017, arXiv:1708.06374, Definition 1), the limit, and room to everybody else.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.boxes import axis_gaps
from advdiff_sumo.core.signal_letters import GREEN, RED, YELLOW, YIELDING_GREEN
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.metrics.safe_gap import safe_gap_m
from advdiff_sumo.traffic.licence import LAWFUL, RECKLESS_OVER_LIMIT, Licence
from advdiff_sumo.traffic.manoeuvres.free_speed import can_slow_for_bends
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, ManoeuvreFutures
from advdiff_sumo.traffic.manoeuvres.repertoire import STOPPING_KINDS, crossing_links
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.ways import Way
from advdiff_sumo.traffic.planning.braking import SIDE_M
from advdiff_sumo.traffic.planning.people import PEOPLE_SIDE_M

_ROOM_M, _PEOPLE_ROOM_M = np.array([0.5, SIDE_M]), np.array([0.5, PEOPLE_SIDE_M])
_SOON_STEPS, _CROSSED_STEPS, _SET_UP_STEPS = {False: 10, True: 5}, 15, 3
_STOPS_MPS2 = 3.0


def lawful_mask(
    view: SituationView,
    manoeuvres: Sequence[Manoeuvre],
    futures: ManoeuvreFutures,
    licence: Licence | None = LAWFUL,
    begun: bool = False,
) -> BoolArray:
    """Return (C,) which of *manoeuvres*, with these *futures*, keep to *licence* and harm nobody but the target.

    Args:
        view: the scene.
        manoeuvres: C of them.
        futures: theirs.
        licence: what they may do; None: anything.
        begun: whether they are under way, so that who has to give way to somebody who crosses has seen it.
    """
    keeps = [_keeps(view, m, futures, k, licence, begun) for k, m in enumerate(manoeuvres)]
    return np.array(keeps, dtype=np.bool_)


def _keeps(
    view: SituationView,
    manoeuvre: Manoeuvre,
    futures: ManoeuvreFutures,
    k: int,
    licence: Licence | None,
    begun: bool,
) -> bool:
    over_limit = RECKLESS_OVER_LIMIT if licence is None else licence.over_limit
    if not _keeps_limit(manoeuvre, float(futures.speed_mps[k].max()), view.speed(manoeuvre.row), over_limit):
        return False
    by_then = float(futures.driven_m[k, _SET_UP_STEPS]), float(futures.speed_mps[k, _SET_UP_STEPS])
    # who crosses is timed at one speed, in a turn as well
    if manoeuvre.kind != "crossing" and not can_slow_for_bends(manoeuvre.goal or manoeuvre.way, *by_then):
        return False
    soon = _SOON_STEPS[begun] if manoeuvre.kind == "crossing" else None  # beyond, others have given way
    driven = float(futures.driven_m[k, -1])
    until_line = driven if soon is None else float(futures.driven_m[k, _CROSSED_STEPS])
    if manoeuvre.sets_up:  # it is planned anew at once, and can still stop
        until_line = min(driven, by_then[0] + by_then[1] ** 2 / (2.0 * _STOPS_MPS2))
    if licence is not None and not (
        _respects_links(view, manoeuvre, until_line, licence)
        and _stops_clear(manoeuvre, driven)
        and _leaves_gaps(view, manoeuvre, licence)
    ):
        return False
    return _has_room(view, manoeuvre, futures, k, slice(0, soon))


def _keeps_limit(manoeuvre: Manoeuvre, fastest_mps: float, speed_mps: float, over_limit: float) -> bool:
    return fastest_mps <= max(over_limit * manoeuvre.way.lane.speed_mps, speed_mps + 0.1)


def _respects_links(view: SituationView, manoeuvre: Manoeuvre, driven_m: float, licence: Licence) -> bool:
    """Return whether every stop line it drives over may be passed: green, and no duty to yield."""
    front = 0.5 * float(view.size(manoeuvre.row)[0])
    met = crossing_links(view, manoeuvre.row) if manoeuvre.kind == "crossing" else None
    for reach, link in manoeuvre.way.links:
        if reach - front < 0.0 or reach - front > driven_m:
            continue
        signal = view.signal(link)
        if signal in RED or (licence.stops_at_yellow and signal in YELLOW):
            return False
        if met is not None and link is met[0]:
            if not _has_priority(view, met):
                return False
        elif (link.yields and not signal) or signal == YIELDING_GREEN:
            return False
    return True


def _has_priority(view: SituationView, links: tuple[Link, Link]) -> bool:
    """Return whether the target has to give way to who takes the first of *links*, and not the other way round."""
    own, targets = links
    if own.request_index < 0 or targets.request_index < 0:
        return False
    if view.is_red(targets):
        return view.signal(own) in GREEN
    return view.yields_to(targets, own) and not (own.must_wait and not view.signal(own))


def _stops_clear(manoeuvre: Manoeuvre, driven_m: float) -> bool:
    """Return whether a stop does not end inside a junction."""
    if manoeuvre.kind not in STOPPING_KINDS or manoeuvre.sets_up:
        return True
    at = manoeuvre.way.lane.s_m + driven_m
    for lane in manoeuvre.way.lane.lanes:
        if at <= lane.length_m:
            return not lane.is_internal
        at -= lane.length_m
    return True


def _leaves_gaps(view: SituationView, manoeuvre: Manoeuvre, licence: Licence) -> bool:
    """Return whether a lane change leaves the safe gap to whoever follows and leads on the new lane."""
    if manoeuvre.goal is None:
        return True
    row, goal = manoeuvre.row, manoeuvre.goal
    enters_s = manoeuvre.enters_s(view.scene.history.xy_m[row, -1])
    beside = [other for other in view.ways if other != row and _on(goal, view, other)]
    drives = manoeuvre.mean_and_end_speed(enters_s, view.speed(row))
    return all(entry_margin_m(view, row, other, enters_s, licence, drives) >= 0.0 for other in beside)


def _on(goal: Way, view: SituationView, other: int) -> bool:
    left = goal.line.project(view.scene.history.xy_m[other, -1], extrapolate=True)[1]
    return abs(float(left)) < 0.5 * (goal.present_lane.width_m + float(view.size(other)[1])) - 0.3


def entry_margin_m(
    view: SituationView,
    row: int,
    other: int,
    enters_s: float,
    licence: Licence,
    drives_mps: tuple[float, float] | None = None,
) -> float:
    """Return the gap of *row* to *other* at its entry, less what *licence* asks for; *other* goes on gaining speed.

    Args:
        view: the scene.
        row: of who enters.
        other: row of who is on that lane.
        enters_s: when.
        licence: what it may do.
        drives_mps: mean speed of *row* until then, and its speed by then; None: it keeps its speed.
    """
    mean, speed = drives_mps or (view.speed(row), view.speed(row))
    gains = view.speed_gain_mps2(other)
    theirs = view.speed(other) + gains * enters_s
    driven = enters_s * (mean - 0.5 * (view.speed(other) + theirs))
    ahead = view.position_on(view.ways[other], row)[0] + driven
    gap = abs(ahead) - 0.5 * float(view.size(row)[0] + view.size(other)[0])
    follower, leader = (theirs + 0.5, speed) if ahead > 0.0 else (speed, theirs)
    return gap - (licence.gap_share * safe_gap_m(follower, leader) + licence.spare_m)


def _has_room(
    view: SituationView, manoeuvre: Manoeuvre, futures: ManoeuvreFutures, k: int, soon: slice
) -> bool:
    """Return whether it meets nobody but the target *soon*, if all others keep their speeds on their ways.

    Who follows on the same lane is left out: drivers keep their distance to a leader. Who is on foot, or on no lane,
    keeps its velocity, and is given more room.
    """
    rows = np.array(
        [
            r
            for r in view.ways
            if r not in (manoeuvre.row, view.scene.target) and not _follows(view, manoeuvre, r)
        ],
        dtype=np.int64,
    )
    own = manoeuvre.row, futures.xy_m[k, soon], futures.yaw_rad[k, soon]
    xy, yaw = view.constant_speed_poses(rows)
    clear = _clear_of(view, own, rows, xy[:, soon], yaw[:, soon], _ROOM_M)
    xy, yaw = view.constant_velocity_poses
    return clear and _clear_of(view, own, view.off_lane_rows, xy[:, soon], yaw[:, soon], _PEOPLE_ROOM_M)


def _clear_of(
    view: SituationView,
    own: tuple[int, FloatArray, FloatArray],
    rows: IntArray,
    xy_m: FloatArray,
    yaw_rad: FloatArray,
    room_m: FloatArray,
) -> bool:
    """Return whether *own* (row, (T, 2), (T,)) keeps *room_m* (2,) to *rows* (R,), at (R, T, 2) with (R, T)."""
    own_row, own_xy, own_yaw = own
    near = np.linalg.norm(xy_m - own_xy, axis=-1).min(axis=1, initial=np.inf) < 12.0
    if not near.any():
        return True
    half = 0.5 * view.scene.history.size_m
    gaps = axis_gaps(
        xy_m[near] - own_xy,
        np.broadcast_to(own_yaw, yaw_rad[near].shape),
        half[own_row] + room_m,
        yaw_rad[near],
        half[rows[near]][:, None],
    )[0].max(-1)
    return bool((gaps > 0.0).all())


def _follows(view: SituationView, manoeuvre: Manoeuvre, other: int) -> bool:
    ahead, left = view.position_on(view.ways[other], manoeuvre.row)
    return ahead > 0.0 and abs(left) < 1.2
