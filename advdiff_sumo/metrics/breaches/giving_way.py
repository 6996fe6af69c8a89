"""Giving way at junctions where nobody was hit: whom the target made brake hard.

To give way is not to make others change their speed or direction abruptly (Vienna Convention on Road Traffic, Art. 1).
From the instant at which the target's front passed its line, each other vehicle with the right of way is taken to keep
its speed on its recorded way, and the target to move as recorded. Where their boxes meet, the other must react within
the response time and brake; above what one may be expected to brake, the target did not give way.
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
    contact_at,
    gone_on,
    kept,
)
from advdiff_sumo.metrics.traffic_view import TrafficView

#: How far ahead is looked, s.
AHEAD_S = 4.0


def not_given_way(record: EpisodeRecord, view: TrafficView) -> Iterator[Breach]:
    """Yield, for each junction that the target entered, the breach towards whom it made brake hardest.

    Red lights are a rule of their own. Signals that are not known, and people on foot, are not judged.

    Args:
        record: the episode.
        view: its movements.
    """
    for entry in junction_entries(view, record.target):
        if entry.line_step == 0 or not _is_judged(view, entry):
            continue
        brakes = ((_brake_mps2(record, view, entry, row), row) for row in _others(view, record.target, entry))
        brake, row = max(brakes, default=(0.0, -1))
        if brake > EXPECTED_BRAKE_MPS2:
            name, hard = view.tracks.ids[row], f"{brake:.1f} m/s²"
            text = f"did not give way to '{name}', who had to brake at {hard} or more not to hit it"
            yield Breach(BreachKind.RIGHT_OF_WAY, record.target, view.time_s(entry.line_step), text)


def _is_judged(view: TrafficView, entry: JunctionEntry) -> bool:
    letters = signals_at_entry(view, entry)
    unknown = entry.link.tls_id is not None and not letters
    return not (unknown or PROTECTED_GREEN in letters or ran_red(view, entry))


def _others(view: TrafficView, target: int, entry: JunctionEntry) -> Iterator[int]:
    """Yield who moves, and could be at the target's place soon, when the target passes its line."""
    tracks, step = view.tracks, entry.line_step
    away = np.hypot(*(tracks.xy_m[:, step] - tracks.xy_m[target, step]).T)
    reach = AHEAD_S * (np.abs(tracks.speed_mps[:, step]) + abs(tracks.speed_mps[target, step]))
    near = away < reach + 0.5 * (tracks.size_m[:, 0] + tracks.size_m[target, 0])
    drives = (
        tracks.valid[:, step] & (tracks.classes != AgentClass.PEDESTRIAN) & (tracks.speed_mps[:, step] > 0.0)
    )
    yield from (int(row) for row in np.flatnonzero(near & drives) if row != target)


def _brake_mps2(record: EpisodeRecord, view: TrafficView, entry: JunctionEntry, row: int) -> float:
    """Return how hard *row* had to brake for the target; 0 where it need not, or must give way itself."""
    tracks, step = record.tracks, entry.line_step
    count, sizes = view.steps(AHEAD_S), tracks.size_m[[record.target, row]]
    target = gone_on(record, record.target, step, count)
    met = contact_at(target, kept(record, row, step, step, count), *sizes)
    if met is None or not _has_priority(view, entry, row) or _meets_another(record, row, step, met):
        return 0.0
    if drove_too_fast(view, row, max(0, step - view.steps(1.0)), step + 1) is not None:
        return 0.0
    way, speed = DrivenWay.of(tracks, row, step), float(tracks.speed_mps[row, step])
    for brake in BRAKES_MPS2:
        if (
            contact_at(target, way.at(braked_s_m(speed, float(brake), count + 1, tracks.dt_s)), *sizes)
            is None
        ):
            return float(brake)
    return float(BRAKES_MPS2[-1])


def _has_priority(view: TrafficView, entry: JunctionEntry, row: int) -> bool:
    """Return whether the target must give way to *row*, by every way that it may take over the junction."""
    came = next(
        (x for x in junction_entries(view, row) if x.link.junction_id == entry.link.junction_id), None
    )
    if came is not None and ran_red(view, came):
        return False
    links = (came.link,) if came is not None else _links_ahead(view, entry, row)
    return bool(links) and all(_is_owed(view, entry, link, came is not None) for link in links)


def _links_ahead(view: TrafficView, entry: JunctionEntry, row: int) -> tuple[Link, ...]:
    lane = view.place(row, entry.line_step, entry.line_step + 1).lane[0]
    if lane is not None and junction_of(view.road, lane) == entry.link.junction_id:
        link = view.road.link_over.get(lane)
        return () if link is None else (link,)
    return links_onto(view.road, lane, entry.link.junction_id)


def _is_owed(view: TrafficView, entry: JunctionEntry, link: Link, entered: bool) -> bool:
    """Return whether the net has the target give way to who takes *link*, and no signal stops that one."""
    if not view.road.must_yield(entry.link, link) or view.road.must_yield(link, entry.link):
        return False
    if entered or link.tls_id is None or link.tls_index is None or not view.signals:
        return True
    return link.signal(view.signals[entry.line_step]) in GREEN


def _meets_another(record: EpisodeRecord, row: int, step: int, met: int) -> bool:
    """Return whether *row*, keeping its speed, would run into somebody else before it meets the target."""
    tracks = record.tracks
    own = kept(record, row, step, step, met)
    for other in np.flatnonzero(tracks.valid[:, step : step + met + 1].all(1)).tolist():
        if other in (row, record.target):
            continue
        sizes = tracks.size_m[[row, other]]
        there = Poses(tracks.xy_m[other, step : step + met + 1], tracks.yaw_rad[other, step : step + met + 1])
        if len(there) == len(own) and contact_at(own, there, *sizes) is not None:
            return True
    return False
