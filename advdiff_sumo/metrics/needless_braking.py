"""Abrupt braking of the target without need, as for an object that is not there.

No driver may brake abruptly unless safety requires it (Vienna Convention on Road Traffic, Art. 17.1). Every reason
counts that the record and the map show: a reference driver would have braked, a signal, a line at which to give way, a
lower limit, the end of the way, a pedestrian near it, or a lane change.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.core.signal_letters import PROTECTED_GREEN, RED, YELLOW
from advdiff_sumo.maps.paths import LanePath, PathLink
from advdiff_sumo.metrics.breaches.breach import Breach, BreachKind
from advdiff_sumo.metrics.breaches.striking_rules import EXPECTED_BRAKE_MPS2, mean_braking_mps2
from advdiff_sumo.metrics.reference import MODELS, ReferenceDrivers
from advdiff_sumo.metrics.reference.own_way import lane_path_at
from advdiff_sumo.metrics.reference.reference_drive import instant_as_collision
from advdiff_sumo.metrics.traffic_view import TrafficView

#: There is need if a reference driver in the target's place would have braked harder than this.
NEED_MPS2 = 2.0
#: Braking is abrupt if it is harder than is to be expected on average over this time: tracks of logs are noisy.
_OVER_S = 1.0
#: Reasons count from so long before the braking begins, and a reference driver's braking until so long after.
_BEFORE_S, _AFTER_S = 1.0, 4.0
#: Slower braking is not looked at.
_LEAST_SPEED_MPS = 5.0
#: Reasons ahead count within the distance in which gentle braking, of so much, stops, and so much farther.
_GENTLE_MPS2, _SPARE_M = 1.5, 20.0
#: A target farther than this from the middle of its lane, or turned by more, may be changing lanes.
_OFF_MIDDLE_M, _TURNED_RAD = 0.8, 0.3
#: A limit that is lower than the speed by less than this share is no reason.
_SPARE_SHARE = 0.05
#: A pedestrian within this distance of the way is a reason.
_PEDESTRIAN_M = 8.0


def needless_braking(record: EpisodeRecord, view: TrafficView) -> Iterator[Breach]:
    """Yield the first breach of braking abruptly without need, if any, from where the braking begins.

    Args:
        record: the episode.
        view: its movements.
    """
    speed = record.tracks.speed_mps[record.target]
    for begin, end in _abrupt_braking(record, view):
        if not _has_need(record, view, begin, end):
            text = (
                f"braked abruptly without need, from {3.6 * speed[begin]:.0f} to {3.6 * speed[end]:.0f} km/h"
            )
            yield Breach(BreachKind.NEEDLESS_BRAKING, record.target, view.time_s(begin), text)
            return


def _abrupt_braking(record: EpisodeRecord, view: TrafficView) -> Iterator[tuple[int, int]]:
    """Yield (first, last) instants of each stretch in which the target brakes abruptly."""
    speed, over = record.tracks.speed_mps[record.target], max(1, view.steps(_OVER_S))
    if len(speed) <= over:
        return
    braking = mean_braking_mps2(speed, over, view.tracks.dt_s)
    hard = np.flatnonzero(braking > EXPECTED_BRAKE_MPS2)  # NaN compares as False
    for part in np.split(hard, np.flatnonzero(np.diff(hard) > over) + 1):
        if part.size and speed[part[0]] > _LEAST_SPEED_MPS:
            yield int(part[0]), int(part[-1]) + over


def _has_need(record: EpisodeRecord, view: TrafficView, begin: int, end: int) -> bool:
    """Return whether there is a reason, by record and map, to brake abruptly from instant *begin* to *end*."""
    tracks, target = record.tracks, record.target
    start = max(0, begin - view.steps(_BEFORE_S))
    if not tracks.valid[target, start : end + 1].all():
        return True
    speed = float(tracks.speed_mps[target, start : end + 1].max())
    reach_m = speed**2 / (2.0 * _GENTLE_MPS2) + _SPARE_M
    path = lane_path_at(record, view.road, start, reach_m)
    if path is None or _may_change_lanes(view, target, start, end):
        return True
    signals = record.signals[start : end + 1]
    return (
        path.lane_change_after_m < reach_m
        or bool((path.speed_mps[path.line.s_m <= reach_m] < (1.0 - _SPARE_SHARE) * speed).any())
        or any(_may_have_to_stop(view, ahead, signals) for ahead in path.links if ahead.s_m < reach_m)
        or _is_pedestrian_near(view, path, reach_m, start, end)
        or _reference_driver_brakes(record, view, start, end)
    )


def _may_change_lanes(view: TrafficView, target: int, start: int, end: int) -> bool:
    """Return whether the target is off the middle of its lane, or turned, at some instant."""
    placed = view.place(target, start, end + 1)
    away = np.abs(placed.d_m) > _OFF_MIDDLE_M
    turned = np.abs(placed.yaw_error_rad) > _TURNED_RAD
    return bool(np.any(away | turned) or any(name is None for name in placed.lane))


def _may_have_to_stop(view: TrafficView, ahead: PathLink, signals: Sequence[Mapping[str, str]]) -> bool:
    """Return whether the link *ahead* must give way to some other, or shows red, yellow or an unknown signal."""
    link = ahead.link
    if link.tls_id is None:
        return bool(view.road.yields_to(link))
    letters = {link.signal(at) for at in signals} or {""}
    return letters != {PROTECTED_GREEN} and bool(letters & {*RED, *YELLOW, ""} or view.road.yields_to(link))


def _is_pedestrian_near(view: TrafficView, path: LanePath, reach_m: float, start: int, end: int) -> bool:
    """Return whether a pedestrian is near the way ahead at some instant."""
    rows = np.flatnonzero(view.tracks.classes == AgentClass.PEDESTRIAN)
    xy = view.tracks.xy_m[rows, start : end + 1]
    xy = xy[np.isfinite(xy).all(-1)]
    if not len(xy):
        return False
    along, across = path.line.project(xy, extrapolate=True)
    return bool(((along > 0.0) & (along < reach_m) & (np.abs(across) < _PEDESTRIAN_M)).any())


def _reference_driver_brakes(record: EpisodeRecord, view: TrafficView, start: int, end: int) -> bool:
    """Return whether a reference driver that takes over at instant *start* brakes harder than ``NEED_MPS2``."""
    case = instant_as_collision(record, record.target, end)
    drivers = ReferenceDrivers(record, view.road, case, (end - start) * record.tracks.dt_s)
    instants = end - start + view.steps(_AFTER_S)
    return any(drivers.hardest_braking_mps2(model, instants) > NEED_MPS2 for model in MODELS)
