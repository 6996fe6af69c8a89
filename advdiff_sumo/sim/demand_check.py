"""What demand files hold: when the first vehicle departs, and whether they belong to the net."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

from advdiff_sumo.core.errors import FileError, SceneError
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.demand_xml import elements, seconds

_ROUTES_LOOKED_AT = 500
_VEHICLES, _FLOWS = {"vehicle", "trip", "flow"}, {"flow", "personFlow", "containerFlow"}
_DEPARTING = _VEHICLES | _FLOWS | {"person", "container"}
_ROUTED = _VEHICLES | {"route", "walk", "ride", "personTrip"}


@dataclass
class _FileDemand:
    """What one file holds, as far as it was looked at."""

    path: Path
    vehicles: int = 0
    routes: int = 0
    foreign: int = 0
    example: str = ""
    first_s: float = math.inf

    @property
    def enough(self) -> bool:
        """Whether the rest need not be looked at: SUMO wants departures in their order."""
        return self.routes >= _ROUTES_LOOKED_AT and math.isfinite(self.first_s)


def first_departure_s(asked: Path, files: Sequence[Path], road: RoadMap, begin_s: float = 0.0) -> float:
    """Check *files* together, since one may use types and routes of another, and return when the traffic begins.

    Args:
        asked: what the user gave, for a message on all of them.
        files: route files, and additional files that may hold types, routes and vehicles, too.
        road: the net that they will run on.
        begin_s: when the simulation begins by their configuration; nobody departs before.

    Raises:
        FileError: a file cannot be read, or none holds a vehicle that departs.
        SceneError: the routes of a file are of another net.
    """
    demands = [_look(path, road, begin_s) for path in files]
    for one in demands:
        if one.foreign > one.routes // 2:
            raise SceneError(
                f"{one.path}: {one.foreign} of its first {one.routes} routes use edges that {road.path.name} does not "
                f"have (such as '{one.example}'); it is the demand of another net, give that net or other demand"
            )
    if not any(one.vehicles for one in demands):
        problem = "holds no vehicle, trip or flow with a route"
        raise FileError(asked, problem, "give demand made for the net")
    first = min(one.first_s for one in demands)
    if math.isfinite(first):
        return float(math.floor(first))
    if begin_s > 0.0:
        problem = f"begins at {begin_s:g} s, after the last departure of its demand"
        raise FileError(asked, problem, "correct its <begin>, or give later demand")
    return 0.0


def file_that_names(ids: Iterable[str], files: Iterable[Path]) -> Path | None:
    """Return the first of *files* in which somebody of *ids* departs; None where nobody does."""
    wanted = set(ids)
    for path in files:
        if any(element.tag in _DEPARTING and element.get("id") in wanted for element in elements(path)):
            return path
    return None


def _look(path: Path, road: RoadMap, begin_s: float) -> _FileDemand:
    demand = _FileDemand(path)
    for element in elements(path):
        if element.tag in _DEPARTING:
            demand.vehicles += element.tag in _VEHICLES
            demand.first_s = min(demand.first_s, _first_s(element, begin_s))
        if element.tag in _ROUTED:
            _hold_against(road, element, demand)
        if demand.enough:
            break
    return demand


def _first_s(element: Element, begin_s: float) -> float:
    """Return when it first departs at *begin_s* or later; infinity where it never does, or waits for somebody."""
    if element.tag not in _FLOWS:
        depart = seconds(element.get("depart", "0"))
        return math.inf if depart is None or depart < begin_s else depart
    begin, end = seconds(element.get("begin", "0")), seconds(element.get("end", "inf"))
    over = end is not None and end < begin_s
    return math.inf if begin is None or over else max(begin, begin_s)


def _hold_against(road: RoadMap, element: Element, demand: _FileDemand) -> None:
    """Count the route of *element*, and whether it uses edges that *road* does not have."""
    edges = (element.get("edges") or f"{element.get('from') or ''} {element.get('to') or ''}").split()
    if not edges:
        return
    unknown = next((e for e in edges if e not in road.edges and e not in road.beyond_rim), None)
    demand.routes += 1
    demand.foreign += unknown is not None
    demand.example = demand.example or unknown or ""
