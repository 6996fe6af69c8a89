"""Find implausible motion of background vehicles: off the road, through others, or beyond vehicle limits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, stretches
from advdiff_sumo.core.bicycle import Limits
from advdiff_sumo.core.record import Controller, EpisodeRecord
from advdiff_sumo.core.scene import MOTOR_CLASSES, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.background_metrics import background_collisions
from advdiff_sumo.metrics.collision import collisions, find_touches
from advdiff_sumo.metrics.comfort import derivatives
from advdiff_sumo.metrics.offroad import BACKGROUND_EVERY_S, OFF_ROAD_SHARE, off_road_shares

JERK_MPS3 = 25.0
"""Greatest plausible jerk; an emergency braking reaches about 18 m/s³."""
SLACK = 1.05
"""Limits may be exceeded up to this share, because of rounding and smoothing."""
THROUGH_M = 0.5
"""Vehicles whose boxes overlap by more than this drove through each other."""
_LEAST_INSTANTS = 5
"""Shortest stretch for which derivatives are computed."""


@dataclass(frozen=True)
class Implausibility:
    """One implausible motion of one background vehicle.

    Attributes:
        vehicle: id of the vehicle.
        time_s: time of the greatest value since the episode's start.
        what: "off the road", "collision", "drove through", "acceleration", "braking", "lateral acceleration", "jerk".
        value: the greatest value.
        unit: unit of the value.
        other: id of the other vehicle in a collision, else "".
    """

    vehicle: str
    time_s: float
    what: str
    value: float
    unit: str
    other: str = ""


def implausibilities(record: EpisodeRecord, road: RoadMap) -> list[Implausibility]:
    """Return implausible motion while the policy moved a vehicle, the worst of each kind and vehicle, in time order.

    Collisions with the target do not count, as they may be the aim of a run.
    """
    tracks = record.tracks
    moved = (record.controller == Controller.POLICY) & tracks.valid
    moved[record.target] = False
    implausibilities = [
        *_contacts(record, moved),
        *_off_road(tracks, moved, road),
        *_beyond_limits(tracks, moved),
    ]
    return sorted(implausibilities, key=lambda x: (x.time_s, x.vehicle, x.what))


def _contacts(record: EpisodeRecord, moved: BoolArray) -> Iterator[Implausibility]:
    """Yield collisions in which the policy moved at least one of the two; *moved* is (A, T)."""
    tracks, touches = record.tracks, find_touches(record.tracks)
    for hit in background_collisions(record, collisions(record, touches)):
        own, other = hit.rows if moved[hit.rows[0], hit.step + 1] else hit.rows[::-1]
        if not moved[own, hit.step + 1]:
            continue
        same_pair = (touches.first == min(hit.rows)) & (touches.second == max(hit.rows))
        depth = float(max(0.0, -touches.end_gap_m[same_pair & (touches.step >= hit.step)].min()))
        what = "drove through" if depth > THROUGH_M else "collision"
        yield Implausibility(tracks.ids[own], hit.time_s, what, depth, "m", tracks.ids[other])


def _off_road(tracks: Tracks, moved: BoolArray, road: RoadMap) -> Iterator[Implausibility]:
    every = max(1, round(BACKGROUND_EVERY_S / tracks.dt_s))
    is_motor = np.isin(tracks.classes, MOTOR_CLASSES)
    for row in np.flatnonzero(moved.any(axis=1) & is_motor).tolist():
        steps = np.flatnonzero(moved[row] & tracks.valid[row])
        steps = steps[:: every if len(steps) > every else 1]
        share = off_road_shares(road, tracks, np.full(len(steps), row), steps)
        worst = int(share.argmax())
        if share[worst] - share[0] > OFF_ROAD_SHARE:
            time = tracks.t0_s + tracks.dt_s * float(steps[worst])
            yield Implausibility(
                tracks.ids[row], time, "off the road", 100.0 * float(share[worst]), "% of its box"
            )


def _beyond_limits(tracks: Tracks, moved: BoolArray) -> Iterator[Implausibility]:
    for row in np.flatnonzero(moved.any(axis=1)).tolist():
        worst: dict[str, Implausibility] = {}
        for start, stop in stretches(moved[row]):
            for excess in _excesses(tracks, row, start, stop) if stop - start >= _LEAST_INSTANTS else ():
                if excess.what not in worst or excess.value > worst[excess.what].value:
                    worst[excess.what] = excess
        yield from worst.values()


def _excesses(tracks: Tracks, row: int, start: int, stop: int) -> Iterator[Implausibility]:
    """Yield each limit that agent *row* exceeds at instants *start* to *stop* (exclusive), where it is worst."""
    limits = Limits()
    accel, jerk, _, lateral = derivatives(tracks, row, slice(start, stop))
    for what, unit, limit, value in (
        ("acceleration", "m/s²", limits.accel_mps2, accel),
        ("braking", "m/s²", limits.brake_mps2, -accel),
        ("lateral acceleration", "m/s²", limits.lateral_mps2, np.abs(lateral)),
        ("jerk", "m/s³", JERK_MPS3, np.abs(jerk)),
    ):
        worst = int(value.argmax())
        if value[worst] > SLACK * limit:
            time = tracks.t0_s + tracks.dt_s * (start + worst)
            yield Implausibility(tracks.ids[row], time, what, float(value[worst]), unit)
