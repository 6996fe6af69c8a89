"""Running into a road user that stood or braked as must be expected; being pushed by a third."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.metrics.breaches.breach import Breach, BreachKind
from advdiff_sumo.metrics.breaches.lane_rules import SAME_WAY_RAD
from advdiff_sumo.metrics.collision import tracks_collisions
from advdiff_sumo.metrics.encounter import BREACH_WINDOW_S, Encounter, Party
from advdiff_sumo.metrics.traffic_view import TrafficView

#: Braking of a leader that a follower must expect.
EXPECTED_BRAKE_MPS2 = 4.0
#: Braking is measured over this time, since single steps of a log are noisy.
BRAKE_OVER_S = 0.5
#: Braking that ended longer ago than this does not count.
_BRAKE_WITHIN_S = 3.0
_BRAKE_TOLERANCE_MPS2 = 0.05
#: Only agents that come within this distance may have pushed the party.
_NEAR_M = 20.0


def ran_into(view: TrafficView, case: Encounter, index: int, excused: bool) -> Breach | None:
    """Return the breach of running with the front into a road user that could be expected there.

    The other has stood for a second, or drove ahead and braked at no more than 4 m/s², or entered the lane with a safe
    gap.

    Args:
        view: the traffic.
        case: the collision with its circumstances.
        index: index of the party, 0 or 1.
        excused: whether the other broke a rule that put it there.
    """
    party, other = case.parties[index], case.parties[1 - index]
    if party.is_pedestrian or party.stands or party.face != "front" or excused:
        return None
    if pushed_by(view, case, index) is not None:
        return None
    text = _striking_text(view, case, other)
    return None if text is None else Breach(BreachKind.RAN_INTO, party.row, case.collision.time_s, text)


def _striking_text(view: TrafficView, case: Encounter, other: Party) -> str | None:
    """Return the phrase for running into *other*; None if it could not be expected there."""
    name, who = f"'{other.name}'", "who" if other.is_pedestrian else "which"
    if other.stood:
        return f"ran into {name}, {who} stood"
    same_way = case.collision.heading_difference_rad <= SAME_WAY_RAD
    braking = hardest_brake_mps2(view, other.row, case.collision.step)
    hard = braking > EXPECTED_BRAKE_MPS2 + _BRAKE_TOLERANCE_MPS2
    if same_way and other.face == "rear" and not hard:
        return f"ran into the rear of {name}"
    entry = case.entry
    entered_safely = entry is not None and entry.row == other.row and (entry.safe or entry.recovered)
    if entered_safely and not hard and not case.crossing and not (entry is not None and entry.oncoming):
        return f"ran into {name}, {who} had entered its lane with room to brake"
    return None


def hardest_brake_mps2(view: TrafficView, row: int, step: int) -> float:
    """Return the hardest braking of agent *row*, averaged over half a second, in the three seconds before *step*."""
    count = max(1, view.steps(BRAKE_OVER_S))
    speed = np.abs(view.tracks.speed_mps[row, max(0, step - view.steps(_BRAKE_WITHIN_S)) : step + 1])
    speed = speed[np.isfinite(speed)]
    count = min(count, len(speed) - 1)
    if count < 1:
        return 0.0
    return float(max(0.0, mean_braking_mps2(speed, count, view.tracks.dt_s).max()))


def mean_braking_mps2(speed_mps: FloatArray, over: int, dt_s: float) -> FloatArray:
    """Return (T − over,) the mean deceleration over *over* ≥ 1 steps up to each later instant of *speed_mps* (T,)."""
    return (speed_mps[:-over] - speed_mps[over:]) / (over * dt_s)


def pushed_by(view: TrafficView, case: Encounter, index: int) -> int | None:
    """Return the row of a third road user that ran into the party's rear or side before; None without one."""
    party, step = case.parties[index], case.collision.step
    start = max(0, step - view.steps(BREACH_WINDOW_S))
    near = _nearby_rows(view, party.row, start, step)
    if len(near) < 2:
        return None
    tracks = view.tracks.window(start, step + 2).rows(near)
    for contact in tracks_collisions(tracks, near.index(party.row)):
        first, second = (near[i] for i in contact.rows)
        third = second if first == party.row else first
        earlier = contact.time_s < case.collision.time_s and not contact.initial
        if party.row not in (first, second) or third == case.parties[1 - index].row or not earlier:
            continue
        own_face, third_face = contact.faces if first == party.row else contact.faces[::-1]
        if own_face != "front" and third_face == "front":
            return third
    return None


def _nearby_rows(view: TrafficView, row: int, start: int, step: int) -> list[int]:
    """Return the rows of agents that come within ``_NEAR_M`` of agent *row*, itself included."""
    xy = view.tracks.xy_m[:, start : step + 2]
    distance = np.hypot(*np.moveaxis(xy - xy[row], -1, 0))
    near = np.nan_to_num(distance, nan=np.inf).min(axis=1) < _NEAR_M
    return [int(i) for i in np.flatnonzero(near)]
