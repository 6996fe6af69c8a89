"""Deceleration that stop lines require of a reference driver, at red lights and where it must yield."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from advdiff_sumo.core.arrays import BoolArray
from advdiff_sumo.core.signal_letters import PROTECTED_GREEN, RED, YELLOW
from advdiff_sumo.maps import Link, RoadMap
from advdiff_sumo.maps.paths import PathLink
from advdiff_sumo.metrics.reference.driver_models import FULL_BRAKE_MPS2

#: A driver begins to brake for a stop line when the required deceleration reaches this.
BEGIN_MPS2 = 2.0
#: A driver stops at a yellow light if that requires at most this deceleration.
YELLOW_MPS2 = 3.0
#: A driver who brakes already stops braking for a line below this required deceleration.
_CONTINUE_MPS2 = 0.5
#: The driver stops this far before the line.
_MARGIN_M = 1.0


def yields_to(road: RoadMap, link: Link, signals: Mapping[str, str], other_links: tuple[Link, ...]) -> bool:
    """Return whether a vehicle on *link* must yield to one on any of *other_links*, by the net and the *signals*."""
    if link.signal(signals) == PROTECTED_GREEN:
        return False
    return any(road.must_yield(link, x) and x.signal(signals) not in RED for x in other_links)


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
    """Return the deceleration in m/s² that the stop lines ahead require; 0 for none.

    A line that full braking cannot reach is ignored, unless the driver brakes already.

    Args:
        road: the map.
        ahead: connections ahead with the positions of their stop lines along the way.
        front_m: position of the front bumper along the way.
        speed_mps: speed.
        signals: state of the traffic lights.
        rivals: N tuples of the connections that each other road user takes.
        conflict: (N,) whether its time at the conflict area overlaps with the ego's.
        braking: whether the driver is braking already.
    """
    demand = 0.0
    for path_link in ahead:
        distance = path_link.s_m - front_m
        if distance <= 0.0 or speed_mps <= 0.0:
            continue
        required = speed_mps**2 / (2.0 * max(distance - _MARGIN_M, 0.1))
        if required < (_CONTINUE_MPS2 if braking else BEGIN_MPS2):
            continue
        if required > FULL_BRAKE_MPS2 and not braking:
            continue
        if _must_stop(road, path_link.link, required, signals, rivals, conflict):
            demand = max(demand, min(required, FULL_BRAKE_MPS2))
    return demand


def _must_stop(
    road: RoadMap,
    link: Link,
    required_mps2: float,
    signals: Mapping[str, str],
    rivals: tuple[tuple[Link, ...], ...],
    conflict: BoolArray,
) -> bool:
    letter = link.signal(signals)
    if letter in RED:
        return True
    if letter in YELLOW:
        return required_mps2 <= YELLOW_MPS2
    return any(yields_to(road, link, signals, rivals[n]) for n in np.flatnonzero(conflict).tolist())
