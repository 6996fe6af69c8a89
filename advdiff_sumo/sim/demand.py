"""Generate demand for a net that has none: drivers of various habits on random routes, and pedestrians."""

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

# Ranges of the drivers' parameters.
_HEADWAY_S = (0.9, 1.8)
_ACCEL_MPS2 = (1.6, 2.8)
_DECEL_MPS2 = (3.0, 4.5)
_SPEED_FACTOR = (0.85, 1.1)
_MIN_GAP_M = (1.5, 3.0)
_DRIVER_TYPES = 8
_MIN_ROUTE_M = 250.0
_MEAN_TRIP_S = 150.0  # vehicles present / inflow, by Little's law
_WALKING_SPEEDS_MPS = (1.1, 1.25, 1.4, 1.6)
_MAX_WALK_M = 300.0  # between the midpoints of the sidewalks where a trip begins and ends
_MEAN_WALK_S = 200.0  # pedestrians present / inflow, by Little's law


@dataclass(frozen=True)
class Trip:
    """The departure of one vehicle; if *on_the_way*, anywhere on its first edge and at speed, to fill the net."""

    depart_s: float
    type_id: str
    route: tuple[str, ...]
    on_the_way: bool


def write_demand(road: RoadMap, options: SceneOptions, duration_s: float, seed: SeedTree, path: Path) -> Path:
    """Write traffic for *road* that fills the net at once and then keeps its density.

    Args:
        road: the net.
        options: density, maximum and share of trucks.
        duration_s: time of the last departures.
        seed: a node of the seed tree.
        path: the ``.rou.xml`` to write.

    Raises:
        NetError: the net has no route that a car could drive, or no sidewalks for the pedestrians wanted.
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
        walk_rng = seed.child("people").generator()
        departures += walks(road.path, options.pedestrians_per_km, duration_s, walk_rng)
        departures.sort(key=lambda departure: departure[0])
    root.extend(departure for _, departure in departures)
    indent(root)
    ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    return path


def vehicle_types(rng: np.random.Generator) -> Iterator[dict[str, str]]:
    """Yield vType attributes: cars with drivers of various habits, trucks and buses."""
    for number in range(_DRIVER_TYPES):
        length = rng.uniform(4.0, 5.1)
        yield _vtype(f"car{number}", "passenger", length, 0.35 * length + 0.2, 1.0, rng)
    for name, vclass, length, width in (("truck", "truck", 9.0, 2.5), ("bus", "bus", 12.0, 2.55)):
        yield _vtype(name, vclass, length, width, 0.55, rng)


def _vtype(
    name: str, vclass: str, length: float, width: float, accel_factor: float, rng: np.random.Generator
) -> dict[str, str]:
    """Return random vType attributes; *accel_factor* scales the acceleration."""
    values = {
        "length": length,
        "width": width,
        "tau": rng.uniform(*_HEADWAY_S),
        "accel": accel_factor * rng.uniform(*_ACCEL_MPS2),
        "decel": rng.uniform(*_DECEL_MPS2),
        "emergencyDecel": 9.0,
        "speedFactor": rng.uniform(*_SPEED_FACTOR),
        "minGap": rng.uniform(*_MIN_GAP_M),
    }
    fixed = {"id": name, "vClass": vclass, "carFollowModel": "IDM", "speedDev": "0", "sigma": "0"}
    return fixed | {key: f"{value:.3f}" for key, value in values.items()}


def _vehicle(number: int, trip: Trip) -> dict[str, str]:
    """Return the attributes of the vehicle of *trip*."""
    depart_pos = "random_free" if trip.on_the_way else "base"
    depart_speed = "max" if not trip.on_the_way else "desired"
    return {
        "id": f"v{number}",
        "type": trip.type_id,
        "depart": f"{trip.depart_s:.1f}",
        "departLane": "best",
        "departPos": depart_pos,
        "departSpeed": depart_speed,
    }


def _trips(
    road: RoadMap, options: SceneOptions, duration_s: float, rng: np.random.Generator
) -> Iterator[Trip]:
    """Yield trips that fill the net at time 0, and then trips that begin at its entries."""
    edges = [edge for edge in sorted(road.edges) if _drivable(road, edge)]
    if not edges:
        raise NetError(road.path, "holds no lane that a car may drive", "give a net with passenger lanes")
    lane_m = np.array([road.edges[edge].length_m * car_lanes(road, edge) for edge in edges])
    present = int(np.clip(options.density_per_km * lane_m.sum() / 1000.0, 4, options.max_vehicles))
    sources = [edge for edge in road.source_edges() if _drivable(road, edge)] or edges
    capacity = np.array([road.edges[edge].speed_mps * car_lanes(road, edge) for edge in sources])
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
    """Return a trip with a random vehicle type and route; None if the route would be a single edge."""
    is_heavy = rng.random() < options.trucks_share
    type_id = ("truck" if rng.random() < 0.6 else "bus") if is_heavy else f"car{rng.integers(_DRIVER_TYPES)}"
    vclass = "passenger" if not is_heavy else type_id
    route = road.random_route(start, _MIN_ROUTE_M + rng.exponential(600.0), rng, vclass=vclass)
    if len(route) < 2:
        return None
    return Trip(depart_s, type_id, tuple(route), on_the_way)


def _drivable(road: RoadMap, edge_id: str) -> bool:
    """Return whether cars may drive on an edge outside junctions."""
    return not road.edges[edge_id].is_internal and car_lanes(road, edge_id) > 0


def car_lanes(road: RoadMap, edge_id: str) -> int:
    """Return how many lanes of an edge are open to cars; sidewalks and lanes for bicycles or buses are not."""
    return sum(road.lanes[lane].permits("passenger") for lane in road.edges[edge_id].lane_ids)


def person_types() -> Iterator[dict[str, str]]:
    """Yield vType attributes of pedestrians with different walking speeds.

    ``desiredMaxSpeed`` is what SUMO writes into a saved state; without it they run at the limit of the sidewalk, 10
    km/h, once an episode starts from that state.
    """
    for number, speed_mps in enumerate(_WALKING_SPEEDS_MPS):
        speeds = dict.fromkeys(("maxSpeed", "desiredMaxSpeed"), f"{speed_mps:g}")
        yield {"id": f"walker{number}", "vClass": "pedestrian", **speeds, "speedDev": "0"}


def walks(
    net: Path, per_km: float, duration_s: float, rng: np.random.Generator
) -> list[tuple[float, Element]]:
    """Return (departure in s, person) of pedestrians on random trips, *per_km* present on each km of sidewalk.

    Raises:
        NetError: the net has no connected sidewalks.
    """
    footways = read_footways(net)
    if not footways.edges:
        remedy = "convert it with --crossings guess, or set scene.pedestrians_per_km=0"
        raise NetError(net, "has no sidewalks with crossings for people on foot", remedy)
    present = max(round(per_km * footways.length_m.sum() / 1000.0), 1)
    inflow = round(present * duration_s / _MEAN_WALK_S)
    departs = np.concatenate((np.zeros(present), np.sort(rng.uniform(0.0, duration_s, inflow))))
    starts = rng.choice(len(footways.edges), len(departs), p=footways.length_m / footways.length_m.sum())
    return [
        (depart, _person(number, depart, footways, int(start), rng))
        for number, (depart, start) in enumerate(zip(departs.tolist(), starts, strict=True))
    ]


def _person(
    number: int, depart_s: float, footways: Footways, start: int, rng: np.random.Generator
) -> Element:
    """Return a pedestrian on a trip from sidewalk *start* to a random other one that is connected and near."""
    distance = np.linalg.norm(footways.middle_m - footways.middle_m[start], axis=-1)
    connected = np.flatnonzero((footways.part == footways.part[start]) & (np.arange(len(distance)) != start))
    near_ends = connected[distance[connected] <= _MAX_WALK_M]
    end = int(rng.choice(near_ends)) if len(near_ends) else int(connected[distance[connected].argmin()])
    start_s_m = rng.uniform(0.0, footways.length_m[start])
    person = Element(
        "person",
        id=str(number),
        type=f"walker{rng.integers(len(_WALKING_SPEEDS_MPS))}",
        depart=f"{depart_s:.1f}",
        departPos=f"{start_s_m:.1f}",
    )
    SubElement(person, "personTrip", {"from": footways.edges[start], "to": footways.edges[end]})
    return person
