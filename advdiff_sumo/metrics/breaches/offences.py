"""Traffic rules that the target broke, whether or not this led to a collision."""

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
from advdiff_sumo.metrics.breaches.following_offences import close_following, unsafe_lane_entries
from advdiff_sumo.metrics.breaches.giving_way import giving_way_breaches
from advdiff_sumo.metrics.breaches.junction_rules import ON_RED, ran_red
from advdiff_sumo.metrics.breaches.lane_rules import on_opposite_lane
from advdiff_sumo.metrics.encounter import WRONG_WAY_RAD, junction_entries
from advdiff_sumo.metrics.needless_braking import needless_braking
from advdiff_sumo.metrics.placement import Placement
from advdiff_sumo.metrics.traffic_view import TrafficView

OFFENCE_KINDS = frozenset(
    {
        *(BreachKind.RED_LIGHT, BreachKind.WRONG_SIDE, BreachKind.RIGHT_OF_WAY),
        *(BreachKind.UNSAFE_LANE_ENTRY, BreachKind.SIDEWAYS, BreachKind.CLOSE_FOLLOWING),
        *(BreachKind.SPEEDING, BreachKind.REVERSING, BreachKind.NEEDLESS_BRAKING),
    }
)
"""Rules that a target can break without a collision."""
#: Driving against the direction of traffic is an offence if it lasts at least this long.
WRONG_SIDE_S = 1.5
# It is checked at this interval, from any instant on, and only while the target is faster than this.
_EVERY_S, _MOVING_MPS = 0.5, 1.0
_ROUNDING = 1e-6


def offences(record: EpisodeRecord, road: RoadMap) -> tuple[Breach, ...]:
    """Return the rules that the target broke, in time order.

    Speeding, wrong side, reversing, close following and needless braking are returned at most once each.

    Leaving the road counts as a collision and is not included. A red light counts if the signal was red from the
    instant before the front passed the line until the centre was on the junction. Giving way counts if a vehicle with
    the right of way had to brake hard (:mod:`~advdiff_sumo.metrics.breaches.giving_way`). So does entering a lane
    (:mod:`~advdiff_sumo.metrics.breaches.following_offences`).

    Args:
        record: the episode; without signals there are no red lights.
        road: its map.
    """
    if record.tracks.classes[record.target] == AgentClass.PEDESTRIAN:
        return ()
    view = TrafficView.of_record(record, road)
    breaches = chain(
        _red_lights(view, record.target),
        giving_way_breaches(record, view),
        unsafe_lane_entries(record, view),
        close_following(record, view),
        needless_braking(record, view),
        _wrong_side(view, record.target),
        _speed_and_direction(view, record.target),
    )
    return tuple(sorted(breaches, key=lambda x: x.time_s))


def offences_sentence(breaches: Sequence[Breach]) -> str:
    """Return *breaches* as a sentence: "The target entered the junction on red (4.2 s)."; "" for none."""
    return f"The target {', '.join(f'{x.text} ({x.time_s:.1f} s)' for x in breaches)}." if breaches else ""


def _red_lights(view: TrafficView, row: int) -> Iterator[Breach]:
    for entry in junction_entries(view, row):
        if ran_red(view, entry):
            yield Breach(BreachKind.RED_LIGHT, row, view.time_s(entry.entered_step), ON_RED)


def _speed_and_direction(view: TrafficView, row: int) -> Iterator[Breach]:
    """Yield speeding, where it is worst, and the first reversing, judged over one second as at a contact."""
    stop, second = view.tracks.steps, view.steps(1.0)
    too_fast = drove_too_fast(view, row, 0, stop)
    backward_steps = np.flatnonzero(view.tracks.speed_mps[row] < -REVERSING_MPS).tolist()
    reversals = (drove_backwards(view, row, max(0, k - second), k + 1) for k in backward_steps)
    for breach in (too_fast, next((x for x in reversals if x is not None), None)):
        if breach is not None:
            yield breach


def _wrong_side(view: TrafficView, row: int) -> Iterator[Breach]:
    """Yield the first stretch between junctions that it drives against its lane or on one of the opposite direction."""
    tracks, lanes, every = view.tracks, view.place(row, 0, view.tracks.steps), max(1, view.steps(_EVERY_S))
    needed = math.ceil(WRONG_SIDE_S / (every * tracks.dt_s) - _ROUNDING) + 1
    counts = np.zeros(
        tracks.steps, dtype=np.int64
    )  # of the checks up to each instant, the last ones in a row
    for k in range(tracks.steps):
        name = lanes.lane[k]
        moving = tracks.valid[row, k] and tracks.speed_mps[row, k] > _MOVING_MPS
        off_junction = name is None or not view.road.lanes[name].is_internal
        if moving and off_junction and _is_against_traffic(view, row, lanes, k):
            counts[k] = 1 + (counts[k - every] if k >= every else 0)
        if counts[k] == needed:
            text = "drove on the wrong side of the road"
            yield Breach(BreachKind.WRONG_SIDE, row, view.time_s(k - (needed - 1) * every), text)
            return


def _is_against_traffic(view: TrafficView, row: int, lanes: Placement, instant: int) -> bool:
    wrong_way = np.abs(lanes.yaw_error_rad[instant]) > WRONG_WAY_RAD and lanes.lane[instant] is not None
    return bool(wrong_way or on_opposite_lane(view, row, lanes, instant, 0))
