"""The cars of the encounters in ``constructed_encounters``, and the form of their expected verdicts."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import shapely

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import Polyline, concatenate
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.maps import RoadMap
from tests.metrics.encounters import Car, braking, driven, straight

NORTH = 0.5 * math.pi
EAST_ROUTE, NORTH_ROUTE, WEST_ROUTE = ("WC", "CE"), ("SC", "CN"), ("EC", "CW")
WALKER = {"size": (0.6, 0.6), "agent_class": AgentClass.PEDESTRIAN}
RING_ROUTE, ENTRY_ROUTE = ("NW", "WS", "SO"), ("IW", "WS", "SO")


@dataclass(frozen=True)
class Expected:
    """The expected verdict.

    Attributes:
        fault: the party at fault.
        own: the target's breaches.
        other: the other's breaches.
        valid: whether it is a valid failure.
        preventable: whether ``CC_human_driver`` avoids it; None if that is too close to assert.
        spare_m: gap of that driver to the other, and the tolerance.
        impact_mps: closing speed at which it still collides, and the tolerance.
        says: part of the sentence.
    """

    fault: str
    own: tuple[str, ...]
    other: tuple[str, ...]
    valid: bool
    preventable: bool | None = None
    spare_m: tuple[float, float] | None = None
    impact_mps: tuple[float, float] | None = None
    says: str = ""


@dataclass(frozen=True)
class Constructed:
    """An encounter in right-hand traffic; its mirror image is the same in left-hand traffic.

    Attributes:
        name: name of the encounter.
        cast: returns the cars on a given map: the target, the other, all others.
        given: its verdict.
        exchanged: the verdict with target and other exchanged; None if it is not checked.
        routes: routes of the target and of the other.
        net: name of the map.
        lights: signal letter of each relevant link.
        made_for: whether *cast* already makes the mirror image on a left-hand map.
    """

    name: str
    cast: Callable[[RoadMap], tuple[Car, ...]]
    given: Expected
    exchanged: Expected | None = None
    routes: tuple[tuple[str, ...], tuple[str, ...]] = (EAST_ROUTE, EAST_ROUTE)
    net: str = "priority"
    lights: Mapping[tuple[str, str], str] = field(default_factory=dict)
    made_for: bool = False


def along(name: str, line: Polyline, through: FloatArray, at_s: float, speed: float, steps: int) -> Car:
    """Return a car that follows *line* at *speed*, with its centre nearest to *through* (2,) at *at_s*."""
    s = float(line.project(through)[0]) + speed * (0.1 * np.arange(steps) - at_s)
    xy, yaw = line.at(s, extrapolate=True)
    return Car(name, xy, yaw, np.full(steps, speed))


def line_over(road: RoadMap, from_edge: str, to_edge: str) -> Polyline:
    """Return the centre line of the lane of *from_edge* that leads to *to_edge*, over the junction, and that lane."""
    links = (x for x in road.links.values() if road.lanes[x.to_lane].edge_id == to_edge)
    link = next(x for x in links if road.lanes[x.from_lane].edge_id == from_edge)
    return concatenate([road.lanes[x].line for x in (link.from_lane, *link.via, link.to_lane)])


def left_turn(road: RoadMap) -> tuple[Car, Car]:
    # at 4 s both centres are where their lines cross
    to_edge = "CS" if road.lanes["WC_1"].line.xy_m[-1, 1] > 0.0 else "CN"
    turning, oncoming = line_over(road, "WC", to_edge), road.lanes["EC_1"].line
    ends = np.array((oncoming.xy_m[0], oncoming.xy_m[-1] - (100.0, 0.0)))
    point = shapely.LineString(turning.xy_m).intersection(shapely.LineString(ends))
    place = np.array((point.x, point.y))
    return along("turning", turning, place, 4.0, 6.0, 61), along(
        "oncoming", Polyline.of(ends), place, 4.0, 10.0, 61
    )


def roundabout(road: RoadMap) -> tuple[Car, Car]:
    # at 4 s both reach the start of the lane after the entry
    onward = road.lanes["WS_0"].line
    ring = concatenate([line_over(road, "NW", "WS"), line_over(road, "WS", "SO")])
    entry = concatenate([line_over(road, "IW", "WS"), line_over(road, "WS", "SO")])
    return tuple(
        along(name, line, onward.xy_m[0], 4.0, 6.0, 51) for name, line in (("ring", ring), ("entry", entry))
    )  # type: ignore[return-value]  # two of them


def cut_in(gap_m: float, steps: int) -> tuple[Car, Car]:
    """The ego at 13 m/s and, *gap_m* ahead in the next lane, a car at 8 m/s that moves over at 2 m/s from 1 s on."""
    t = 0.1 * np.arange(steps)
    cutter = driven(
        "cutter",
        (-146 + gap_m, -1.6),
        0,
        np.full(steps, 8.0),
        left=np.clip(-2.0 * (t - 1.0), -3.2, 0.0),
    )
    return straight("ego", (-150, -4.8), 0, 13, steps), cutter


def red_light(_: RoadMap) -> tuple[Car, Car]:
    return straight("east", (-70, -1.6), 0, 10, 91), straight("north", (1.6, -37.1), NORTH, 5, 91)


def hidden_walker(appears_s: float) -> tuple[Car, ...]:
    t = 0.1 * np.arange(51)
    walker = driven("walker", (-112, -10.95), NORTH, np.full(51, 2.0), **WALKER)
    xy = np.where(t[:, None] < appears_s, np.nan, walker.xy_m)
    hidden = Car("walker", xy, walker.yaw_rad, walker.speed_mps, walker.size_m, walker.agent_class)
    van = straight("van", (-115.5, -8.2), 0, 0, 51, size=(5.0, 2.0))
    return straight("ego", (-150, -4.8), 0, 12, 51), hidden, van


def pushed(_: RoadMap) -> tuple[Car, ...]:
    ego = driven("ego", (-87, -1.6), 0, np.where(np.arange(41) < 15, 0.0, 5.0))
    third = driven("third", (-105.4, -1.6), 0, np.where(np.arange(41) < 16, 10.0, 5.0))
    return ego, straight("ahead", (-80, -1.6), 0, 0), third


def pile_up_ahead(_: RoadMap) -> tuple[Car, ...]:
    # the leader's front is 18 m behind a standing car: it hits it at 1.5 s and stops at once
    lead = driven("lead", (-122, -1.6), 0, np.where(np.arange(61) <= 15, 12.0, 0.0))
    return straight("ego", (-150, -1.6), 0, 12, 61), lead, straight("still", (-99.9, -1.6), 0, 0, 61)


def cut_out(_: RoadMap) -> tuple[Car, ...]:
    # 24 m (2 s) ahead of the ego, the leader begins to move out at 2 m/s when it is 20 m from a standing car
    t = 0.1 * np.arange(61)
    lead = driven("lead", (-122, -4.8), 0, np.full(61, 12.0), left=np.clip(2.0 * (t - 1.0), 0.0, 3.2))
    return straight("ego", (-150, -4.8), 0, 12, 61), straight("still", (-86, -4.8), 0, 0, 61), lead


def stops_ahead(gap_m: float, speed: float, brake: float, steps: int = 81) -> tuple[Car, Car]:
    lead = driven("lead", (-146 + gap_m, -1.6), 0, braking(speed, 0.5, brake, steps))
    return straight("ego", (-150, -1.6), 0, speed, steps), lead
