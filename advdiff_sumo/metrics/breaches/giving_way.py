"""Failures of the target to give way at a junction, if it made another vehicle brake hard.

Giving way means not making others change their speed or direction abruptly (Vienna Convention on Road Traffic, Art. 1).
From the instant at which the target's front passes its line, the target moves as recorded. Each other vehicle with the
right of way is assumed to keep its speed on its recorded way. If their boxes meet, the other must brake after the
response time. If that takes more than the braking to be expected, the target did not give way.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.core.signal_letters import GREEN, PROTECTED_GREEN
from advdiff_sumo.maps import Link
from advdiff_sumo.metrics.breaches.breach import Breach, BreachKind
from advdiff_sumo.metrics.breaches.conduct_rules import drove_too_fast
from advdiff_sumo.metrics.breaches.junction_rules import ran_red, signals_at_entry
from advdiff_sumo.metrics.breaches.striking_rules import EXPECTED_BRAKE_MPS2
from advdiff_sumo.metrics.encounter import JunctionEntry, junction_entries, junction_of, links_onto
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


def giving_way_breaches(record: EpisodeRecord, view: TrafficView) -> Iterator[Breach]:
    """Yield, for each junction that the target entered, the breach towards the vehicle that had to brake hardest.

    Entries on red are left to the rule for red lights. Entries with unknown signals, and pedestrians, are not judged.

    Args:
        record: the episode.
        view: its movements.
    """
    for entry in junction_entries(view, record.target):
        if entry.line_step == 0 or not _is_judged(view, entry):
            continue
        vehicles = _nearby_vehicles(view, record.target, entry)
        brakes = ((_required_brake_mps2(record, view, entry, x), x) for x in vehicles)
        brake, row = max(brakes, default=(0.0, -1))
        if brake > EXPECTED_BRAKE_MPS2:
            name = view.tracks.ids[row]
            text = f"did not give way to '{name}', who had to brake at {brake:.1f} m/s² or more not to hit it"
            yield Breach(BreachKind.RIGHT_OF_WAY, record.target, view.time_s(entry.line_step), text)


def _is_judged(view: TrafficView, entry: JunctionEntry) -> bool:
    letters = signals_at_entry(view, entry)
    unknown = entry.link.tls_id is not None and not letters
    return not (unknown or PROTECTED_GREEN in letters or ran_red(view, entry))


def _nearby_vehicles(view: TrafficView, target: int, entry: JunctionEntry) -> Iterator[int]:
    """Yield the rows of moving vehicles that could meet the target within ``AHEAD_S`` of its passing the line."""
    tracks, step = view.tracks, entry.line_step
    distance = np.hypot(*(tracks.xy_m[:, step] - tracks.xy_m[target, step]).T)
    reach = AHEAD_S * (np.abs(tracks.speed_mps[:, step]) + abs(tracks.speed_mps[target, step]))
    near = distance < reach + 0.5 * (tracks.size_m[:, 0] + tracks.size_m[target, 0])
    drives = (
        tracks.valid[:, step] & (tracks.classes != AgentClass.PEDESTRIAN) & (tracks.speed_mps[:, step] > 0.0)
    )
    yield from (int(row) for row in np.flatnonzero(near & drives) if row != target)


def _required_brake_mps2(record: EpisodeRecord, view: TrafficView, entry: JunctionEntry, row: int) -> float:
    """Return the deceleration that *row* needed to avoid the target.

    0 if it needed none, has no right of way, drove too fast, or would have hit a third road user first.
    """
    tracks, step = record.tracks, entry.line_step
    count, sizes = view.steps(AHEAD_S), tracks.size_m[[record.target, row]]
    target = continued_poses(record, record.target, step, count)
    contact = first_contact_step(target, with_speed_kept(record, row, step, step, count), *sizes)
    if contact is None or not _has_priority(view, entry, row) or _hits_third(record, row, step, contact):
        return 0.0
    if drove_too_fast(view, row, max(0, step - view.steps(1.0)), step + 1) is not None:
        return 0.0
    way, speed = DrivenWay.of(tracks, row, step), float(tracks.speed_mps[row, step])
    for brake in BRAKES_MPS2:
        braking = way.at(braked_s_m(speed, float(brake), count + 1, tracks.dt_s))
        if first_contact_step(target, braking, *sizes) is None:
            return float(brake)
    return float(BRAKES_MPS2[-1])


def _has_priority(view: TrafficView, entry: JunctionEntry, row: int) -> bool:
    """Return whether the target must give way to *row*, on every link that *row* may take over the junction."""
    own_entry = next(
        (x for x in junction_entries(view, row) if x.link.junction_id == entry.link.junction_id), None
    )
    if own_entry is not None and ran_red(view, own_entry):
        return False
    links = (own_entry.link,) if own_entry is not None else _links_ahead(view, entry, row)
    return bool(links) and all(_link_has_priority(view, entry, x, own_entry is not None) for x in links)


def _links_ahead(view: TrafficView, entry: JunctionEntry, row: int) -> tuple[Link, ...]:
    """Return the links that *row* uses or may take over the junction, as the target passes its line."""
    lane = view.place(row, entry.line_step, entry.line_step + 1).lane[0]
    if lane is not None and junction_of(view.road, lane) == entry.link.junction_id:
        link = view.road.link_of_internal_lane.get(lane)
        return () if link is None else (link,)
    return links_onto(view.road, lane, entry.link.junction_id)


def _link_has_priority(view: TrafficView, entry: JunctionEntry, link: Link, entered: bool) -> bool:
    """Return whether the net makes the target yield to a vehicle on *link* that has *entered*, or may by its signal."""
    if not view.road.must_yield(entry.link, link) or view.road.must_yield(link, entry.link):
        return False
    if entered or link.tls_id is None or link.tls_index is None or not view.signals:
        return True
    return link.signal(view.signals[entry.line_step]) in GREEN


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
