"""Connections that pass each other at less than a vehicle's width without crossing: SUMO's drivers yield there."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sumolib
from small_maps import MapBuilder

from advdiff_sumo.core import boxes
from advdiff_sumo.maps.convert import ConversionResult, convert_source
from advdiff_sumo.maps.convert.missed_conflicts import shared_span
from advdiff_sumo.maps.convert.sources.read_map import read_map
from advdiff_sumo.sim.driving_test import driving_test
from advdiff_sumo.sim.session import Session, SessionOptions

RADIUS_M = 30.0
TURN = math.acos(1.0 - 1.4 / RADIUS_M)  # in an S-curve of which each half shifts the line by 1.4 m
HALF_M = 2.0 * RADIUS_M * math.sin(TURN)  # half the length of the connection, along the road
CONFLICT = re.compile(r'<conflict from="(\w+)" to="(\w+)" .*startPos="(.+)" endPos="(.+)"')


def narrow_road(folder: Path) -> ConversionResult:
    """Convert a road eastwards at y = 100 and one westwards at y = 104, which comes within 1.2 m at x = 150."""
    road = MapBuilder()
    on, back = 150.0 - HALF_M, 150.0 + HALF_M
    road.straight("on-in", (on - 80.0, 100.0, 0.0), 80.0)
    road.straight("on-way", (on, 100.0, 0.0), 2.0 * HALF_M, connector=True)
    road.straight("on-out", (back, 100.0, 0.0), 80.0)
    road.straight("back-in", (back + 80.0, 104.0, math.pi), 80.0)
    arc = RADIUS_M * TURN
    road.lane("back-way", (back, 104.0, math.pi), "LRL", [arc, 2.0 * arc, arc], RADIUS_M, connector=True)
    road.straight("back-out", (on, 104.0, math.pi), 80.0)
    for name in ("on", "back"):
        road.link(f"{name}-in", f"{name}-way", f"{name}-out")
    return convert_source(read_map(road.write(folder / "m.json")), folder / "n.net.xml")


def test_shared_span_of_lines_that_hardly_come_so_near() -> None:
    """The point is 2.1995 m from a corner: within 2.2 m, but outside the polygon that approximates the circle."""
    corner = np.array([(-10.0, -10.0), (0.0, 0.0), (10.0, -10.0)])
    away = math.radians(90.0 + 0.5 * 90.0 / 16.0)  # halfway between two vertices of that polygon
    nearest = 2.1995 * np.array([math.cos(away), math.sin(away)])
    along = np.array([-math.sin(away), math.cos(away)])
    assert shared_span(np.array([nearest - 5.0 * along, nearest + 5.0 * along]), corner) == pytest.approx(
        (5.0, 5.0)
    )


def test_shared_span_of_lines_two_metres_apart() -> None:
    """The other line runs along the middle third and turns away at right angles."""
    line = np.array([(0.0, 0.0), (30.0, 0.0)])
    other = np.array([(20.0, 9.0), (20.0, 2.0), (10.0, 2.0), (10.0, 9.0)])
    reach = math.sqrt(2.2**2 - 2.0**2)
    assert shared_span(line, other) == pytest.approx((10.0 - reach, 20.0 + reach), abs=0.02)


def test_both_ways_state_where_they_are_shared(tmp_path: Path) -> None:
    """The arc in the middle lies within 2.2 m until it has returned by one metre."""
    result = narrow_road(tmp_path)
    assert result.counts["pairs of ways with stated conflicts"] == 1
    rows = CONFLICT.findall(result.net.read_text("utf-8"))
    assert len(rows) == 2
    reach = RADIUS_M * math.sin(math.acos(1.0 - 1.0 / RADIUS_M))
    for *_, start, end in rows:
        assert 0.5 * (float(start) + float(end)) == pytest.approx(HALF_M, abs=0.6)
        assert float(end) - float(start) == pytest.approx(2.0 * reach, abs=1.0)


@pytest.mark.parametrize("first", ["on", "back"])
@pytest.mark.parametrize("stated", [False, True])
def test_a_car_waits_for_one_that_stands_on_the_other_way(first: str, stated: bool, tmp_path: Path) -> None:
    """If conflicts are not stated, the car drives through the standing one."""
    net = narrow_road(tmp_path).net
    if not stated:
        net.write_text(re.sub(r"<conflict [^>]*/>", "", net.read_text("utf-8")), "utf-8")
    graph = sumolib.net.readNet(str(net))
    routes = {
        "on" if edge.getShape()[0][0] < 150.0 else "back": [
            edge.getID(),
            next(iter(edge.getOutgoing())).getID(),
        ]
        for edge in graph.getEdges()
        if edge.getOutgoing()
    }
    second = "back" if first == "on" else "on"
    apart = []
    with Session(SessionOptions(net=net, seed=1)) as session:
        vehicle = session.api.vehicle
        for name, edges in routes.items():
            session.api.route.add(name, edges)
        vehicle.add(first, first, departSpeed="max")
        for _ in range(600):
            session.step()
            if first in vehicle.getIDList() and abs(vehicle.getPosition(first)[0] - 150.0) < 4.0:
                vehicle.setSpeed(first, 0.0)
                if second not in vehicle.getIDList() and not apart:
                    vehicle.add(second, second, departSpeed="max")
            if {first, second} <= set(vehicle.getIDList()):
                apart.append(_gap_m(vehicle, first, second))
    assert (min(apart) > 0.0) is stated


def _gap_m(vehicle: Any, *names: str) -> float:
    """Return the distance between the boxes of two cars; negative where they overlap."""
    front = np.array([vehicle.getPosition(name) for name in names])
    yaw = np.radians(90.0 - np.array([vehicle.getAngle(name) for name in names]))
    size = np.tile([vehicle.getLength(names[0]), 1.9], (2, 1))
    centre = front - 0.5 * size[:, :1] * np.stack((np.cos(yaw), np.sin(yaw)), axis=-1)
    corners = boxes.corners(centre, yaw, size)
    return float(boxes.separation(corners[:1], corners[1:])[0])


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("seeds", [(1,), pytest.param((2, 3), marks=pytest.mark.nightly)])
def test_boston_without_signals(seeds: tuple[int, ...], adv_data: Path, tmp_path: Path) -> None:
    """Opposite left turns pass 1.24 m apart there."""
    source = read_map(adv_data / "nuscenes-mini/maps/expansion/boston-seaport.json")
    net = convert_source(source, tmp_path / "n.net.xml").net
    for seed in seeds:
        figures = driving_test(net, vehicles=300, seed=seed)
        assert figures["collisions_sumo"] == figures["collisions_boxes"] == figures["teleports"] == 0, seed
        assert figures["arrived"] >= 250, seed
