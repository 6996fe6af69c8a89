"""Drive random traffic over a net for an hour and count what should not happen."""

from __future__ import annotations

import random
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import libsumo
import numpy as np
import sumolib
from defusedxml import ElementTree
from scipy.spatial import cKDTree

from advdiff_sumo.core import boxes
from advdiff_sumo.core.errors import NetError, SimulationError

LENGTH_M, WIDTH_M = 4.6, 1.9
CHECK_S = 0.5  # how often boxes are compared
SHORTEST_TRIP_M = 200.0
SHORTEST_END_M = (
    20.0  # of the edges where trips begin and end; SUMO puts cars into each other on edges shorter than a car
)
TRIES = 20
VTYPE = "driving_test_car"
OVERLAP_M = 0.05  # boxes that share less only touch
SET_OUT_PER_STEP = 5
READ = (libsumo.VAR_POSITION, libsumo.VAR_ANGLE, libsumo.VAR_SPEED, libsumo.VAR_LANE_ID)


def driving_test(
    net: Path,
    *,
    vehicles: int = 300,
    duration_s: float = 3600.0,
    step_s: float = 0.5,
    seed: int = 1,
    in_all: bool = False,
) -> dict[str, Any]:
    """Return what happened to *vehicles* cars on random trips: so many at a time, or *in_all* evenly over the duration.

    Cars drive from a random edge of 20 m and more to another that can be reached from it; when one arrives the
    next sets out. A fragment of a town jams with too many at a time, however good the net: see ``vehicles_per_km``.
    Teleports
    (after 300 s of waiting), emergency braking and collisions are SUMO's own counts; besides, the boxes of all
    cars are compared with each other twice a second.

    Raises:
        NetError: the net holds no trip of some length.
        SimulationError: SUMO stopped.
    """
    trips = _Trips(net, seed)
    command = [
        "sumo",
        "-n",
        str(net),
        "--step-length",
        str(step_s),
        "--seed",
        str(seed),
        "--no-step-log",
        "true",
    ]
    command += [
        "--collision.action",
        "warn",
        "--collision.check-junctions",
        "true",
        "--collision.mingap-factor",
        "0",
    ]
    command += ["--no-warnings", "true", "--xml-validation", "never", "--max-depart-delay", "60"]
    with tempfile.TemporaryDirectory() as folder:
        statistics = Path(folder) / "statistics.xml"
        libsumo.start([*command, "--statistic-output", str(statistics)])
        try:
            tally = _drive(trips, vehicles, duration_s, step_s, in_all=in_all)
        except libsumo.TraCIException as error:
            raise SimulationError(f"{net}: SUMO stopped the driving test ({error})") from None
        finally:
            libsumo.close()
        return _summary(tally, _emergency_brakings(statistics), vehicles, duration_s, step_s) | {
            "vehicles_in_all": in_all,
            "lane_km": round(trips.lane_km, 2),
            "vehicles_per_km": round(tally.vehicle_steps * step_s / duration_s / trips.lane_km, 2),
        }


class _Trips:
    """Random trips between edges, from far apart ends where there are any."""

    def __init__(self, net: Path, seed: int) -> None:
        self._net = sumolib.net.readNet(str(net))
        self._random = random.Random(seed)  # noqa: S311 - traffic, not secrets
        edges = [edge for edge in self._net.getEdges() if edge.allows("passenger")]
        self._edges = sorted(edges, key=lambda edge: edge.getID())
        self._ends = [edge for edge in self._edges if edge.getLength() >= SHORTEST_END_M]
        self._pool = self._find_pool(net)

    @property
    def lane_km(self) -> float:
        """Length of all lanes for cars, without those in junctions, in km."""
        lanes = [lane for edge in self._edges for lane in edge.getLanes() if lane.allows("passenger")]
        return float(sum(lane.getLength() for lane in lanes)) / 1000.0

    def _find_pool(self, net: Path) -> list[tuple[list[str], float]]:
        """Return a pool of routes; a few hundred are enough for an hour."""
        pool: list[tuple[list[str], float]] = []
        for _ in range(TRIES * 100):
            route = self._route()
            if route is not None:
                pool.append(route)
            if len(pool) >= 400:
                break
        if not pool:
            raise NetError(net, f"holds no way of {SHORTEST_TRIP_M:.0f} m", "give a net with roads that join")
        return pool

    def _route(self) -> tuple[list[str], float] | None:
        if not self._ends:
            return None
        origin, target = self._random.choice(self._ends), self._random.choice(self._ends)
        way, length = self._net.getShortestPath(origin, target, vClass="passenger")
        if way is None or length < SHORTEST_TRIP_M:
            return None
        return [edge.getID() for edge in way], float(length)

    def draw(self) -> list[str]:
        """Return the edges of the next trip."""
        return self._random.choice(self._pool)[0]


@dataclass
class _Tally:
    """What happened so far; contacts are pairs of names, each counted once."""

    teleports: int = 0
    arrived: int = 0
    metres: float = 0.0
    vehicle_steps: int = 0
    most_at_once: int = 0
    sumo_collisions: set[tuple[str, str]] = field(default_factory=set)
    box_contacts: set[tuple[str, str]] = field(default_factory=set)
    places: Counter[str] = field(default_factory=Counter)
    stuck: Counter[str] = field(default_factory=Counter)
    last_lane: dict[str, str] = field(default_factory=dict)


def _drive(trips: _Trips, vehicles: int, duration_s: float, step_s: float, *, in_all: bool) -> _Tally:
    libsumo.vehicletype.copy("DEFAULT_VEHTYPE", VTYPE)
    libsumo.vehicletype.setLength(VTYPE, LENGTH_M)
    libsumo.vehicletype.setWidth(VTYPE, WIDTH_M)
    tally, number = _Tally(), 0
    every = max(1, round(CHECK_S / step_s))
    for step in range(round(duration_s / step_s)):
        on_the_way = libsumo.vehicle.getIDCount() + len(libsumo.simulation.getPendingVehicles())
        due = int(vehicles * step * step_s / duration_s) + 1
        missing = due - number if in_all else vehicles - on_the_way
        for _ in range(min(missing, SET_OUT_PER_STEP)):
            _set_out(f"car{number}", trips.draw())
            number += 1
        libsumo.simulationStep()
        for name in libsumo.simulation.getDepartedIDList():
            libsumo.vehicle.subscribe(name, READ)
        _note(tally, libsumo.vehicle.getAllSubscriptionResults(), step_s, check=step % every == 0)
    return tally


def _set_out(name: str, edges: list[str]) -> None:
    libsumo.route.add(name, edges)
    libsumo.vehicle.add(name, name, typeID=VTYPE, departLane="best", departSpeed="max")


def _note(tally: _Tally, state: dict[str, dict[int, Any]], step_s: float, *, check: bool) -> None:
    tally.arrived += libsumo.simulation.getArrivedNumber()
    tally.teleports += libsumo.simulation.getStartingTeleportNumber()
    on_road = {
        name: row for name, row in state.items() if row[libsumo.VAR_LANE_ID]
    }  # the others are teleporting
    tally.stuck.update(tally.last_lane[name] for name in libsumo.simulation.getStartingTeleportIDList())
    tally.last_lane.update({name: row[libsumo.VAR_LANE_ID] for name, row in on_road.items()})
    tally.metres += step_s * sum(row[libsumo.VAR_SPEED] for row in on_road.values())
    tally.vehicle_steps += len(state)
    tally.most_at_once = max(tally.most_at_once, len(state))
    for collision in libsumo.simulation.getCollisions():
        tally.sumo_collisions.add(_pair(collision.collider, collision.victim))
    if check:
        new = _contacts(on_road) - tally.box_contacts
        tally.places.update(str(state[first][libsumo.VAR_LANE_ID]) for first, _ in new)
        tally.box_contacts |= new


def _contacts(state: dict[str, dict[int, Any]]) -> set[tuple[str, str]]:
    """Return the pairs of cars whose boxes overlap."""
    names = sorted(state)
    if len(names) < 2:
        return set()
    front = np.array([state[name][libsumo.VAR_POSITION] for name in names])
    yaw = np.radians(90.0 - np.array([state[name][libsumo.VAR_ANGLE] for name in names]))
    centre = front - 0.5 * LENGTH_M * np.stack((np.cos(yaw), np.sin(yaw)), axis=-1)
    pairs = cKDTree(centre).query_pairs(LENGTH_M + 1.0, output_type="ndarray")
    corners = boxes.corners(centre, yaw, np.tile([LENGTH_M, WIDTH_M], (len(names), 1)))
    overlap = boxes.separation(corners[pairs[:, 0]], corners[pairs[:, 1]]) < -OVERLAP_M
    return {_pair(names[a], names[b]) for a, b in pairs[overlap]}


def _pair(one: str, other: str) -> tuple[str, str]:
    return (one, other) if one < other else (other, one)


def _emergency_brakings(statistics: Path) -> int:
    """Return SUMO's count, which it writes when it closes."""
    element = ElementTree.fromstring(statistics.read_bytes()).find("safety")
    return 0 if element is None else int(element.get("emergencyBraking", "0"))


def _summary(tally: _Tally, brakings: int, vehicles: int, duration_s: float, step_s: float) -> dict[str, Any]:
    kilometres = tally.metres / 1000.0
    return {
        "vehicles_wanted": vehicles,
        "vehicles_mean": round(tally.vehicle_steps * step_s / duration_s, 1),
        "vehicles_most": tally.most_at_once,
        "duration_s": duration_s,
        "step_s": step_s,
        "arrived": tally.arrived,
        "vehicle_km": round(kilometres, 1),
        "mean_speed_mps": round(tally.metres / max(tally.vehicle_steps * step_s, 1e-9), 2),
        "teleports": tally.teleports,
        "emergency_brakings": brakings,
        "emergency_brakings_per_1000_km": round(1000.0 * brakings / kilometres, 3) if kilometres else None,
        "collisions_sumo": len(tally.sumo_collisions),
        "collisions_boxes": len(tally.box_contacts),
        "places_of_teleports": dict(tally.stuck.most_common(10)),
        "places_of_contacts": dict(tally.places.most_common(10)),
    }
