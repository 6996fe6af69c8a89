"""Running into somebody who stood, or braked as one must expect; and being pushed by a third."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.metrics.breaches.breach import Breach, BreachKind
from advdiff_sumo.metrics.breaches.lane_rules import SAME_WAY_RAD
from advdiff_sumo.metrics.collision import tracks_collisions
from advdiff_sumo.metrics.encounter import BREACH_WINDOW_S, Encounter, Party
from advdiff_sumo.metrics.traffic_view import TrafficView

#: Braking that one must expect of whoever drives ahead.
EXPECTED_BRAKE_MPS2 = 4.0
#: Braking is measured over this time; a single step of a log is noise.
_BRAKE_OVER_S = 0.5
#: Braking that ended longer ago than this is over.
_BRAKE_WITHIN_S = 3.0
_BRAKE_SLACK_MPS2 = 0.05


def ran_into(view: TrafficView, met: Encounter, which: int, excused: bool) -> Breach | None:
    """Return the breach of running, with the front, into somebody who could be expected there.

    That is somebody who has stood for a second; who drove ahead and braked by no more than 4 m/s²; or who entered
    the lane with a safe gap.

    Args:
        view: who is where.
        met: the collision with its circumstances.
        which: 0 or 1, whose breach.
        excused: the other broke a rule that put it there.
    """
    party, other = met.parties[which], met.parties[1 - which]
    if party.is_pedestrian or party.stands or party.face != "front" or excused:
        return None
    if pushed_by(view, met, which) is not None:
        return None
    text = _struck(view, met, other)
    return None if text is None else Breach(BreachKind.RAN_INTO, party.row, met.collision.time_s, text)


def _struck(view: TrafficView, met: Encounter, other: Party) -> str | None:
    name = f"'{other.name}'"
    if other.stood:
        return f"ran into {name}, which stood"
    same_way = met.collision.heading_difference_rad <= SAME_WAY_RAD
    hard = hardest_brake_mps2(view, other.row, met.collision.step) > EXPECTED_BRAKE_MPS2 + _BRAKE_SLACK_MPS2
    if same_way and other.face == "rear" and not hard:
        return f"ran into the rear of {name}"
    entry = met.entry
    visible = entry is not None and entry.row == other.row and (entry.safe or entry.recovered)
    if visible and not hard and not met.crossing and not (entry is not None and entry.oncoming):
        return f"ran into {name}, which had entered its lane with room to brake"
    return None


def hardest_brake_mps2(view: TrafficView, row: int, step: int) -> float:
    """Return the hardest braking of agent *row* over half a second within the last three before *step*."""
    over = max(1, view.steps(_BRAKE_OVER_S))
    speed = np.abs(view.tracks.speed_mps[row, max(0, step - view.steps(_BRAKE_WITHIN_S)) : step + 1])
    speed = speed[np.isfinite(speed)]
    over = min(over, len(speed) - 1)
    if over < 1:
        return 0.0
    braking: FloatArray = (speed[:-over] - speed[over:]) / (over * view.tracks.dt_s)
    return float(max(0.0, braking.max()))


def pushed_by(view: TrafficView, met: Encounter, which: int) -> int | None:
    """Return the row of a third road user that ran into the party from behind or the side before; None: nobody."""
    party, step = met.parties[which], met.collision.step
    start = max(0, step - view.steps(BREACH_WINDOW_S))
    near = _around(view, party.row, start, step)
    if len(near) < 2:
        return None
    tracks = view.tracks.window(start, step + 2).rows(near)
    for contact in tracks_collisions(tracks, near.index(party.row)):
        first, second = (near[i] for i in contact.rows)
        third = second if first == party.row else first
        earlier = contact.time_s < met.collision.time_s and not contact.initial
        if party.row not in (first, second) or third == met.parties[1 - which].row or not earlier:
            continue
        own, its = contact.faces if first == party.row else contact.faces[::-1]
        if own != "front" and its == "front":
            return third
    return None


def _around(view: TrafficView, row: int, start: int, step: int) -> list[int]:
    """Return the rows of agents that come within 20 m of agent *row*, itself included."""
    span = slice(start, step + 2)
    xy = view.tracks.xy_m[:, span]
    apart = np.hypot(*np.moveaxis(xy - xy[row], -1, 0))
    near = np.nan_to_num(apart, nan=np.inf).min(axis=1) < 20.0
    return [int(i) for i in np.flatnonzero(near)]
