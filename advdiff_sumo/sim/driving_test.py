"""Drive random traffic over a net for an hour and count events that a sound net does not cause."""

from __future__ import annotations

import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import libsumo
import numpy as np
from defusedxml import ElementTree
from scipy.spatial import cKDTree

from advdiff_sumo.core import boxes
from advdiff_sumo.core.errors import SimulationError
from advdiff_sumo.maps.lanes import edge_of_lane
from advdiff_sumo.sim.random_trips import RandomTrips

LENGTH_M, WIDTH_M = 4.6, 1.9
CHECK_S = 0.5  # interval at which boxes are compared
VTYPE = "driving_test_car"
OVERLAP_M = 0.05  # boxes that overlap by less only touch
DEPARTURES_PER_STEP = 5
LANES_PER_STEP = 4  # lanes that a fast car may pass in one step
VARIABLES = (libsumo.VAR_POSITION, libsumo.VAR_ANGLE, libsumo.VAR_SPEED, libsumo.VAR_LANE_ID)
OPTIONS = {
    "--no-step-log": "true",
    "--no-warnings": "true",
    "--xml-validation": "never",
    "--collision.action": "warn",
    "--collision.check-junctions": "true",
    "--collision.mingap-factor": "0",
    "--max-depart-delay": "60",
}


def driving_test(
    net: Path,
    *,
    vehicles: int = 300,
    at_once: bool = False,
    duration_s: float = 3600.0,
    step_s: float = 0.5,
    seed: int = 1,
) -> dict[str, Any]:
    """Return the events that happened to cars on random trips over *net*.

    Cars drive from a random edge of 20 m and more to another that can be reached from it. Teleports (after 300 s of
    waiting), emergency braking and collisions are SUMO's own counts. In addition, the boxes of all cars are compared
    with each other twice a second. SUMO changes lanes in one step: a car that does so with its rear still in the
    junction behind occupies two lanes for some metres. Collisions of such cars are also counted separately.

    Args:
        net: the SUMO net.
        vehicles: how many depart, evenly over the duration; with *at_once*, how many drive at any time.
        at_once: replace each car that arrives. Too many cars jam a small part of a town, however good the net is:
            see ``vehicles_per_km``.
        duration_s: simulated time.
        step_s: SUMO's step.
        seed: of trips and drivers.

    Raises:
        NetError: the net has no trip of sufficient length.
        SimulationError: SUMO stopped.
    """
    trips = RandomTrips(net, seed)
    command = ["sumo", "-n", str(net), "--step-length", str(step_s), "--seed", str(seed)]
    command += [text for option in OPTIONS.items() for text in option]
    with tempfile.TemporaryDirectory() as folder:
        statistics = Path(folder) / "statistics.xml"
        libsumo.start([*command, "--statistic-output", str(statistics)])
        try:
            tally = _Tally(beyond=trips.beyond)
            _drive(tally, trips, vehicles, duration_s, step_s, at_once=at_once)
        except libsumo.TraCIException as error:
            raise SimulationError(f"{net}: SUMO stopped the driving test ({error})") from None
        finally:
            libsumo.close()
        return {
            "vehicles": vehicles,
            "meaning": "at once" if at_once else "in all",
            **_summary(tally, _emergency_brakings(statistics), duration_s, step_s),
            "lane_km": round(trips.lane_km, 2),
            "vehicles_per_km": round(tally.vehicle_steps * step_s / duration_s / trips.lane_km, 2),
        }


@dataclass
class _Tally:
    """Counts of what happened so far; contacts are pairs of names, each counted once.

    Attributes:
        across: contacts of a car that had just changed lane.
        changed_m: car → metres driven since its lane change, up to its length.
        beyond: edges beyond the rim of the map, where boxes are not compared.
        next_lanes: lane → lanes that follow it, those inside junctions included.
        places: lane → contacts on it.
        stuck: lane → teleports from it.
    """

    teleports: int = 0
    arrived: int = 0
    metres: float = 0.0
    vehicle_steps: int = 0
    most_at_once: int = 0
    sumo_collisions: set[tuple[str, str]] = field(default_factory=set)
    box_contacts: set[tuple[str, str]] = field(default_factory=set)
    across: set[tuple[str, str]] = field(default_factory=set)
    changed_m: dict[str, float] = field(default_factory=dict)
    next_lanes: dict[str, tuple[str, ...]] = field(default_factory=dict)
    places: Counter[str] = field(default_factory=Counter)
    stuck: Counter[str] = field(default_factory=Counter)
    last_lane: dict[str, str] = field(default_factory=dict)
    beyond: set[str] = field(default_factory=set)


def _drive(
    tally: _Tally, trips: RandomTrips, vehicles: int, duration_s: float, step_s: float, *, at_once: bool
) -> None:
    """Simulate the whole test and fill *tally*."""
    libsumo.vehicletype.copy("DEFAULT_VEHTYPE", VTYPE)
    libsumo.vehicletype.setLength(VTYPE, LENGTH_M)
    libsumo.vehicletype.setWidth(VTYPE, WIDTH_M)
    number = 0
    check_every = max(1, round(CHECK_S / step_s))
    for step in range(round(duration_s / step_s)):
        driving = libsumo.vehicle.getIDCount() + len(libsumo.simulation.getPendingVehicles())
        due_departures = int(vehicles * step * step_s / duration_s) + 1
        missing = vehicles - driving if at_once else due_departures - number
        for _ in range(min(missing, DEPARTURES_PER_STEP)):
            _insert_car(f"car{number}", trips.draw())
            number += 1
        libsumo.simulationStep()
        for name in libsumo.simulation.getDepartedIDList():
            libsumo.vehicle.subscribe(name, VARIABLES)
        _count_step(tally, libsumo.vehicle.getAllSubscriptionResults(), step_s, check=step % check_every == 0)


def _on_map(state: dict[str, dict[int, Any]], beyond: set[str]) -> dict[str, dict[int, Any]]:
    """Return the cars of *state* that are not beyond the rim."""
    return {
        name: values
        for name, values in state.items()
        if edge_of_lane(str(values[libsumo.VAR_LANE_ID])) not in beyond
    }


def _insert_car(name: str, edges: list[str]) -> None:
    libsumo.route.add(name, edges)
    libsumo.vehicle.add(name, name, typeID=VTYPE, departLane="best", departSpeed="max")


def _count_step(tally: _Tally, state: dict[str, dict[int, Any]], step_s: float, *, check: bool) -> None:
    """Add the events of one step to *tally*; compare boxes if *check* is set."""
    tally.arrived += libsumo.simulation.getArrivedNumber()
    tally.teleports += libsumo.simulation.getStartingTeleportNumber()
    # cars without a lane are being teleported
    on_road = {name: values for name, values in state.items() if values[libsumo.VAR_LANE_ID]}
    tally.stuck.update(tally.last_lane[name] for name in libsumo.simulation.getStartingTeleportIDList())
    _track_lane_changes(tally, on_road, step_s)
    tally.last_lane.update({name: values[libsumo.VAR_LANE_ID] for name, values in on_road.items()})
    tally.metres += step_s * sum(values[libsumo.VAR_SPEED] for values in on_road.values())
    tally.vehicle_steps += len(state)
    tally.most_at_once = max(tally.most_at_once, len(state))
    for collision in libsumo.simulation.getCollisions():
        tally.sumo_collisions.add(_pair(collision.collider, collision.victim))
    if check:
        new_contacts = _contacts(_on_map(on_road, tally.beyond)) - tally.box_contacts
        tally.places.update(str(state[first][libsumo.VAR_LANE_ID]) for first, _ in new_contacts)
        tally.box_contacts |= new_contacts
        tally.across |= {pair for pair in new_contacts if tally.changed_m.keys() & set(pair)}


def _track_lane_changes(tally: _Tally, on_road: dict[str, dict[int, Any]], step_s: float) -> None:
    """Update the distance driven since a lane change, for cars that changed lane within the last car length.

    A car has changed lane if its lane does not follow its last one.
    """
    for name, values in on_road.items():
        last_lane, lane = tally.last_lane.get(name), values[libsumo.VAR_LANE_ID]
        if last_lane is not None and lane != last_lane and not _leads_to(tally, last_lane, lane):
            tally.changed_m[name] = 0.0
        elif name in tally.changed_m:
            tally.changed_m[name] += step_s * values[libsumo.VAR_SPEED]
            if tally.changed_m[name] > LENGTH_M:
                del tally.changed_m[name]


def _leads_to(tally: _Tally, before: str, lane: str) -> bool:
    """Return whether *lane* follows *before*, at most ``LANES_PER_STEP`` lanes later."""
    reached = {before}
    for _ in range(LANES_PER_STEP):
        reached = {next_lane for reached_lane in reached for next_lane in _next_lanes(tally, reached_lane)}
        if lane in reached:
            return True
    return False


def _next_lanes(tally: _Tally, lane: str) -> tuple[str, ...]:
    """Return the lanes that follow *lane*; for links across a junction, the lane inside it."""
    if lane not in tally.next_lanes:
        links = libsumo.lane.getLinks(lane)
        tally.next_lanes[lane] = tuple(via or to_lane for to_lane, _, _, _, via, *_ in links)
    return tally.next_lanes[lane]


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


def _pair(first: str, second: str) -> tuple[str, str]:
    """Return the two names in alphabetical order."""
    return (first, second) if first < second else (second, first)


def _emergency_brakings(statistics: Path) -> int:
    """Return the number of emergency brakings from the statistics that SUMO writes when it closes."""
    element = ElementTree.fromstring(statistics.read_bytes()).find("safety")
    return 0 if element is None else int(element.get("emergencyBraking", "0"))


def _summary(tally: _Tally, brakings: int, duration_s: float, step_s: float) -> dict[str, Any]:
    """Return the figures of the report."""
    kilometres = tally.metres / 1000.0
    return {
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
        "collisions_boxes_changing_lane": len(tally.across),
        "places_of_teleports": dict(tally.stuck.most_common(10)),
        "places_of_contacts": dict(tally.places.most_common(10)),
    }
