"""Which manoeuvres break no rule: judged by what they would do, before a vehicle drives them.

The rules are those of ``docs/verdict.md``: red lights, right of way, the safe gap of RSS at an entry (Shalev-Shwartz
et al. 2017, arXiv:1708.06374, Definition 1), the limit, and distance to all other road users.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.boxes import axis_gaps
from advdiff_sumo.core.signal_letters import GREEN, RED, YELLOW, YIELDING_GREEN
from advdiff_sumo.maps.junction_priority import has_right_of_way
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.metrics.safe_gap import safe_gap_m
from advdiff_sumo.traffic.licence import LAWFUL, RECKLESS_OVER_LIMIT, Licence
from advdiff_sumo.traffic.manoeuvres.free_speed import can_slow_for_bends
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, ManoeuvreFutures, futures_of_manoeuvres
from advdiff_sumo.traffic.manoeuvres.repertoire import STOPPING_KINDS, crossing_links
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.ways import Way
from advdiff_sumo.traffic.planning.braking import SIDE_M
from advdiff_sumo.traffic.planning.people import PEOPLE_SIDE_M

_ROOM_M, _PEOPLE_ROOM_M = np.array([0.5, SIDE_M]), np.array([0.5, PEOPLE_SIDE_M])  # along and across the box
_CROSSING_CHECK_STEPS = {
    False: 10,
    True: 5,
}  # has begun → steps over which a crossing must meet no third vehicle
_CROSSED_STEPS = 15  # a crossing must obey the lines that it passes within these steps
_SET_UP_STEPS = 3  # a vehicle that gets into position is planned anew after these steps
_STOPS_MPS2 = 3.0
_LATER_S = 1.0  # who changes lanes brakes only once it is over the line


def lawful_mask(
    view: SituationView,
    manoeuvres: Sequence[Manoeuvre],
    futures: ManoeuvreFutures,
    licence: Licence | None = LAWFUL,
    begun: bool = False,
) -> BoolArray:
    """Return (C,) which of *manoeuvres* keep to *licence* and endanger nobody but the target.

    Args:
        view: the scene.
        manoeuvres: C of them.
        futures: the futures of *manoeuvres*.
        licence: what they may do; None: anything.
        begun: whether they are under way, so that vehicles that must yield to a crossing one have seen it.
    """
    is_lawful = [_is_lawful(view, m, futures, k, licence, begun) for k, m in enumerate(manoeuvres)]
    return np.array(is_lawful, dtype=np.bool_)


def lawful_manoeuvres(
    view: SituationView, manoeuvres: Sequence[Manoeuvre], licence: Licence | None
) -> list[Manoeuvre]:
    """Return those of *manoeuvres* that keep to *licence* and endanger nobody but the target."""
    if not manoeuvres:
        return []
    futures = futures_of_manoeuvres(manoeuvres, np.array([view.speed(m.row) for m in manoeuvres]))
    is_lawful = lawful_mask(view, manoeuvres, futures, licence)
    return [m for m, keep in zip(manoeuvres, is_lawful, strict=True) if keep]


def _is_lawful(
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
    set_up_m = float(futures.driven_m[k, _SET_UP_STEPS])
    set_up_mps = float(futures.speed_mps[k, _SET_UP_STEPS])
    way = manoeuvre.goal or manoeuvre.way
    # the time of a crossing is computed for one speed, also in a turn
    if manoeuvre.kind != "crossing" and not can_slow_for_bends(way, set_up_m, set_up_mps):
        return False
    # later than this, others have yielded to a crossing vehicle
    check_steps = _CROSSING_CHECK_STEPS[begun] if manoeuvre.kind == "crossing" else None
    driven_m = float(futures.driven_m[k, -1])
    lines_within_m = driven_m if check_steps is None else float(futures.driven_m[k, _CROSSED_STEPS])
    if manoeuvre.is_positioning:  # it is planned anew at once, and can still stop
        lines_within_m = min(driven_m, set_up_m + set_up_mps**2 / (2.0 * _STOPS_MPS2))
    if licence is not None and not (
        (begun or _ends_on_lane(view, manoeuvre, driven_m))
        and _respects_links(view, manoeuvre, lines_within_m, licence)
        and _leaves_gaps(view, manoeuvre, licence)
    ):
        return False
    return _has_room(view, manoeuvre, futures, k, slice(0, check_steps))


def _keeps_limit(manoeuvre: Manoeuvre, fastest_mps: float, speed_mps: float, over_limit: float) -> bool:
    return fastest_mps <= max(over_limit * manoeuvre.way.lane.speed_mps, speed_mps + 0.1)


def _respects_links(view: SituationView, manoeuvre: Manoeuvre, within_m: float, licence: Licence) -> bool:
    """Return whether every stop line that it passes *within_m* may be passed: no red light and no duty to yield."""
    half_length_m = 0.5 * float(view.size(manoeuvre.row)[0])
    conflict = crossing_links(view, manoeuvre.row) if manoeuvre.kind == "crossing" else None
    for line_m, link in manoeuvre.way.links:
        if line_m - half_length_m < 0.0 or line_m - half_length_m > within_m:
            continue
        signal = view.signal(link)
        if signal in RED or (licence.stops_at_yellow and signal in YELLOW):
            return False
        if conflict is not None and link is conflict[0]:
            if not _has_priority(view, conflict):
                return False
        elif (link.yields and not signal) or signal == YIELDING_GREEN:
            return False
    return True


def _has_priority(view: SituationView, links: tuple[Link, Link]) -> bool:
    """Return whether the target, on the second of *links*, must yield to the first, and not the other way round."""
    own_link, target_link = links
    if own_link.request_index < 0 or target_link.request_index < 0:
        return False
    if view.is_red(target_link):
        return view.signal(own_link) in GREEN
    return has_right_of_way(view.road, own_link, target_link) and not (
        own_link.must_wait and not view.signal(own_link)
    )


def _ends_on_lane(view: SituationView, manoeuvre: Manoeuvre, driven_m: float) -> bool:
    """Return whether the manoeuvre ends before its road does, and a stop outside junctions.

    Who has begun to stop goes on, even if the stop then ends a little farther on, inside a junction.
    """
    return _road_goes_on(view, manoeuvre, driven_m) and _stops_outside_junctions(manoeuvre, driven_m)


def _road_goes_on(view: SituationView, manoeuvre: Manoeuvre, driven_m: float) -> bool:
    """Return whether its road, such as a lane that joins another, does not end before the manoeuvre does.

    Room is left for braking that begins a little later.
    """
    if manoeuvre.kind == "crossing" or manoeuvre.is_positioning:
        return True
    needed_m = driven_m + 0.5 * float(view.size(manoeuvre.row)[0]) + _LATER_S * view.speed(manoeuvre.row)
    return needed_m <= (manoeuvre.goal or manoeuvre.way).lane.end_m


def _stops_outside_junctions(manoeuvre: Manoeuvre, driven_m: float) -> bool:
    """Return whether a stop does not end inside a junction."""
    if manoeuvre.kind not in STOPPING_KINDS or manoeuvre.is_positioning:
        return True
    s = manoeuvre.way.lane.s_m + driven_m
    for lane in manoeuvre.way.lane.lanes:
        if s <= lane.length_m:
            return not lane.is_internal
        s -= lane.length_m
    return True


def _leaves_gaps(view: SituationView, manoeuvre: Manoeuvre, licence: Licence) -> bool:
    """Return whether a lane change leaves the safe gap to the follower and the leader on the new lane."""
    if manoeuvre.goal is None:
        return True
    row, goal = manoeuvre.row, manoeuvre.goal
    enters_s = manoeuvre.enters_s(view.scene.history.xy_m[row, -1])
    on_goal = [other for other in view.ways if other != row and _is_on(goal, view, other)]
    speeds_mps = manoeuvre.mean_and_end_speed(enters_s, view.speed(row))
    return all(entry_margin_m(view, row, other, enters_s, licence, speeds_mps) >= 0.0 for other in on_goal)


def _is_on(goal: Way, view: SituationView, other: int) -> bool:
    left = goal.line.project(view.scene.history.xy_m[other, -1], extrapolate=True)[1]
    return abs(float(left)) < 0.5 * (goal.present_lane.width_m + float(view.size(other)[1])) - 0.3


def entry_margin_m(
    view: SituationView,
    row: int,
    other: int,
    enters_s: float,
    licence: Licence,
    speeds_mps: tuple[float, float] | None = None,
) -> float:
    """Return the gap between *row* and *other* at the entry, less the gap that *licence* demands.

    *other* keeps its present acceleration.

    Args:
        view: the scene.
        row: row of the vehicle that enters.
        other: row of the vehicle on that lane.
        enters_s: time of the entry.
        licence: what it may do.
        speeds_mps: mean speed of *row* until then, and its speed then; None: it keeps its speed.
    """
    mean, speed = speeds_mps or (view.speed(row), view.speed(row))
    other_speed = view.speed(other) + view.speed_gain_mps2(other) * enters_s
    driven = enters_s * (mean - 0.5 * (view.speed(other) + other_speed))
    ahead = view.position_on(view.ways[other], row)[0] + driven
    gap = abs(ahead) - 0.5 * float(view.size(row)[0] + view.size(other)[0])
    follower, leader = (other_speed + 0.5, speed) if ahead > 0.0 else (speed, other_speed)
    return gap - (licence.gap_share * safe_gap_m(follower, leader) + licence.spare_m)


def _has_room(
    view: SituationView, manoeuvre: Manoeuvre, futures: ManoeuvreFutures, k: int, checked: slice
) -> bool:
    """Return whether the vehicle meets nobody but the target at the *checked* instants.

    All others keep their speeds on their ways. Followers on the same lane are left out, as drivers keep their distance
    to a leader. Pedestrians, and vehicles on no lane, keep their velocity and get more room.
    """
    rows = np.array(
        [
            r
            for r in view.ways
            if r not in (manoeuvre.row, view.scene.target) and not _follows(view, manoeuvre, r)
        ],
        dtype=np.int64,
    )
    own = manoeuvre.row, futures.xy_m[k, checked], futures.yaw_rad[k, checked]
    xy, yaw = view.constant_speed_poses(rows)
    is_clear = _is_clear_of(view, own, rows, xy[:, checked], yaw[:, checked], _ROOM_M)
    xy, yaw = view.constant_velocity_poses
    off_lane = view.off_lane_rows
    return is_clear and _is_clear_of(view, own, off_lane, xy[:, checked], yaw[:, checked], _PEOPLE_ROOM_M)


def _is_clear_of(
    view: SituationView,
    own: tuple[int, FloatArray, FloatArray],
    rows: IntArray,
    xy_m: FloatArray,
    yaw_rad: FloatArray,
    room_m: FloatArray,
) -> bool:
    """Return whether *own* (row, (T, 2), (T,)) keeps *room_m* (2,) to *rows* (R,), at (R, T, 2) with (R, T)."""
    own_row, own_xy, own_yaw = own
    is_near = np.linalg.norm(xy_m - own_xy, axis=-1).min(axis=1, initial=np.inf) < 12.0
    if not is_near.any():
        return True
    half = 0.5 * view.scene.history.size_m
    gaps = axis_gaps(
        xy_m[is_near] - own_xy,
        np.broadcast_to(own_yaw, yaw_rad[is_near].shape),
        half[own_row] + room_m,
        yaw_rad[is_near],
        half[rows[is_near]][:, None],
    )[0].max(-1)
    return bool((gaps > 0.0).all())


def _follows(view: SituationView, manoeuvre: Manoeuvre, other: int) -> bool:
    """Return whether *other* drives behind the vehicle of *manoeuvre* on the same lane."""
    ahead, left = view.position_on(view.ways[other], manoeuvre.row)
    return ahead > 0.0 and abs(left) < 1.2
