"""The attack ``oncoming``: crossings by those alone who come from ahead, and go straight on or turn.

What is driven is a "crossing", and called so in records, whose column ``approach`` says "oncoming": an archive would
count the same encounter twice under two names.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.priority_traffic import is_oncoming, turn_speed_mps
from advdiff_sumo.traffic.manoeuvres.repertoire import crossing_links
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView

ONCOMING = "oncoming"
"""The kind of attack that asks for them."""
_HARD_TURN = 1.25
"""Who is faster than its bend asks for by more than this share would have to brake in it."""


def filter_oncoming(view: SituationView, crossings: Iterable[Manoeuvre], alone: bool) -> Iterator[Manoeuvre]:
    """Yield those of *crossings* that come from ahead, no faster than their bends allow; unless *alone*, all."""
    if not alone:
        yield from crossings
        return
    for manoeuvre in crossings:
        links = crossing_links(view, manoeuvre.row)
        if links is None or not is_oncoming(view, links[1], links[0]):
            continue
        fastest_mps = turn_speed_mps(view.road, links[0])
        profile = manoeuvre.profile
        if view.speed(manoeuvre.row) <= _HARD_TURN * fastest_mps:
            highest_mps = min(profile.highest_mps, fastest_mps)
            yield replace(manoeuvre, profile=replace(profile, highest_mps=highest_mps))
