"""Rules that the target broke of itself, whether or not it led to a collision: what a test engineer files as well."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np

from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.breaches.breach import Breach, BreachKind
from advdiff_sumo.metrics.breaches.conduct_rules import REVERSING_MPS, drove_backwards, drove_too_fast
from advdiff_sumo.metrics.breaches.giving_way import not_given_way
from advdiff_sumo.metrics.breaches.junction_rules import ON_RED, ran_red
from advdiff_sumo.metrics.breaches.lane_rules import on_opposite_lane
from advdiff_sumo.metrics.encounter import WRONG_WAY_RAD, junction_entries
from advdiff_sumo.metrics.placement import Placement
from advdiff_sumo.metrics.traffic_view import TrafficView

OF_ITSELF = frozenset(
    {
        *(BreachKind.RED_LIGHT, BreachKind.WRONG_SIDE, BreachKind.RIGHT_OF_WAY),
        *(BreachKind.SPEEDING, BreachKind.REVERSING),
    }
)
"""Rules that a target can break without a collision."""
#: Against the direction of traffic for at least so long, looked at so often, and faster than this.
WRONG_SIDE_S, _EVERY_S, _MOVES_MPS = 1.5, 0.5, 1.0
_ROUNDING = 1e-6


def offences(record: EpisodeRecord, road: RoadMap) -> tuple[Breach, ...]:
    """Return the rules that the target broke, in the order of time; speed, side and direction once at most.

    Leaving the road is a collision, and not among them. A red light counts where the signal was red from the instant
    before the front passed the line until the centre was on the junction, and giving way where somebody with the right
    of way had to brake hard (:mod:`~advdiff_sumo.metrics.breaches.giving_way`).

    Args:
        record: the episode; without signals it has no red lights.
        road: its map.
    """
    if record.tracks.classes[record.target] == AgentClass.PEDESTRIAN:
        return ()
    view = TrafficView.of_record(record, road)
    breaches = chain(
        _red_lights(view, record.target),
        not_given_way(record, view),
        _wrong_side(view, record.target),
        _speed_and_direction(view, record.target),
    )
    return tuple(sorted(breaches, key=lambda one: one.time_s))


def offences_sentence(some: Sequence[Breach]) -> str:
    """Return *some* as a sentence: "The target entered the junction on red (4.2 s)."; "" for none."""
    return f"The target {', '.join(f'{one.text} ({one.time_s:.1f} s)' for one in some)}." if some else ""


def _red_lights(view: TrafficView, row: int) -> Iterator[Breach]:
    for entry in junction_entries(view, row):
        if ran_red(view, entry):
            yield Breach(BreachKind.RED_LIGHT, row, view.time_s(entry.entered_step), ON_RED)


def _speed_and_direction(view: TrafficView, row: int) -> Iterator[Breach]:
    """Yield the greatest excess of the limit, and the first instant at which it reverses by the rule of contacts."""
    stop, second = view.tracks.steps, view.steps(1.0)
    too_fast = drove_too_fast(view, row, 0, stop)
    back = np.flatnonzero(view.tracks.speed_mps[row] < -REVERSING_MPS).tolist()
    backwards = (drove_backwards(view, row, max(0, k - second), k + 1) for k in back)
    for one in (too_fast, next((one for one in backwards if one is not None), None)):
        if one is not None:
            yield one


def _wrong_side(view: TrafficView, row: int) -> Iterator[Breach]:
    """Yield the first time that it goes on against its lane, or on one of the opposite direction, between junctions."""
    tracks, lanes, every = view.tracks, view.place(row, 0, view.tracks.steps), max(1, view.steps(_EVERY_S))
    count, looks = 0, math.ceil(WRONG_SIDE_S / (every * tracks.dt_s) - _ROUNDING) + 1
    for at in range(0, tracks.steps, every):
        name = lanes.lane[at]
        drives = tracks.valid[row, at] and tracks.speed_mps[row, at] > _MOVES_MPS
        between = name is None or not view.road.lanes[name].is_internal
        against = drives and between and _is_against(view, row, lanes, at)
        count = count + 1 if against else 0
        if count == looks:
            text = "drove on the wrong side of the road"
            yield Breach(BreachKind.WRONG_SIDE, row, view.time_s(at - count * every + every), text)
            return


def _is_against(view: TrafficView, row: int, lanes: Placement, at: int) -> bool:
    turned = np.abs(lanes.yaw_error_rad[at]) > WRONG_WAY_RAD and lanes.lane[at] is not None
    return bool(turned or on_opposite_lane(view, row, lanes, at, 0))
