"""Crossings of the attacks ``oncoming``, by vehicles from ahead only, and ``short-gaps``, at constant speed.

The manoeuvre is a "crossing", and recorded as one; the column ``approach`` of the records says "oncoming". An archive
would otherwise count the same encounter under two names.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from advdiff_sumo.maps.junction_priority import come_head_on
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.priority_traffic import turn_speed_mps
from advdiff_sumo.traffic.manoeuvres.repertoire import crossing_links
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.staging import StagingMemory

_MAX_SPEED_SHARE = 1.25
"""A vehicle faster than this share of the speed for its bend would have to brake in the bend."""


def suited_crossings(
    view: SituationView, manoeuvres: Iterable[Manoeuvre], stage: StagingMemory
) -> Iterator[Manoeuvre]:
    """Yield *manoeuvres* without the crossings that *stage* excludes.

    Vehicles that turn are as slow as their bend asks for; those of a stream keep their speed.
    """
    links_of_row: dict[int, tuple[Link, Link] | None] = {}
    for manoeuvre in manoeuvres:
        row, profile = manoeuvre.row, manoeuvre.profile
        if manoeuvre.kind == "crossing" and row not in links_of_row:
            links_of_row[row] = crossing_links(view, row)
        links = links_of_row[row] if manoeuvre.kind == "crossing" else None
        if links is None:
            yield manoeuvre
            continue
        is_excluded = stage.only_oncoming and not come_head_on(view.road, links[1], links[0])
        changes_speed = profile.first_mps2 != 0.0 or profile.then_mps2 != 0.0
        if is_excluded or (stage.streams and changes_speed):
            continue
        turn_mps = turn_speed_mps(view.road, links[0])
        if view.speed(row) <= _MAX_SPEED_SHARE * turn_mps:
            highest_mps = min(profile.highest_mps, turn_mps)
            yield replace(manoeuvre, profile=replace(profile, highest_mps=highest_mps))
