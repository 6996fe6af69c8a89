"""People on foot for a net with crossings: trips over its sidewalks, as SUMO persons."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from advdiff_sumo.core.errors import NetError
from advdiff_sumo.maps.on_foot.footways import Footways, read_footways

_PACES_MPS = (1.1, 1.25, 1.4, 1.6)
_NEAR_M = 300.0  # between the middles of the sidewalks where a trip begins and ends
_MEAN_TRIP_S = 200.0  # present people / inflow, by Little's law


def person_types() -> Iterator[dict[str, str]]:
    """Yield vType attributes of people who walk at different paces."""
    for number, pace in enumerate(_PACES_MPS):
        yield {"id": f"walker{number}", "vClass": "pedestrian", "maxSpeed": f"{pace:g}", "speedDev": "0"}


def walks(
    net: Path, per_km: float, duration_s: float, rng: np.random.Generator
) -> list[tuple[float, Element]]:
    """Return (departure in s, person) of people on random trips, *per_km* at once on each km of sidewalk.

    Raises:
        NetError: the net has no sidewalks that hang together.
    """
    ways = read_footways(net)
    if not ways.edges:
        remedy = "convert it with --crossings guess, or set scene.pedestrians_per_km=0"
        raise NetError(net, "has no sidewalks with crossings for people on foot", remedy)
    present = max(round(per_km * ways.length_m.sum() / 1000.0), 1)
    inflow = round(present * duration_s / _MEAN_TRIP_S)
    departs = np.concatenate((np.zeros(present), np.sort(rng.uniform(0.0, duration_s, inflow))))
    starts = rng.choice(len(ways.edges), len(departs), p=ways.length_m / ways.length_m.sum())
    return [
        (depart, _person(number, depart, ways, int(start), rng))
        for number, (depart, start) in enumerate(zip(departs.tolist(), starts, strict=True))
    ]


def _person(number: int, depart_s: float, ways: Footways, start: int, rng: np.random.Generator) -> Element:
    gap = np.linalg.norm(ways.middle_m - ways.middle_m[start], axis=-1)
    others = np.flatnonzero((ways.part == ways.part[start]) & (np.arange(len(gap)) != start))
    near = others[gap[others] <= _NEAR_M]
    target = int(rng.choice(near)) if len(near) else int(others[gap[others].argmin()])
    place = rng.uniform(0.0, ways.length_m[start])
    person = Element(
        "person",
        id=str(number),
        type=f"walker{rng.integers(len(_PACES_MPS))}",
        depart=f"{depart_s:.1f}",
        departPos=f"{place:.1f}",
    )
    SubElement(person, "personTrip", {"from": ways.edges[start], "to": ways.edges[target]})
    return person
