"""Rules about vehicles in one lane that the target breaks without a collision: entering unsafely, following closely.

Both rest on the safe gap of RSS (:mod:`~advdiff_sumo.metrics.safe_gap`), but less than it is no offence by itself:

- An unsafe lane entry made the vehicle behind brake hard (:mod:`~advdiff_sumo.metrics.breaches.hard_braking`).
- Close following is less than half the safe gap for a while, as German law fines less than half the proper distance
  if it is kept for more than a moment (BKatV, table 2).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, IntArray
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.metrics.breaches.breach import Breach, BreachKind
from advdiff_sumo.metrics.breaches.hard_braking import nearby_vehicles, required_brake_mps2
from advdiff_sumo.metrics.breaches.lane_rules import unsafe_entry_breach
from advdiff_sumo.metrics.breaches.striking_rules import BRAKE_OVER_S, EXPECTED_BRAKE_MPS2, mean_braking_mps2
from advdiff_sumo.metrics.encounter import BREACH_WINDOW_S, HISTORY_S
from advdiff_sumo.metrics.following import following_gaps
from advdiff_sumo.metrics.lane_entry import CUT_IN_WINDOW_S, LaneEntry, lane_changes, lane_entry
from advdiff_sumo.metrics.safe_gap import safe_gap_m
from advdiff_sumo.metrics.traffic_view import TrafficView

#: Following with less than this share of the safe gap is an offence, if it lasts at least ``CLOSE_FOLLOWING_S``.
CLOSE_SHARE = 0.5
CLOSE_FOLLOWING_S = 2.0
#: It is none in stop-and-go traffic, at up to this speed.
_LEAST_SPEED_MPS = 5.0
#: The target makes room if it brakes harder than this.
_MAKES_ROOM_MPS2 = 1.0


def unsafe_lane_entries(record: EpisodeRecord, view: TrafficView) -> Iterator[Breach]:
    """Yield, for each lane change of the target, the breach towards the vehicle that had to brake hardest for it.

    Args:
        record: the episode.
        view: its movements.
    """
    for step in lane_changes(view.road, view.place(record.target, 0, view.tracks.steps).lane):
        entries = _unsafe_entries(view, record.target, step)
        brakes = ((required_brake_mps2(record, view, row, entry.step), row, entry) for row, entry in entries)
        brake, row, entry = max(brakes, key=lambda x: x[0], default=(0.0, -1, None))
        if entry is not None and brake > EXPECTED_BRAKE_MPS2:
            breach = unsafe_entry_breach(entry, f"lane of '{view.tracks.ids[row]}'")
            yield replace(
                breach, text=f"{breach.text}, who had to brake at {brake:.1f} m/s² or more not to hit it"
            )


def _unsafe_entries(view: TrafficView, target: int, step: int) -> Iterator[tuple[int, LaneEntry]]:
    """Yield the vehicles into whose lane *target* changed by instant *step*, nearer than the safe gap ahead of them."""
    start = max(0, step - view.steps(HISTORY_S))
    for row in nearby_vehicles(view, target, step):
        entry = lane_entry(view, target, row, start, step, BREACH_WINDOW_S)
        if entry is None or entry.safe or entry.oncoming or not entry.leaves_lane:
            continue
        if view.tracks.valid[row, entry.step : step + 1].all():
            yield row, entry


def close_following(record: EpisodeRecord, view: TrafficView) -> Iterator[Breach]:
    """Yield the first breach of following with less than half the safe gap, if any, from where it begins.

    Time in which the target brakes does not count: it makes room. If the gap was as small when the vehicle ahead became
    the leader, it has three seconds to do so.

    Args:
        record: the episode.
        view: its movements.
    """
    tracks, target = record.tracks, record.target
    following = following_gaps(tracks, target, view.road, record.route)
    gaps_m = np.where(following.gap_m >= 0.0, following.gap_m, np.inf)
    leader, steps = gaps_m.argmin(0), np.arange(tracks.steps)
    gap_m, speed = gaps_m[leader, steps], tracks.speed_mps[target]
    needed_m = safe_gap_m(speed, np.maximum(0.0, speed - following.closing_mps[leader, steps]))
    with np.errstate(invalid="ignore"):
        close = np.isfinite(gap_m) & (speed > _LEAST_SPEED_MPS) & (gap_m < CLOSE_SHARE * needed_m)
    brakes, over = np.zeros(tracks.steps, dtype=np.bool_), max(1, view.steps(BRAKE_OVER_S))
    brakes[over:] = mean_braking_mps2(speed, over, tracks.dt_s) > _MAKES_ROOM_MPS2  # NaN compares as False
    begin = _first_lasting(close, brakes, leader, view.steps(CUT_IN_WINDOW_S), view.steps(CLOSE_FOLLOWING_S))
    if begin is not None:
        gaps = f"{gap_m[begin]:.1f} m behind ({needed_m[begin]:.1f} m are safe)"
        driven = f"at {3.6 * speed[begin]:.0f} km/h, {gaps}, for {CLOSE_FOLLOWING_S:g} s or more"
        text = f"followed '{tracks.ids[leader[begin]]}' {driven}"
        yield Breach(BreachKind.CLOSE_FOLLOWING, target, view.time_s(begin), text)


def _first_lasting(
    close: BoolArray, brakes: BoolArray, leader: IntArray, room: int, needed: int
) -> int | None:
    """Return the first instant of which *needed* more follow while *close* holds with the same *leader*; all (T,).

    Instants at which *brakes* holds do not count. If it is close as soon as there is that leader, neither do the first
    *room* instants.
    """
    changes = np.flatnonzero(np.diff(leader)) + 1
    for part in np.split(np.arange(len(close)), changes):
        lasts = close[part]
        if lasts[0]:
            lasts[:room] = False
        counted: list[int] = []
        for k, is_close in zip(part.tolist(), lasts.tolist(), strict=True):
            if not is_close:
                counted.clear()
            elif not brakes[k]:
                counted.append(k)
            if len(counted) > needed:
                return counted[0]
    return None
