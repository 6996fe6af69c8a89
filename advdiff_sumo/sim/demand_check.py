"""Check demand files: when their first vehicle departs, and whether they belong to the net."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from xml.etree.ElementTree import Element

from advdiff_sumo.core.errors import FileError, SceneError
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.demand_xml import elements, seconds

_MAX_ROUTES = 500  # routes of a file that are checked, and more until the first departure is known
_MAX_DEPARTURES = 20_000  # departures of a file whose order is checked
_VEHICLES, _FLOWS = {"vehicle", "trip", "flow"}, {"flow", "personFlow", "containerFlow"}
_DEPARTING = _VEHICLES | _FLOWS | {"person", "container"}  # tags of elements that depart
_ROUTED = _VEHICLES | {"route", "walk", "ride", "personTrip"}  # tags of elements that name edges


@dataclass
class _FileDemand:
    """What one file contains, as far as it was read; *foreign* routes use edges like *example* that the net lacks."""

    path: Path
    vehicles: int = 0
    routes: int = 0
    foreign: int = 0
    example: str = ""
    first_s: float = math.inf

    @property
    def is_enough(self) -> bool:
        """Whether the rest need not be read: SUMO requires departures in order of time."""
        return self.routes >= _MAX_ROUTES and math.isfinite(self.first_s)


def first_departure_s(requested: Path, files: Sequence[Path], road: RoadMap, begin_s: float = 0.0) -> float:
    """Check *files* together, since they may use each other's types and routes, and return when traffic begins.

    Args:
        requested: the path that the user gave, for messages on all files.
        files: route files, and additional files, which may also contain types, routes and vehicles.
        road: the net on which they will run.
        begin_s: when the simulation begins by its configuration; no vehicle departs before.

    Raises:
        FileError: a file cannot be read, or none contains a vehicle that departs.
        SceneError: the routes of a file belong to another net.
    """
    demands = [_check_file(path, road, begin_s) for path in files]
    for demand in demands:
        if demand.foreign > demand.routes // 2:
            raise SceneError(
                f"{demand.path}: {demand.foreign} of its first {demand.routes} routes use edges that "
                f"{road.path.name} does not have (such as '{demand.example}'); it is the demand of another net, "
                "give that net or other demand"
            )
    if not any(demand.vehicles for demand in demands):
        problem = "holds no vehicle, trip or flow with a route"
        raise FileError(requested, problem, "give demand made for the net")
    first_s = min(demand.first_s for demand in demands)
    if math.isfinite(first_s):
        return float(math.floor(first_s))
    if begin_s > 0.0:
        problem = f"begins at {begin_s:g} s, after the last departure of its demand"
        raise FileError(requested, problem, "correct its <begin>, or give later demand")
    return 0.0


def file_that_names(ids: Iterable[str], files: Iterable[Path]) -> Path | None:
    """Return the first of *files* with a departing element whose id is among *ids*; None if there is none."""
    id_set = set(ids)
    for path in files:
        if any(element.tag in _DEPARTING and element.get("id") in id_set for element in elements(path)):
            return path
    return None


def unordered_departure(path: Path) -> str | None:
    """Return the id of the first vehicle, person or flow of *path* that departs before one above it; None if none does.

    SUMO leaves such departures of a route file out with no more than a warning. The first 20,000 are checked.

    Raises:
        FileError: it cannot be read.
    """
    latest_s = -math.inf
    for element in islice((row for row in elements(path) if row.tag in _DEPARTING), _MAX_DEPARTURES):
        depart_s = seconds(element.get("begin" if element.tag in _FLOWS else "depart", "0"))
        if depart_s is not None and depart_s < latest_s:
            return element.get("id", "")
        latest_s = latest_s if depart_s is None else depart_s
    return None


def _check_file(path: Path, road: RoadMap, begin_s: float) -> _FileDemand:
    """Read *path* as far as necessary and return what it contains."""
    demand = _FileDemand(path)
    for element in elements(path):
        if element.tag in _DEPARTING:
            demand.vehicles += element.tag in _VEHICLES
            demand.first_s = min(demand.first_s, _element_departure_s(element, begin_s))
        if element.tag in _ROUTED:
            _check_route(road, element, demand)
        if demand.is_enough:
            break
    return demand


def _element_departure_s(element: Element, begin_s: float) -> float:
    """Return when *element* first departs, at *begin_s* or later; infinity if never or not at a known time."""
    if element.tag not in _FLOWS:
        depart = seconds(element.get("depart", "0"))
        return math.inf if depart is None or depart < begin_s else depart
    begin, end = seconds(element.get("begin", "0")), seconds(element.get("end", "inf"))
    has_ended = end is not None and end < begin_s
    return math.inf if begin is None or has_ended else max(begin, begin_s)


def _check_route(road: RoadMap, element: Element, demand: _FileDemand) -> None:
    """Count the route of *element* in *demand*, also as foreign if *road* lacks one of its edges."""
    edges = (element.get("edges") or f"{element.get('from') or ''} {element.get('to') or ''}").split()
    if not edges:
        return
    unknown = next((e for e in edges if e not in road.edges and e not in road.beyond_rim), None)
    demand.routes += 1
    demand.foreign += unknown is not None
    demand.example = demand.example or unknown or ""
