"""Red lights and the duty to yield: stop lines that bind a reference driver."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from advdiff_sumo.core.arrays import BoolArray
from advdiff_sumo.core.signal_letters import PROTECTED_GREEN, RED, YELLOW
from advdiff_sumo.maps import Link, RoadMap
from advdiff_sumo.maps.paths import PathLink
from advdiff_sumo.metrics.reference.driver_models import FULL_BRAKE_MPS2

#: A driver brakes for a stop line once that takes this much, and for a yellow light while it takes no more.
BEGIN_MPS2, YELLOW_MPS2 = 2.0, 3.0
_ONGOING_MPS2 = 0.5
_MARGIN_M = 1.0


def yields_to(road: RoadMap, link: Link, signals: Mapping[str, str], theirs: tuple[Link, ...]) -> bool:
    """Return whether who takes *link* must give way to who takes one of *theirs*, as signs and signals stand."""
    if link.signal(signals) == PROTECTED_GREEN:
        return False
    return any(road.must_yield(link, x) and x.signal(signals) not in RED for x in theirs)


def stop_demand(
    road: RoadMap,
    ahead: tuple[PathLink, ...],
    front_m: float,
    speed_mps: float,
    signals: Mapping[str, str],
    rivals: tuple[tuple[Link, ...], ...],
    conflict: BoolArray,
    braking: bool,
) -> float:
    """Return the braking in m/s² that the stop lines ahead ask for; 0 for none.

    A line that is too near for full braking when it comes to matter does not bind.

    Args:
        road: the map.
        ahead: connections ahead with the places of their stop lines along the way.
        front_m: place of the front bumper along the way.
        speed_mps: speed.
        signals: the traffic lights now.
        rivals: N tuples of the connections that each other takes.
        conflict: (N,) whose time at the conflict area overlaps with the ego's.
        braking: whether the driver is braking already.
    """
    demand = 0.0
    for place in ahead:
        distance = place.s_m - front_m
        if distance <= 0.0 or speed_mps <= 0.0:
            continue
        needed = speed_mps**2 / (2.0 * max(distance - _MARGIN_M, 0.1))
        if needed < (_ONGOING_MPS2 if braking else BEGIN_MPS2):
            continue
        if needed > FULL_BRAKE_MPS2 and not braking:
            continue
        if _must_stop(road, place.link, needed, signals, rivals, conflict):
            demand = max(demand, min(needed, FULL_BRAKE_MPS2))
    return demand


def _must_stop(
    road: RoadMap,
    link: Link,
    needed_mps2: float,
    signals: Mapping[str, str],
    rivals: tuple[tuple[Link, ...], ...],
    conflict: BoolArray,
) -> bool:
    letter = link.signal(signals)
    if letter in RED:
        return True
    if letter in YELLOW:
        return needed_mps2 <= YELLOW_MPS2
    return any(yields_to(road, link, signals, rivals[n]) for n in np.flatnonzero(conflict).tolist())
