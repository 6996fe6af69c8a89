"""Demand of one simulation: mixed vehicles on random routes, stops on the way, cars parked at the kerb."""

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
"""Beginning of the names of vehicles that stand at the kerb from the start."""
_DENSITY_PER_KM = (4.0, 36.0)
_MOST_VEHICLES = 420
_MEAN_TRIP_S = 120.0
_SHORT_SHARE, _SHORT_TRIP_M, _LONG_TRIP_M = 0.35, 90.0, 600.0
_FAST_MPS = 17.0
_CITY_ONLY = frozenset({"bicycle"})
_STOPPING_SHARE = 0.03
_PARKED_GROUPS_PER_KM, _NEXT_PARKED = 7.0, 0.65


@dataclass(frozen=True)
class WeightedStreets:
    """Edges on which cars drive, with the metres of their lanes for cars as weights."""

    ids: tuple[str, ...]
    lane_m: tuple[float, ...]

    @staticmethod
    def of(road: RoadMap) -> WeightedStreets:
        """Return those of *road*.

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
    """Write demand that fills the net at once to a random density and keeps it, to *path* (``.rou.xml``).

    Args:
        road: the net.
        duration_s: how long vehicles come in.
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
    for vehicle in _parked(road, streets, types, rng) if stops else ():
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
    weights = np.array(streets.lane_m)
    low, high = np.log(_DENSITY_PER_KM)
    density = float(np.exp(rng.uniform(low, high)))
    present = int(np.clip(density * weights.sum() / 1000.0, 12, _MOST_VEHICLES))
    sources = [e for e in road.source_edges() if e in set(streets.ids)] or list(streets.ids)
    capacity = np.array([road.edges[e].speed_mps * car_lanes(road, e) for e in sources])
    inflow = max(int(present * duration_s / _MEAN_TRIP_S), 1)
    starts = [(streets.ids[k], None) for k in rng.choice(len(weights), present, p=weights / weights.sum())]
    entries = rng.choice(len(sources), inflow, p=capacity / capacity.sum())
    departs = rng.uniform(1.0, duration_s, size=inflow)
    inflows = [(sources[k], float(depart)) for k, depart in zip(entries, departs, strict=True)]
    for number, (edge, depart_s) in enumerate([*starts, *inflows]):
        driver = _drawn(types, rng)
        vehicle = _vehicle(road, f"v{number}", driver, edge, depart_s, rng)
        if vehicle is not None:
            yield vehicle


def _drawn(types: Sequence[DriverType], rng: np.random.Generator) -> DriverType:
    kinds = list(KINDS)
    kind = kinds[int(rng.choice(len(kinds), p=[KINDS[k].share for k in kinds]))]
    same = [driver for driver in types if driver.kind == kind]
    return same[int(rng.integers(len(same)))]


def _vehicle(
    road: RoadMap,
    name: str,
    driver: DriverType,
    edge: str,
    depart_s: float | None,
    rng: np.random.Generator,
) -> Element | None:
    """Return a vehicle that is on its way when the simulation starts, or that enters at *depart_s*."""
    vclass = driver.attributes["vClass"]
    if driver.kind in _CITY_ONLY and road.edges[edge].speed_mps > _FAST_MPS:
        return None
    least = _SHORT_TRIP_M if rng.random() < _SHORT_SHARE else _LONG_TRIP_M
    route = road.random_route(edge, least + rng.exponential(least), rng, vclass=vclass)
    if len(route) < 2:
        return None
    where = {"departPos": "base"} if depart_s is not None else {"departPos": "random_free"}
    depart = f"{1.0 if depart_s is None else depart_s:.1f}"
    values = {"id": name, "type": driver.id, "depart": depart, "departLane": "best", "departSpeed": "max"}
    vehicle = Element("vehicle", values | where)
    SubElement(vehicle, "route", edges=" ".join(route))
    if rng.random() < _STOPPING_SHARE:
        _stop_on_the_way(road, vehicle, route, rng)
    return vehicle


def _stop_on_the_way(road: RoadMap, vehicle: Element, route: Sequence[str], rng: np.random.Generator) -> None:
    """Add a short stop in the outer lane of a street with a second one."""
    wide = [
        e
        for e in route[1:]
        if road.edges[e].speed_mps <= _FAST_MPS
        and road.edges[e].length_m > 60.0
        and len(road.edges[e].lane_ids) > 1
        and road.lanes[road.edges[e].lane_ids[0]].permits("passenger")
    ]
    if wide:
        edge = road.edges[wide[int(rng.integers(len(wide)))]]
        lane = road.lanes[edge.lane_ids[0]]
        end = rng.uniform(0.4, 0.8) * lane.sumo_length_m
        SubElement(vehicle, "stop", lane=lane.id, endPos=f"{end:.1f}", duration=f"{rng.uniform(6, 40):.0f}")


def _parked(
    road: RoadMap, streets: WeightedStreets, types: Sequence[DriverType], rng: np.random.Generator
) -> Iterator[Element]:
    """Yield cars parked beside the outer lanes of quiet streets."""
    groups_per_m = rng.uniform(0.0, _PARKED_GROUPS_PER_KM) / 1000.0 + 1e-6
    cars = [driver for driver in types if driver.kind == "car"]
    number = 0
    for edge_id in streets.ids:
        edge = road.edges[edge_id]
        lane = road.lanes[edge.lane_ids[0]]
        if edge.speed_mps > _FAST_MPS or edge.length_m < 50.0 or not lane.permits("passenger"):
            continue
        at = 12.0 + rng.exponential(1.0 / groups_per_m)
        while at < lane.sumo_length_m - 18.0:
            yield _standing(f"{PARKED}{number}", cars, (edge_id, lane.id, at), rng)
            number += 1
            goes_on = rng.random() < _NEXT_PARKED
            at += rng.uniform(6.5, 9.0) + (0.0 if goes_on else rng.exponential(1.0 / groups_per_m))


def _standing(
    name: str, cars: Sequence[DriverType], place: tuple[str, str, float], rng: np.random.Generator
) -> Element:
    """Return a car that stands at the kerb for good: SUMO lets parked ones jump into the lane."""
    edge, lane, at = place
    values = {"id": name, "type": cars[int(rng.integers(len(cars)))].id, "depart": "0", "departLane": "0"}
    vehicle = Element("vehicle", values | {"departPos": f"{at:.2f}", "departSpeed": "0"})
    SubElement(vehicle, "route", edges=edge)
    span = {"startPos": f"{at - 3.0:.2f}", "endPos": f"{at + 0.1:.2f}"}
    SubElement(vehicle, "stop", {"lane": lane, **span, "duration": "1000000", "parking": "true"})
    return vehicle
