"""Choose the vehicle of natural traffic that becomes the target of a seed scene, or say why there is none."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from enum import StrEnum
from itertools import pairwise
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import IntArray
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.situations import SignalChange, Signals, in_situation
from advdiff_sumo.sim.target_route import lane_change_route, remaining_route, turns_round
from advdiff_sumo.sim.world import Frame, World

_NEIGHBOUR_RADIUS_M = 50.0


class Lacking(StrEnum):
    """The requirement at which the last candidates failed; members are in the order of the checks."""

    CAR = "no car was there long enough"
    SPEED = "no car was fast enough"
    NEIGHBOURS = "no car had so many others near it"
    CLASS = "no car was of vClass passenger, as targets are"
    ROUTE = "all routes ahead were shorter"
    SITUATION = "no car was in the situation"


_ADVICE = {
    Lacking.CAR: "raise scene.density_per_km or scene.warmup_s",
    Lacking.SPEED: "lower scene.min_speed_mps",
    Lacking.NEIGHBOURS: "raise scene.density_per_km or scene.warmup_s, or lower scene.min_neighbours",
    Lacking.CLASS: "give cars a vType of vClass passenger",
    Lacking.ROUTE: "lower scene.min_route_m, or give a larger net",
    Lacking.SITUATION: "choose another scene.situation, or raise scene.density_per_km",
}
_ADVICE_ON_DEMAND = {
    Lacking.CAR: "give demand with cars that goes on for longer, or lower scene.warmup_s",
    Lacking.NEIGHBOURS: "give demand of more vehicles, raise scene.warmup_s or lower scene.min_neighbours",
    Lacking.ROUTE: "give demand with longer routes, or lower scene.min_route_m and take a shorter horizon",
    Lacking.SITUATION: "choose another scene.situation, or give other demand",
}


class TargetChoice:
    """Chooses targets in running traffic, and counts why there was none.

    Attributes:
        lacking: requirement → how often the last candidates failed at it.
    """

    def __init__(self, road: RoadMap, scene: SceneOptions, sim: SimOptions) -> None:
        """Look for cars on *road* that meet *scene* and have been present for the history of *sim*."""
        self.road, self.scene, self.sim = road, scene, sim
        self.lacking: Counter[Lacking] = Counter()

    def choose(self, api: Any, world: World, frames: Sequence[Frame], rng: np.random.Generator) -> int | None:
        """Return the row of a random car that meets all requirements, or None if there is none.

        Args:
            api: libsumo, at the last of *frames*.
            world: names and lanes of the rows.
            frames: states so far, one a step.
            rng: draws among the cars.
        """
        usable, lacking = self._usable(api, world, frames)
        if self.scene.situation == "lane-change":
            usable = self._rerouted(api, world, frames[-1], rng.permutation(usable).tolist(), rng)
        if usable:
            return int(rng.choice(usable))
        self.lacking[lacking] += 1
        return None

    def _rerouted(
        self, api: Any, world: World, frame: Frame, rows: Sequence[int], rng: np.random.Generator
    ) -> list[int]:
        """Give the first of *rows* that can have one a route that needs a lane change; return that row, or none."""
        for row in rows:
            name = world.ids[row]
            route = remaining_route(api, name, self.road.beyond_rim)
            changed = lane_change_route(self.road, world, frame, row, route, self.scene.min_route_m, rng)
            if changed is not None:
                if changed != route:
                    api.vehicle.setRoute(name, changed)
                return [row]
        return []

    @property
    def wanted(self) -> str:
        """The requirements of a target, as the middle of a sentence."""
        scene = self.scene
        situation = "" if scene.situation == "any" else f" is '{scene.situation}'"
        near = f"with {scene.min_neighbours} others near it"
        return f"{near} and a route of {scene.min_route_m:g} m ahead{situation}"

    def advice(self, own_demand: bool) -> str:
        """Return the requirement that failed most often, and a remedy, as the end of a sentence.

        Args:
            own_demand: whether the user gave the demand, the density of which is then no option.
        """
        (lacking, count), *_ = self.lacking.most_common(1)
        advice = (_ADVICE | _ADVICE_ON_DEMAND if own_demand else _ADVICE)[lacking]
        return f"{lacking} (at {count} of {self.lacking.total()} looks): {advice}"

    def _usable(self, api: Any, world: World, frames: Sequence[Frame]) -> tuple[list[int], Lacking]:
        """Return the rows of cars that meet all requirements, and which requirement failed last if there is none."""
        frame = frames[-1]
        cars = _cars(world, frames, self.sim)
        fast_cars = cars[frame.speed_mps[cars] >= self.scene.min_speed_mps]
        vehicles = frame.present & (world.classes[: len(frame.present)] != AgentClass.PEDESTRIAN)
        distances = np.linalg.norm(frame.xy_m[fast_cars, None] - frame.xy_m[None, vehicles], axis=-1)
        with_neighbours = fast_cars[
            (distances < _NEIGHBOUR_RADIUS_M).sum(-1) - 1 >= self.scene.min_neighbours
        ]
        passenger_cars = [
            row
            for row in with_neighbours.tolist()
            if api.vehicle.getVehicleClass(world.ids[row]) == "passenger"
        ]
        with_route = [row for row in passenger_cars if self._has_route(api, world, row)]
        signals = _signals(api, with_changes=self.scene.situation == "yellow")
        usable = [row for row in with_route if self._is_in_situation(api, world, frame, row, signals)]
        stages = zip(
            Lacking, (cars, fast_cars, with_neighbours, passenger_cars, with_route, usable), strict=True
        )
        return usable, next((lacking for lacking, rows in stages if not len(rows)), Lacking.SITUATION)

    def _is_in_situation(self, api: Any, world: World, frame: Frame, row: int, signals: Signals) -> bool:
        """Return whether *row* is in the situation wanted."""
        route = remaining_route(api, world.ids[row], self.road.beyond_rim)
        return in_situation(self.scene.situation, self.road, world, frame, row, route, signals)

    def _has_route(self, api: Any, world: World, row: int) -> bool:
        """Return whether *row* is a car off junctions, without stops, on a long enough route without U-turns."""
        road, lane = self.road, world.lane[row]
        if lane not in road.lanes or road.lanes[lane].is_internal:
            return False
        name = world.ids[row]
        if api.vehicle.getStops(name):
            return False
        route = remaining_route(api, name, road.beyond_rim)
        length_m = sum(road.edges[edge].length_m for edge in route)
        is_long_enough = length_m - float(api.vehicle.getLanePosition(name)) >= self.scene.min_route_m
        return is_long_enough and not any(turns_round(road, a, b) for a, b in pairwise(route))


def _signals(api: Any, with_changes: bool) -> Signals:
    """Return the traffic lights of libsumo *api* now; those without phases, as of railways, do not change.

    Args:
        api: libsumo.
        with_changes: whether their next changes are read, too.
    """
    lights, now_s = api.trafficlight, float(api.simulation.getTime())
    names = lights.getIDList()
    changing = names if with_changes else ()
    return Signals(
        states={name: lights.getRedYellowGreenState(name) for name in names},
        changes={
            name: change for name in changing if (change := _next_change(lights, name, now_s)) is not None
        },
    )


def _next_change(lights: Any, name: str, now_s: float) -> SignalChange | None:
    """Return the change to the next phase in the program of traffic light *name*; None without phases."""
    program, present = lights.getProgram(name), lights.getPhase(name)
    logics = (logic for logic in lights.getAllProgramLogics(name) if logic.programID == program)
    phases = next((logic.phases for logic in logics), ())
    if present >= len(phases):
        return None
    following = phases[present].next
    phase = phases[following[0] if following else (present + 1) % len(phases)]
    return SignalChange(phase.state, float(lights.getNextSwitch(name)) - now_s, float(phase.duration))


def _cars(world: World, frames: Sequence[Frame], sim: SimOptions) -> IntArray:
    """Return the rows of cars that are present now and were at the beginning of a history."""
    frame, first = frames[-1], len(frames) - 1 - sim.substeps * (sim.history_steps - 1)
    is_car = frame.present & (world.classes[: len(frame.present)] == AgentClass.CAR)
    was_present = frames[first].present if first >= 0 else is_car[:0]
    is_car[len(was_present) :] = False
    is_car[: len(was_present)] &= was_present
    return np.flatnonzero(is_car)
