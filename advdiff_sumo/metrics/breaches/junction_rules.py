"""Rules at junctions and pedestrian crossings: red lights and giving way."""

from __future__ import annotations

import numpy as np
import shapely

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.boxes import corners
from advdiff_sumo.core.signal_letters import PROTECTED_GREEN, RED
from advdiff_sumo.metrics.breaches.breach import Breach, BreachKind
from advdiff_sumo.metrics.encounter import (
    BREACH_WINDOW_S,
    LEAST_SPEED_MPS,
    STOOD_S,
    Encounter,
    JunctionEntry,
    Party,
)
from advdiff_sumo.metrics.safe_gap import safe_gap_m
from advdiff_sumo.metrics.traffic_view import TrafficView

#: Text of the breach of running a red light.
ON_RED = "entered the junction on red"
#: At a junction without right of way, a vehicle that comes later by more than this gives way.
ARRIVAL_MARGIN_S = 1.0
#: Pedestrians within this distance of a crossing's centre line, which is all the net holds, are on the crossing.
_CROSSING_HALF_WIDTH_M = 2.5


def red_light(view: TrafficView, case: Encounter, index: int) -> Breach | None:
    """Return the breach of entering the junction of *case* on red, unless the other came by the same approach."""
    party = case.parties[index]
    hit_pedestrian = case.parties[1 - index].is_pedestrian
    if not (case.crossing or hit_pedestrian) or not ran_red(view, party) or not _is_recent(view, case, party):
        return None
    return _breach(view, case, BreachKind.RED_LIGHT, party, ON_RED)


def right_of_way(view: TrafficView, case: Encounter, index: int) -> Breach | None:
    """Return the breach of not giving way to the other at the junction, or at the pedestrian crossing, of *case*.

    A party that has stood there for a second could be seen and did not cause the collision. Neither did one that joined
    the other's lane with a safe gap.
    """
    party, other = case.parties[index], case.parties[1 - index]
    if party.stood or party.is_pedestrian or (other.stood and not other.is_pedestrian):
        return None
    if signals_are_unknown(view, case):
        return None
    if other.is_pedestrian:
        return _crossing_breach(view, case, party, other)
    if not case.crossing or not _is_recent(view, case, party):
        return None
    if (
        ran_red(view, party)
        or ran_red(view, other)
        or joined_safely(case, index)
        or not must_give_way(view, case, index)
    ):
        return None
    return _breach(
        view, case, BreachKind.RIGHT_OF_WAY, party, f"did not give way to '{other.name}' at the junction"
    )


def breach_towards_pedestrian(view: TrafficView, case: Encounter, walker: int) -> Breach | None:
    """Return the breach by which the other drove into a pedestrian: on red, or on a crossing; else None.

    On a crossing it counts only if the other still had room to stop when the pedestrian left the kerb or, after
    standing, walked on.

    Args:
        view: the traffic.
        case: the collision with its circumstances.
        walker: index of the party that may be a pedestrian, 0 or 1.
    """
    if not case.parties[walker].is_pedestrian:
        return None
    on_red = red_light(view, case, 1 - walker)
    if on_red is not None or not _could_stop(view, case, walker):
        return on_red
    return right_of_way(view, case, 1 - walker)


def _could_stop(view: TrafficView, case: Encounter, walker: int) -> bool:
    """Return whether the other had the safe gap to the point of contact when *walker* came onto the crossing."""
    tracks, hit = view.tracks, case.collision
    other = case.parties[1 - walker].row
    begin = _walks_on_crossing_since(view, case.parties[walker], hit.step, tracks.valid[other])
    path = np.vstack((tracks.xy_m[other, begin : hit.step + 1], hit.xy_m[hit.rows.index(other)]))
    distance_m = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    return distance_m >= safe_gap_m(abs(float(tracks.speed_mps[other, begin])), 0.0)


def _walks_on_crossing_since(view: TrafficView, walker: Party, last: int, other_present: BoolArray) -> int:
    """Return the instant since which *walker* has walked on a crossing, with pauses of at most ``STOOD_S``.

    Args:
        view: the traffic.
        walker: the pedestrian.
        last: instant before the contact.
        other_present: (T,) whether the other is present.
    """
    tracks, row, begin, areas = view.tracks, walker.row, last, _crossing_areas(view)
    for step in range(last - 1, max(-1, last - view.steps(BREACH_WINDOW_S) - 1), -1):
        if not (other_present[step] and tracks.valid[row, step]) or begin - step > view.steps(STOOD_S):
            break
        if not any(area.intersects(shapely.Point(tracks.xy_m[row, step])) for area in areas):
            break
        if abs(float(tracks.speed_mps[row, step])) > LEAST_SPEED_MPS:
            begin = step
    return begin


def _crossing_areas(view: TrafficView) -> list[shapely.Polygon]:
    """Return the areas of pedestrian crossings, from kerb to kerb."""
    lines = (shapely.LineString(xy) for xy in _crossing_lines(view))
    return [line.buffer(_CROSSING_HALF_WIDTH_M, cap_style="flat") for line in lines]


def _crossing_lines(view: TrafficView) -> list[FloatArray]:
    """Return the centre lines (N, 2) of pedestrian crossings."""
    shapes = view.road.pedestrian_shapes  # of crossings ":JUNCTION_c0" and walking areas ":JUNCTION_w0"
    return [xy for name, xy in shapes.items() if name.rpartition("_")[2].startswith("c") and len(xy) > 1]


def ran_red(view: TrafficView, party: Party | JunctionEntry) -> bool:
    """Return whether the signal of *party* was red from when its front passed the line until its centre entered."""
    states = signals_at_entry(view, party)
    return bool(states) and all(state in RED for state in states)


def signals_at_entry(view: TrafficView, party: Party | JunctionEntry) -> list[str]:
    """Return the signal letters of *party* at each instant from just before its front passed the line to its entry.

    [] if unknown. The whole span counts because a vehicle may wait with its front over the line.
    """
    link, first, last = party.link, party.line_step, party.entered_step
    if link is None or link.tls_id is None or link.tls_index is None or link.tls_index < 0:
        return []
    if first is None or last is None:
        return []
    states = [s.get(link.tls_id, "") for s in view.signals[max(0, first - 1) : last + 1]]
    return [s[link.tls_index] for s in states] if all(len(s) > link.tls_index for s in states) else []


def signals_are_unknown(view: TrafficView, case: Encounter) -> bool:
    """Return whether a light with unknown signals controls the junction, or the crossing, of *case*.

    The net's right-of-way rows then decide nothing: they apply to vehicles that have green at the same time.
    """
    lights = {party.link.tls_id for party in case.parties if party.link is not None} - {None}
    if not any(all(light not in states for states in view.signals) for light in lights):
        return False
    return case.crossing or any(
        x.is_pedestrian and on_crossing(view, x, case.collision.step) for x in case.parties
    )


def must_give_way(view: TrafficView, case: Encounter, index: int) -> bool:
    """Return whether the party must give way: by the net or, if that obliges neither or both, by coming later."""
    obliged = must_yield(view, *case.parties), must_yield(view, *case.parties[::-1])
    if obliged[0] != obliged[1]:
        return obliged[index]
    later_s = later_by_s(view, case)
    if later_s is None:
        return False
    return (later_s if index == 0 else -later_s) > ARRIVAL_MARGIN_S


def later_by_s(view: TrafficView, case: Encounter) -> float | None:
    """Return how much later than the other the target passed its line; None if unknown."""
    target, other = case.target.line_step, case.other.line_step
    return None if target is None or other is None else (target - other) * view.tracks.dt_s


def must_yield(view: TrafficView, party: Party, to: Party) -> bool:
    """Return whether *party* must give way to *to* by the net; one that enters on a protected green never must."""
    if party.link is None or to.link is None or PROTECTED_GREEN in signals_at_entry(view, party):
        return False
    return view.road.must_yield(party.link, to.link)


def _is_recent(view: TrafficView, case: Encounter, party: Party) -> bool:
    """Return whether *party* entered the junction within ``BREACH_WINDOW_S``, or at an unknown time."""
    entered = party.entered_step
    return entered is None or case.collision.step - entered <= view.steps(BREACH_WINDOW_S)


def joined_safely(case: Encounter, index: int) -> bool:
    """Return whether the other ran into the rear of the party after the party had joined its way with a safe gap."""
    entry = case.entry
    if entry is None or entry.row != case.parties[index].row or not entry.ahead:
        return False
    return (entry.safe or entry.recovered) and case.is_run_into(index)


def _crossing_breach(view: TrafficView, case: Encounter, party: Party, walker: Party) -> Breach | None:
    """Return the breach of running into a pedestrian on a crossing, unless the driver had a protected green."""
    if PROTECTED_GREEN in signals_at_entry(view, party) or not on_crossing(view, walker, case.collision.step):
        return None
    return _breach(
        view,
        case,
        BreachKind.RIGHT_OF_WAY,
        party,
        f"did not give way to '{walker.name}' on the crossing",
    )


def on_crossing(view: TrafficView, walker: Party, step: int) -> bool:
    """Return whether *walker* is on a pedestrian crossing at instant *step*."""
    tracks, row = view.tracks, walker.row
    box = shapely.Polygon(corners(tracks.xy_m[row, step], tracks.yaw_rad[row, step], tracks.size_m[row]))
    return any(shapely.LineString(xy).distance(box) <= _CROSSING_HALF_WIDTH_M for xy in _crossing_lines(view))


def _breach(view: TrafficView, case: Encounter, kind: BreachKind, party: Party, text: str) -> Breach:
    """Return the breach, with the time of the entry into the junction; of the contact if that is unknown."""
    step = case.collision.step if party.entered_step is None else party.entered_step
    return Breach(kind, party.row, view.time_s(step), text)
