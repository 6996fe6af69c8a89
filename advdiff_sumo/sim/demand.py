"""Traffic for a net that comes without demand: varied drivers on sensible routes, people on sidewalks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement, indent

import numpy as np

from advdiff_sumo.core.errors import NetError
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.on_foot.footways import Footways, read_footways
from advdiff_sumo.sim.sim_options import SceneOptions

_HEADWAY_S, _ACCEL_MPS2, _DECEL_MPS2, _SPEED_FACTOR, _MIN_GAP_M = (
    (0.9, 1.8),
    (1.6, 2.8),
    (3.0, 4.5),
    (0.85, 1.1),
    (1.5, 3.0),
)
_DRIVER_TYPES = 8
_MIN_ROUTE_M = 250.0
_MEAN_TRIP_S = 150.0  # present vehicles / inflow, by Little's law
_PACES_MPS = (1.1, 1.25, 1.4, 1.6)
_WALK_REACH_M = 300.0  # between the middles of the sidewalks where a trip begins and ends
_MEAN_WALK_S = 200.0  # present people / inflow, by Little's law


@dataclass(frozen=True)
class Trip:
    """One vehicle's departure."""

    depart_s: float
    type_id: str
    route: tuple[str, ...]
    on_the_way: bool


def write_demand(road: RoadMap, options: SceneOptions, duration_s: float, seed: SeedTree, path: Path) -> Path:
    """Write traffic for *road* that fills the net at once and then keeps its density.

    Args:
        road: the net.
        options: density, bound and share of trucks.
        duration_s: until when vehicles depart.
        seed: a node of the seed tree.
        path: the ``.rou.xml`` to write.

    Raises:
        NetError: the net has no route that a car could drive, or no sidewalks for the people wanted.
    """
    rng = seed.generator()
    root = Element("routes")
    for attributes in vehicle_types(rng):
        SubElement(root, "vType", attributes)
    trips = sorted(_trips(road, options, duration_s, rng), key=lambda trip: trip.depart_s)
    departures = []
    for number, trip in enumerate(trips):
        vehicle = Element("vehicle", _vehicle(number, trip))
        SubElement(vehicle, "route", edges=" ".join(trip.route))
        departures.append((trip.depart_s, vehicle))
    if options.pedestrians_per_km > 0.0:
        for attributes in person_types():
            SubElement(root, "vType", attributes)
        people = seed.child("people").generator()
        departures += walks(road.path, options.pedestrians_per_km, duration_s, people)
        departures.sort(key=lambda row: row[0])
    root.extend(row for _, row in departures)
    indent(root)
    ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    return path


def vehicle_types(rng: np.random.Generator) -> Iterator[dict[str, str]]:
    """Yield vType attributes: cars with drivers of many habits, trucks and buses."""
    for number in range(_DRIVER_TYPES):
        length = rng.uniform(4.0, 5.1)
        yield _vtype(f"car{number}", "passenger", length, 0.35 * length + 0.2, 1.0, rng)
    for name, vclass, length, width in (("truck", "truck", 9.0, 2.5), ("bus", "bus", 12.0, 2.55)):
        yield _vtype(name, vclass, length, width, 0.55, rng)


def _vtype(
    name: str, vclass: str, length: float, width: float, vigour: float, rng: np.random.Generator
) -> dict[str, str]:
    values = {
        "length": length,
        "width": width,
        "tau": rng.uniform(*_HEADWAY_S),
        "accel": vigour * rng.uniform(*_ACCEL_MPS2),
        "decel": rng.uniform(*_DECEL_MPS2),
        "emergencyDecel": 9.0,
        "speedFactor": rng.uniform(*_SPEED_FACTOR),
        "minGap": rng.uniform(*_MIN_GAP_M),
    }
    fixed = {"id": name, "vClass": vclass, "carFollowModel": "IDM", "speedDev": "0", "sigma": "0"}
    return fixed | {key: f"{value:.3f}" for key, value in values.items()}


def _vehicle(number: int, trip: Trip) -> dict[str, str]:
    where = "random_free" if trip.on_the_way else "base"
    pace = "max" if not trip.on_the_way else "desired"
    return {
        "id": f"v{number}",
        "type": trip.type_id,
        "depart": f"{trip.depart_s:.1f}",
        "departLane": "best",
        "departPos": where,
        "departSpeed": pace,
    }


def _trips(
    road: RoadMap, options: SceneOptions, duration_s: float, rng: np.random.Generator
) -> Iterator[Trip]:
    edges = [e for e in sorted(road.edges) if _drivable(road, e)]
    if not edges:
        raise NetError(road.path, "holds no lane that a car may drive", "give a net with passenger lanes")
    lane_m = np.array([road.edges[e].length_m * car_lanes(road, e) for e in edges])
    present = int(np.clip(options.density_per_km * lane_m.sum() / 1000.0, 4, options.max_vehicles))
    sources = [e for e in road.source_edges() if _drivable(road, e)] or edges
    capacity = np.array([road.edges[e].speed_mps * car_lanes(road, e) for e in sources])
    inflow = max(int(present * duration_s / _MEAN_TRIP_S), 1)
    starts = [(edges[k], 0.0, True) for k in rng.choice(len(edges), present, p=lane_m / lane_m.sum())]
    entries = rng.choice(len(sources), inflow, p=capacity / capacity.sum())
    departs = np.sort(rng.uniform(0.0, duration_s, size=inflow)).tolist()
    starts += [(sources[k], depart, False) for k, depart in zip(entries, departs, strict=True)]
    trips = [trip for start in starts if (trip := _trip(road, *start, options, rng)) is not None]
    if not trips:
        raise NetError(road.path, "holds no drivable route", "give a net in which edges are connected")
    yield from trips


def _trip(
    road: RoadMap,
    start: str,
    depart_s: float,
    on_the_way: bool,
    options: SceneOptions,
    rng: np.random.Generator,
) -> Trip | None:
    heavy = rng.random() < options.trucks_share
    type_id = ("truck" if rng.random() < 0.6 else "bus") if heavy else f"car{rng.integers(_DRIVER_TYPES)}"
    vclass = "passenger" if not heavy else type_id
    route = road.random_route(start, _MIN_ROUTE_M + rng.exponential(600.0), rng, vclass=vclass)
    if len(route) < 2:
        return None
    return Trip(depart_s, type_id, tuple(route), on_the_way)


def _drivable(road: RoadMap, edge_id: str) -> bool:
    return not road.edges[edge_id].is_internal and car_lanes(road, edge_id) > 0


def car_lanes(road: RoadMap, edge_id: str) -> int:
    """Return how many lanes of an edge cars may use, sidewalks and lanes for bicycles or buses left aside."""
    return sum(road.lanes[lane].permits("passenger") for lane in road.edges[edge_id].lane_ids)


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
    inflow = round(present * duration_s / _MEAN_WALK_S)
    departs = np.concatenate((np.zeros(present), np.sort(rng.uniform(0.0, duration_s, inflow))))
    starts = rng.choice(len(ways.edges), len(departs), p=ways.length_m / ways.length_m.sum())
    return [
        (depart, _person(number, depart, ways, int(start), rng))
        for number, (depart, start) in enumerate(zip(departs.tolist(), starts, strict=True))
    ]


def _person(number: int, depart_s: float, ways: Footways, start: int, rng: np.random.Generator) -> Element:
    gap = np.linalg.norm(ways.middle_m - ways.middle_m[start], axis=-1)
    others = np.flatnonzero((ways.part == ways.part[start]) & (np.arange(len(gap)) != start))
    near = others[gap[others] <= _WALK_REACH_M]
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
