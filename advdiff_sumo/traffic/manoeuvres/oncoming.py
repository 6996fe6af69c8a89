"""Crossings of the attacks ``oncoming``, by vehicles from ahead only, and ``short-gaps``, at constant speed.

The manoeuvre is a "crossing", and recorded as one; the column ``approach`` of the records says "oncoming". An archive
would otherwise count the same encounter under two names.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.priority_traffic import is_oncoming, turn_speed_mps
from advdiff_sumo.traffic.manoeuvres.repertoire import crossing_links
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.staging import StagingMemory

ONCOMING = "oncoming"
"""Name of the attack."""
_MAX_SPEED_SHARE = 1.25
"""A vehicle faster than this share of the speed for its bend would have to brake in the bend."""


def suited_crossings(
    view: SituationView, manoeuvres: Iterable[Manoeuvre], stage: StagingMemory
) -> Iterator[Manoeuvre]:
    """Yield *manoeuvres* without crossings that *stage* excludes; vehicles of a stream keep their speed."""
    for manoeuvre in filter_oncoming(view, manoeuvres, stage.only_oncoming):
        profile = manoeuvre.profile
        keeps_speed = profile.first_mps2 == 0.0 and profile.then_mps2 == 0.0
        if keeps_speed or not stage.streams or manoeuvre.kind != "crossing":
            yield manoeuvre


def filter_oncoming(
    view: SituationView, crossings: Iterable[Manoeuvre], only_oncoming: bool
) -> Iterator[Manoeuvre]:
    """Yield those of *crossings* that come from ahead, no faster than their bends allow; all if not *only_oncoming*."""
    if not only_oncoming:
        yield from crossings
        return
    for manoeuvre in crossings:
        links = crossing_links(view, manoeuvre.row)
        if links is None or not is_oncoming(view, links[1], links[0]):
            continue
        turn_mps = turn_speed_mps(view.road, links[0])
        profile = manoeuvre.profile
        if view.speed(manoeuvre.row) <= _MAX_SPEED_SHARE * turn_mps:
            highest_mps = min(profile.highest_mps, turn_mps)
            yield replace(manoeuvre, profile=replace(profile, highest_mps=highest_mps))
