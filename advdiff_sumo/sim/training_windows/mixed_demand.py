"""Generate demand of one simulation: mixed vehicles on random routes, stops on the way, parked cars."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement

import numpy as np

from advdiff_sumo.core.errors import NetError
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.demand import car_lanes
from advdiff_sumo.sim.training_windows.driver_types import KINDS, DriverType, driver_types

PARKED = "parked"
"""Prefix of the names of vehicles that are parked from the start."""
_DENSITY_PER_KM = (4.0, 36.0)  # lowest and highest
_MAX_VEHICLES = 420
_MEAN_TRIP_S = 120.0  # vehicles present / inflow, by Little's law
# Share of short trips; least length of short and of long trips.
_SHORT_SHARE, _SHORT_TRIP_M, _LONG_TRIP_M = 0.35, 90.0, 600.0
_FAST_MPS = 17.0  # on streets with a higher limit there are no bicycles, stops or parked cars
_SLOW_STREETS_ONLY = frozenset({"bicycle"})
_STOPPING_SHARE = 0.03
_PARKED_GROUPS_PER_KM = 7.0  # largest number
_GROUP_CONTINUES = 0.65  # probability of a further car in a group of parked ones


@dataclass(frozen=True)
class WeightedStreets:
    """Edges on which cars may drive, weighted by the metres of their lanes for cars."""

    ids: tuple[str, ...]
    lane_m: tuple[float, ...]

    @staticmethod
    def of(road: RoadMap) -> WeightedStreets:
        """Return the weighted streets of *road*.

        Raises:
            NetError: there is none.
        """
        ids = [e for e in sorted(road.edges) if not road.edges[e].is_internal and car_lanes(road, e)]
        if not ids:
            raise NetError(road.path, "holds no lane that a car may drive", "give a net with passenger lanes")
        return WeightedStreets(tuple(ids), tuple(road.edges[e].length_m * car_lanes(road, e) for e in ids))


def write_mixed_demand(
    road: RoadMap, duration_s: float, seed: SeedTree, path: Path, stops: bool = True
) -> Path:
    """Write demand to *path* (``.rou.xml``) that fills the net at once to a random density and keeps that.

    Args:
        road: the net.
        duration_s: time of the last departures.
        seed: of drivers, trips and stops.
        path: of the file.
        stops: whether vehicles park at the kerb or stop on their way.

    Raises:
        NetError: the net has no route that a car could drive.
    """
    rng = seed.generator()
    root = Element("routes")
    types = driver_types(rng)
    for driver in types:
        element = SubElement(root, "vType", dict(driver.attributes))
        for key, value in driver.parameters.items():
            SubElement(element, "param", key=key, value=value)
    streets = WeightedStreets.of(road)
    for vehicle in _parked_cars(road, streets, types, rng) if stops else ():
        root.append(vehicle)
    trips = sorted(_trips(road, streets, types, duration_s, rng), key=lambda v: float(v.attrib["depart"]))
    if not trips:
        raise NetError(road.path, "holds no drivable route", "give a net in which edges are connected")
    for vehicle in trips:
        if not stops:
            for stop in vehicle.findall("stop"):
                vehicle.remove(stop)
        root.append(vehicle)
    ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    return path


def _trips(
    road: RoadMap,
    streets: WeightedStreets,
    types: Sequence[DriverType],
    duration_s: float,
    rng: np.random.Generator,
) -> Iterator[Element]:
    """Yield vehicles that fill the net at the start, and then vehicles that enter it."""
    weights = np.array(streets.lane_m)
    low, high = np.log(_DENSITY_PER_KM)
    density = float(np.exp(rng.uniform(low, high)))
    present = int(np.clip(density * weights.sum() / 1000.0, 12, _MAX_VEHICLES))
    sources = [edge_id for edge_id in road.source_edges() if edge_id in set(streets.ids)] or list(streets.ids)
    capacity = np.array([road.edges[edge_id].speed_mps * car_lanes(road, edge_id) for edge_id in sources])
    inflow = max(int(present * duration_s / _MEAN_TRIP_S), 1)
    starts = [(streets.ids[k], None) for k in rng.choice(len(weights), present, p=weights / weights.sum())]
    entries = rng.choice(len(sources), inflow, p=capacity / capacity.sum())
    departs = rng.uniform(1.0, duration_s, size=inflow)
    inflows = [(sources[k], float(depart)) for k, depart in zip(entries, departs, strict=True)]
    for number, (edge, depart_s) in enumerate([*starts, *inflows]):
        driver = _draw_driver(types, rng)
        vehicle = _vehicle(road, f"v{number}", driver, edge, depart_s, rng)
        if vehicle is not None:
            yield vehicle


def _draw_driver(types: Sequence[DriverType], rng: np.random.Generator) -> DriverType:
    """Return a random driver type; the kind of vehicle is drawn first, by its share."""
    kinds = list(KINDS)
    kind = kinds[int(rng.choice(len(kinds), p=[KINDS[k].share for k in kinds]))]
    drivers = [driver for driver in types if driver.kind == kind]
    return drivers[int(rng.integers(len(drivers)))]


def _vehicle(
    road: RoadMap,
    name: str,
    driver: DriverType,
    edge: str,
    depart_s: float | None,
    rng: np.random.Generator,
) -> Element | None:
    """Return a vehicle on a random route; None if there is none for it.

    It enters at *depart_s*; None: it is on its way when the simulation starts.
    """
    vclass = driver.attributes["vClass"]
    if driver.kind in _SLOW_STREETS_ONLY and road.edges[edge].speed_mps > _FAST_MPS:
        return None
    min_length_m = _SHORT_TRIP_M if rng.random() < _SHORT_SHARE else _LONG_TRIP_M
    route = road.random_route(edge, min_length_m + rng.exponential(min_length_m), rng, vclass=vclass)
    if len(route) < 2:
        return None
    position = {"departPos": "base"} if depart_s is not None else {"departPos": "random_free"}
    depart = f"{1.0 if depart_s is None else depart_s:.1f}"
    attributes = {"id": name, "type": driver.id, "depart": depart, "departLane": "best", "departSpeed": "max"}
    vehicle = Element("vehicle", attributes | position)
    SubElement(vehicle, "route", edges=" ".join(route))
    if rng.random() < _STOPPING_SHARE:
        _add_stop(road, vehicle, route, rng)
    return vehicle


def _add_stop(road: RoadMap, vehicle: Element, route: Sequence[str], rng: np.random.Generator) -> None:
    """Add a short stop on the outer lane of a slow street with two lanes or more."""
    edges = [
        edge_id
        for edge_id in route[1:]
        if road.edges[edge_id].speed_mps <= _FAST_MPS
        and road.edges[edge_id].length_m > 60.0
        and len(road.edges[edge_id].lane_ids) > 1
        and road.lanes[road.edges[edge_id].lane_ids[0]].permits("passenger")
    ]
    if edges:
        edge = road.edges[edges[int(rng.integers(len(edges)))]]
        lane = road.lanes[edge.lane_ids[0]]
        end_m = rng.uniform(0.4, 0.8) * lane.sumo_length_m
        SubElement(vehicle, "stop", lane=lane.id, endPos=f"{end_m:.1f}", duration=f"{rng.uniform(6, 40):.0f}")


def _parked_cars(
    road: RoadMap, streets: WeightedStreets, types: Sequence[DriverType], rng: np.random.Generator
) -> Iterator[Element]:
    """Yield groups of cars parked beside the outer lanes of slow streets."""
    groups_per_m = rng.uniform(0.0, _PARKED_GROUPS_PER_KM) / 1000.0 + 1e-6
    cars = [driver for driver in types if driver.kind == "car"]
    number = 0
    for edge_id in streets.ids:
        edge = road.edges[edge_id]
        lane = road.lanes[edge.lane_ids[0]]
        if edge.speed_mps > _FAST_MPS or edge.length_m < 50.0 or not lane.permits("passenger"):
            continue
        s_m = 12.0 + rng.exponential(1.0 / groups_per_m)
        while s_m < lane.sumo_length_m - 18.0:
            yield _parked_car(f"{PARKED}{number}", cars, (edge_id, lane.id, s_m), rng)
            number += 1
            group_continues = rng.random() < _GROUP_CONTINUES
            s_m += rng.uniform(6.5, 9.0) + (0.0 if group_continues else rng.exponential(1.0 / groups_per_m))


def _parked_car(
    name: str, cars: Sequence[DriverType], place: tuple[str, str, float], rng: np.random.Generator
) -> Element:
    """Return a car that stays parked at the kerb; without a stop, SUMO lets parked cars jump into the lane."""
    edge, lane, s_m = place
    attributes = {"id": name, "type": cars[int(rng.integers(len(cars)))].id, "depart": "0", "departLane": "0"}
    vehicle = Element("vehicle", attributes | {"departPos": f"{s_m:.2f}", "departSpeed": "0"})
    SubElement(vehicle, "route", edges=edge)
    span = {"startPos": f"{s_m - 3.0:.2f}", "endPos": f"{s_m + 0.1:.2f}"}
    SubElement(vehicle, "stop", {"lane": lane, **span, "duration": "1000000", "parking": "true"})
    return vehicle
