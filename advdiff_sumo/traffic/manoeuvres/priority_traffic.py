"""Where a vehicle must be now to meet the target at a junction where the target has to let it pass."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from advdiff_sumo.core.polylines import distances_m
from advdiff_sumo.core.signal_letters import PROTECTED_GREEN
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.junction_priority import come_head_on, priority_links
from advdiff_sumo.maps.lanes import Lane, Link
from advdiff_sumo.maps.link_points import points_over
from advdiff_sumo.traffic.manoeuvres.free_speed import bend_mps
from advdiff_sumo.traffic.manoeuvres.intensity import MOST_EARLY_S
from advdiff_sumo.traffic.manoeuvres.required_braking import REACTION_S, TargetWay
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.ways import Way

SHORT_GAPS = "short-gaps"
"""Name of the attack by a stream of vehicles with priority, with gaps in which a careful driver does not go."""
STREAM_GAP_S = 2.2
"""Time between two vehicles of a stream."""
REACH_M = 80.0
"""Junctions farther ahead than this are ignored."""
SLOWEST_TARGET_MPS = 3.0
"""For a slower target no vehicle is inserted, and none is timed to cross its way."""
_EARLIEST_S, _LATEST_S, _LATEST_AT_RED_S = 3.2, 6.0, 5.0  # when the target may be at the conflict point
_MIN_ARRIVAL_S = 1.7  # least time until the other vehicle arrives, if it is prescribed
_SLOWEST_MPS, _FASTEST_MPS, _SLOWEST_SHARE = 3.0, 12.0, 0.6  # of the other vehicle; share of its limit
CAREFUL_STOP_MPS2 = 4.0
"""Braking with which a careful driver still stops at its line for an inserted vehicle."""
_WAITS_BEFORE_M = 2.5
"""Distance before the middle of the other's lane at which a vehicle that turns across it waits."""
_ARRIVAL_OFFSETS_S, _ARRIVAL_OFFSETS_AT_RED_S = (0.0, 0.7, -0.7), (0.5, 0.0, 1.0)
"""How much later than the target the other vehicle arrives: the values that are tried, best first."""
_LIMIT_SHARE_AT_RED = 0.8
"""Share of the limit for a vehicle that may have to hurry or to hesitate."""
_CONFLICT_M, _BEYOND_M, _SPACING_M = 2.0, 6.0, 0.5
"""Distance of centres that is a conflict; how far beyond the junction it is searched for; spacing of that search."""
_MIN_TO_LINE_M = 8.0


@dataclass(frozen=True)
class Approach:
    """A vehicle that would meet the target.

    Attributes:
        way: its way, which begins where it would be now.
        speed_mps: its speed.
    """

    way: Way
    speed_mps: float


def priority_approaches(
    view: SituationView, oncoming: bool, early_s: float | None = None, from_ahead_only: bool = False
) -> Iterator[Approach]:
    """Yield vehicles that have priority over the target at its next junctions and would meet it there, best first.

    Those that turn come only where none goes straight on, and are no faster than their bend asks for.

    The target is assumed not to respond. There are none for a target that is slow, waits behind another vehicle, or is
    too near to yield: at its stop line or, to oncoming traffic, before the conflict point.

    Args:
        view: the scene.
        oncoming: whether oncoming vehicles are preferred to those from the sides.
        early_s: how long before the target they arrive; None: at about the same time.
        from_ahead_only: whether only oncoming vehicles are wanted.
    """
    target = view.target
    if target is None or target.speed_mps < SLOWEST_TARGET_MPS:
        return
    stop_distance_m = _stop_distance_m(target)
    for line_m, link in target.way.links:
        if not 0.0 < line_m < REACH_M or not view.is_clear_on_arrival(line_m):
            return
        is_red = view.is_red(link)
        conflicts = [
            (other, points)
            for other in _conflicting_links(view, link, oncoming, from_ahead_only)
            if (points := conflict_points_m(view.road, link, other))
            and stop_distance_m <= line_m + _waits_beyond_line_m(view, link, other, points[0])
        ]
        if is_red:
            # a short way leaves the least time to perceive it
            conflicts.sort(key=lambda conflict: conflict[1][1])
        for other, points in conflicts:
            meets_s = target.arrival_s(line_m + points[0])
            # a prescribed time leaves room for every severity
            earliest_s = _EARLIEST_S if early_s is None else MOST_EARLY_S + _MIN_ARRIVAL_S
            if earliest_s < meets_s < (_LATEST_AT_RED_S if is_red else _LATEST_S):
                usual_offsets_s = _ARRIVAL_OFFSETS_AT_RED_S if is_red else _ARRIVAL_OFFSETS_S
                offsets_s = usual_offsets_s if early_s is None else (-early_s,)
                arrivals_s = [meets_s + offset_s for offset_s in offsets_s]
                limit_share = _LIMIT_SHARE_AT_RED if is_red else 1.0
                yield from _arriving_at(view, other, arrivals_s, points[1], limit_share)
        if is_red:
            return


def next_of_stream(view: SituationView, last: int) -> Iterator[Approach]:
    """Yield a vehicle that comes to the target's next junction ``STREAM_GAP_S`` after *last*, on the same way.

    There is none once *last* is over its stop line, or if the target need not let it pass.

    Args:
        view: the scene.
        last: row of the last vehicle of the stream.
    """
    target, way = view.target, view.ways.get(last)
    if target is None or way is None or not way.links or not target.way.links:
        return
    (own_line_m, own_link), (line_m, link) = way.links[0], target.way.links[0]
    has_priority = own_link in priority_links(view.road, link, view.scene.signals)
    points = conflict_points_m(view.road, link, own_link) if has_priority else None
    if points is None or not 0.0 < line_m < REACH_M or view.is_red(link):
        return
    arrives_s = (own_line_m + points[1]) / max(view.speed(last), _SLOWEST_MPS)
    yield from _arriving_at(view, own_link, (arrives_s + STREAM_GAP_S,), points[1], 1.0)


def _conflicting_links(view: SituationView, link: Link, oncoming: bool, from_ahead_only: bool) -> list[Link]:
    """Return the links that have priority over *link*, if any go straight on only these, the preferred ones first."""
    links = [
        other
        for other in priority_links(view.road, link, view.scene.signals)
        if not from_ahead_only or come_head_on(view.road, link, other)
    ]
    links = [other for other in links if other.direction == "s"] or links
    return sorted(links, key=lambda other: come_head_on(view.road, link, other) is not oncoming)


def _stop_distance_m(target: TargetWay) -> float:
    """Return how far ahead of the target's centre its front stops if a careful driver perceives a reason to now."""
    braking_m = float(target.braked_motion((CAREFUL_STOP_MPS2,), REACTION_S)[0][0, -1])
    return braking_m + 0.5 * float(target.size_m[0])


def _waits_beyond_line_m(view: SituationView, link: Link, other: Link, conflict_m: float) -> float:
    """Return how far beyond its line a vehicle on *link* waits for *other*, with the conflict at *conflict_m*."""
    return max(conflict_m - _WAITS_BEFORE_M, 0.0) if come_head_on(view.road, link, other) else 0.0


@lru_cache(maxsize=4096)
def conflict_points_m(road: RoadMap, link: Link, other: Link) -> tuple[float, float] | None:
    """Return how far beyond each stop line the centres of two vehicles meet; None if they stay apart."""
    own_xy, other_xy = (points_over(road, x, _BEYOND_M, _SPACING_M) for x in (link, other))
    distances = distances_m(own_xy, other_xy)
    is_conflict = distances.min(axis=1) < _CONFLICT_M
    if not is_conflict.any():
        return None
    rows = np.flatnonzero(is_conflict)
    row = rows[0] if link.to_lane == other.to_lane else rows[len(rows) // 2]
    return _SPACING_M * float(row), _SPACING_M * float(distances[row].argmin())


def turn_speed_mps(road: RoadMap, link: Link) -> float:
    """Return the highest speed over the junction on *link*, by the limits and bends of its lanes; inf straight on."""
    lanes = [road.lanes[name] for name in link.via if link.direction != "s"]
    return min((min(lane.speed_mps, bend_mps(lane)) for lane in lanes), default=np.inf)


def _arriving_at(
    view: SituationView,
    link: Link,
    arrivals_s: Sequence[float],
    conflict_m: float,
    limit_share: float,
) -> Iterator[Approach]:
    """Yield vehicles that are *conflict_m* beyond the stop line of *link* at one of *arrivals_s*.

    They drive at *limit_share* of the limit, at most 12 m/s, where they turn as slowly as the bend asks for, and more
    slowly on too short a road.
    """
    lane_mps = view.road.lanes[link.from_lane].speed_mps
    limit = min(limit_share * min(lane_mps, _FASTEST_MPS / limit_share), turn_speed_mps(view.road, link))
    upstream = _upstream(view, link)
    upstream_m = sum(lane.length_m for lane in upstream)
    for arrival_s in arrivals_s:
        to_line_m = min(limit * arrival_s - conflict_m, upstream_m - 1.0)
        speed = (to_line_m + conflict_m) / max(arrival_s, 0.1)
        if to_line_m < _MIN_TO_LINE_M or speed < max(_SLOWEST_SHARE * limit, _SLOWEST_MPS):
            continue
        way = _way_over(view, upstream, link, to_line_m)
        if way is not None and link in (link_ahead for _, link_ahead in way.links):
            yield Approach(way, min(speed, limit))


def _upstream(view: SituationView, link: Link) -> list[Lane]:
    """Return the lanes that lead straight to *link* with right of way, nearest first, internal ones included."""
    lanes = view.road.lanes
    upstream = [lanes[link.from_lane]]
    links_into = _straight_links_into(view.road)
    while sum(lane.length_m for lane in upstream) < REACH_M:
        before = links_into.get(upstream[-1].id)
        if before is None or before.yields or view.signal(before) not in ("", PROTECTED_GREEN):
            break
        upstream += [*(lanes[name] for name in reversed(before.via)), lanes[before.from_lane]]
    return upstream


def _way_over(view: SituationView, upstream: Sequence[Lane], link: Link, to_line_m: float) -> Way | None:
    """Return the way over *link* that begins on *upstream*, *to_line_m* before its stop line; None on a junction."""
    edges, left_m = [view.road.lanes[link.to_lane].edge_id], to_line_m
    for lane in upstream:
        if not lane.is_internal:
            edges.append(lane.edge_id)
        if left_m < lane.length_m:
            if lane.is_internal:
                return None
            return view.way_from(lane.line.at(lane.length_m - left_m), edges[::-1])
        left_m -= lane.length_m
    return None


@lru_cache(maxsize=4)
def _straight_links_into(road: RoadMap) -> Mapping[str, Link]:
    """Return lane → the link that leads straight into it."""
    return {link.to_lane: link for link in road.links.values() if link.direction == "s"}
