"""Failures of the target to give way at a junction, if it made another vehicle brake hard.

Giving way means not making others change their speed or direction abruptly (Vienna Convention on Road Traffic, Art. 1).
If a vehicle with the right of way needs more than the braking to be expected from the instant at which the target's
front passes its line (:mod:`~advdiff_sumo.metrics.breaches.hard_braking`), the target did not give way.
"""

from __future__ import annotations

from collections.abc import Iterator

from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.signal_letters import GREEN, PROTECTED_GREEN
from advdiff_sumo.maps import Link
from advdiff_sumo.metrics.breaches.breach import Breach, BreachKind
from advdiff_sumo.metrics.breaches.hard_braking import nearby_vehicles, required_brake_mps2
from advdiff_sumo.metrics.breaches.junction_rules import ran_red, signals_at_entry
from advdiff_sumo.metrics.breaches.striking_rules import EXPECTED_BRAKE_MPS2
from advdiff_sumo.metrics.encounter import JunctionEntry, junction_entries, junction_of, links_onto
from advdiff_sumo.metrics.traffic_view import TrafficView


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
        vehicles = nearby_vehicles(view, record.target, entry.line_step)
        brakes = ((required_brake_mps2(record, view, x, entry.line_step), x) for x in vehicles)
        hard = (
            (brake, x) for brake, x in brakes if brake > EXPECTED_BRAKE_MPS2 and _has_priority(view, entry, x)
        )
        brake, row = max(hard, default=(0.0, -1))
        if row >= 0:
            name = view.tracks.ids[row]
            text = f"did not give way to '{name}', who had to brake at {brake:.1f} m/s² or more not to hit it"
            yield Breach(BreachKind.RIGHT_OF_WAY, record.target, view.time_s(entry.line_step), text)


def _is_judged(view: TrafficView, entry: JunctionEntry) -> bool:
    letters = signals_at_entry(view, entry)
    unknown = entry.link.tls_id is not None and not letters
    return not (unknown or PROTECTED_GREEN in letters or ran_red(view, entry))


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
