"""The braking that another vehicle needs so as not to hit the target, had it relied on the target from an instant on.

The target moves as recorded. The other is assumed to keep its speed on its recorded way. If their boxes meet, it must
brake after the response time.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.metrics.breaches.conduct_rules import drove_too_fast
from advdiff_sumo.metrics.kept_motion import (
    BRAKES_MPS2,
    DrivenWay,
    Poses,
    braked_s_m,
    continued_poses,
    first_contact_step,
    with_speed_kept,
)
from advdiff_sumo.metrics.traffic_view import TrafficView

#: Look-ahead time.
AHEAD_S = 4.0


def nearby_vehicles(view: TrafficView, target: int, step: int) -> Iterator[int]:
    """Yield the rows of moving vehicles that could meet *target* within ``AHEAD_S`` of instant *step*."""
    tracks = view.tracks
    distance = np.hypot(*(tracks.xy_m[:, step] - tracks.xy_m[target, step]).T)
    reach = AHEAD_S * (np.abs(tracks.speed_mps[:, step]) + abs(tracks.speed_mps[target, step]))
    near = distance < reach + 0.5 * (tracks.size_m[:, 0] + tracks.size_m[target, 0])
    drives = (
        tracks.valid[:, step] & (tracks.classes != AgentClass.PEDESTRIAN) & (tracks.speed_mps[:, step] > 0.0)
    )
    yield from (int(row) for row in np.flatnonzero(near & drives) if row != target)


def required_brake_mps2(record: EpisodeRecord, view: TrafficView, row: int, step: int) -> float:
    """Return the deceleration that *row* needed from instant *step* on, after its response, to avoid the target.

    0 if it needed none, drove too fast, or would have hit a third road user first; at most 9.

    Args:
        record: the episode.
        view: its movements.
        row: row of the other vehicle.
        step: instant from which on the target relies on it.
    """
    tracks, count = record.tracks, view.steps(AHEAD_S)
    sizes = tracks.size_m[[record.target, row]]
    target = continued_poses(record, record.target, step, count)
    contact = first_contact_step(target, with_speed_kept(record, row, step, step, count), *sizes)
    if contact is None or _hits_third(record, row, step, contact):
        return 0.0
    if drove_too_fast(view, row, max(0, step - view.steps(1.0)), step + 1) is not None:
        return 0.0
    way, speed = DrivenWay.of(tracks, row, step), float(tracks.speed_mps[row, step])
    for brake in BRAKES_MPS2:
        braking = way.at(braked_s_m(speed, float(brake), count + 1, tracks.dt_s))
        if first_contact_step(target, braking, *sizes) is None:
            return float(brake)
    return float(BRAKES_MPS2[-1])


def _hits_third(record: EpisodeRecord, row: int, step: int, contact: int) -> bool:
    """Return whether *row*, keeping its speed from *step* on, would hit a third road user within *contact* steps."""
    tracks, part = record.tracks, slice(step, step + contact + 1)
    own = with_speed_kept(record, row, step, step, contact)
    for third in np.flatnonzero(tracks.valid[:, part].all(1)).tolist():
        if third in (row, record.target):
            continue
        recorded = Poses(tracks.xy_m[third, part], tracks.yaw_rad[third, part])
        if len(recorded) != len(own):
            continue
        if first_contact_step(own, recorded, *tracks.size_m[[row, third]]) is not None:
            return True
    return False
