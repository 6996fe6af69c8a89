"""Return edges beyond the rim: everything reaches everything, and nobody measures there."""

from __future__ import annotations

import json
import math
from pathlib import Path

import libsumo
import numpy as np
import pytest
import sumolib
from small_maps import MapBuilder, crossroads, two_lane_road

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.convert import convert_source
from advdiff_sumo.maps.convert.fidelity import measure
from advdiff_sumo.maps.convert.rim import LENGTH_M, WAY_M
from advdiff_sumo.maps.convert.sources.read_map import read_map
from advdiff_sumo.maps.read_net import BEYOND_TYPE
from advdiff_sumo.sim.driving_test import driving_test
from tests.e2e.commands import advdiff

MAPS = {"two lanes": two_lane_road, "crossing": crossroads}


@pytest.mark.parametrize("name", MAPS)
def test_all_edges_reach_each_other(name: str, tmp_path: Path) -> None:
    source = read_map(MAPS[name]().write(tmp_path / "m.json"))
    closed = measure(convert_source(source, tmp_path / "n.net.xml", close_rim=True)).figures
    plain = measure(convert_source(source, tmp_path / "plain.net.xml")).figures
    part = closed["routability"]
    assert part["largest_part_edges"] == part["edges"] > plain["routability"]["edges"]
    assert part["dead_ends"] == part["sources"] == []
    assert closed["connections"] == plain["connections"]  # what is measured is the map alone
    assert closed["lanes"] == plain["lanes"]
    assert closed["centre_line_error_m"] == plain["centre_line_error_m"]


def test_the_road_map_ends_where_the_map_ends(tmp_path: Path) -> None:
    source = read_map(two_lane_road().write(tmp_path / "m.json"))
    convert_source(source, tmp_path / "n.net.xml", close_rim=True)
    convert_source(source, tmp_path / "plain.net.xml")
    closed, plain = RoadMap.read(tmp_path / "n.net.xml"), RoadMap.read(tmp_path / "plain.net.xml")
    assert set(closed.lanes) == set(plain.lanes)
    assert closed.bounds == plain.bounds
    assert closed.sink_edges() == plain.sink_edges()


def test_a_car_drives_round_and_is_on_the_map_or_straight_beyond_its_rim(tmp_path: Path) -> None:
    convert_source(
        read_map(two_lane_road().write(tmp_path / "m.json")), tmp_path / "n.net.xml", close_rim=True
    )
    net = sumolib.net.readNet(str(tmp_path / "n.net.xml"))
    (back,) = [edge for edge in net.getEdges() if edge.getType() == BEYOND_TYPE]
    (last,) = [edge.getID() for edge in back.getIncoming()]
    (first,) = [edge.getID() for edge in back.getOutgoing()]
    libsumo.start(["sumo", "-n", str(tmp_path / "n.net.xml"), "--no-step-log", "--step-length", "0.5"])
    try:
        libsumo.route.add("round", [first, last, back.getID(), first, last])
        libsumo.vehicle.add("car", "round", departSpeed="max")
        places, metres = [], 0.0
        while libsumo.simulation.getMinExpectedNumber():
            libsumo.simulationStep()
            if "car" in libsumo.vehicle.getIDList():
                places.append((libsumo.vehicle.getRoadID("car"), *libsumo.vehicle.getPosition("car")))
                metres = libsumo.vehicle.getDistance("car")
    finally:
        libsumo.close()
    assert metres == pytest.approx(2.0 * 150.0 + LENGTH_M + 2.0 * WAY_M, abs=25.0)
    on_map = np.array([place[1:] for place in places if place[0] in (first, last)])
    assert (on_map[:, 0] >= 100.0).all()
    assert (on_map[:, 0] <= 250.0).all()
    aside = np.array([place[1:] for place in places if place[0] == back.getID()])
    assert (aside[:, 0] < -100.0).all()


def test_command(tmp_path: Path) -> None:
    path = two_lane_road().write(tmp_path / "m.json")
    done = advdiff("convert", path, "-o", tmp_path / "n", "--close-rim", cwd=tmp_path)
    assert done.code == 0, done.err
    figures = json.loads((tmp_path / "n.fidelity.json").read_text("utf-8"))
    assert figures["mended_and_cut"]["return edges beyond the rim"] == 1
    assert figures["routability"]["dead_ends"] == []


def test_nobody_comes_in_on_the_lane_of_somebody_else(tmp_path: Path) -> None:
    """A lane begins in the middle of another one and leads out of the map to the north: it stays open.

    Another one begins 10.2 m beside the nearest lane, so that a car and its gap (7.5 m) are 2.7 m away from it (2.2 m
    are needed); it is entered.
    """
    road = two_lane_road()
    for name, x, y in (("inside", 120.0, 101.0), ("beside", 150.0, 113.7)):
        road.straight(name, (x, y, math.pi / 2.0), 40.0)
    result = convert_source(read_map(road.write(tmp_path / "m.json")), tmp_path / "n.net.xml", close_rim=True)
    figures = measure(result).figures
    (inside,) = figures["routability"]["sources"]
    edge = sumolib.net.readNet(str(tmp_path / "n.net.xml")).getEdge(inside)
    assert edge.getShape()[0] == pytest.approx((120.0, 101.0), abs=0.1)
    assert figures["routability"]["dead_ends"] == []
    assert result.counts["beginnings on other lanes, without return edge"] == 1


def test_a_map_that_can_be_entered_nowhere_gets_no_return_edge(tmp_path: Path) -> None:
    road = MapBuilder()
    road.straight("east", (0.0, 0.0, 0.0), 60.0)
    road.straight("west", (60.0, 0.5, math.pi), 60.0)
    result = convert_source(read_map(road.write(tmp_path / "m.json")), tmp_path / "n.net.xml", close_rim=True)
    assert result.counts["beginnings on other lanes, without return edge"] == 2
    assert result.counts["return edges beyond the rim"] == 0


PLACES = [
    ("singapore-onenorth", (1, 2, 3)),
    ("singapore-queenstown", (1,)),
    ("singapore-hollandvillage", (1,)),
    ("boston-seaport", (1,)),
]
"""Maps, and seeds of the traffic: an hour on the large ones takes long."""


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize(("place", "seeds"), PLACES, ids=[place for place, _ in PLACES])
def test_genuine_maps_are_connected_and_nobody_collides(
    place: str, seeds: tuple[int, ...], adv_data: Path, tmp_path: Path
) -> None:
    """All reaches all, but for what only beginnings on other lanes lead to; an hour of 300 cars."""
    source = read_map(adv_data / "nuscenes-mini" / "maps" / "expansion" / f"{place}.json")
    result = convert_source(source, tmp_path / "n.net.xml", guess_signals=True, close_rim=True)
    figures = measure(result).figures
    part = figures["routability"]
    assert part["largest_part_share_of_length"] > 0.98
    assert part["dead_ends"] == []
    assert len(part["sources"]) == result.counts["beginnings on other lanes, without return edge"]
    assert part["strongly_connected_parts"] == [_entered(result.net, part["sources"])]
    assert figures["routes_no_lane_follows"] == []
    assert all(row["meaning"] != "not explained" for row in figures["netconvert_warnings"])
    for seed in seeds:
        driven = driving_test(result.net, vehicles=300, seed=seed)
        assert driven["teleports"] == driven["collisions_sumo"] == 0
        assert (
            driven["collisions_boxes"] == driven["collisions_boxes_changing_lane"]
        )  # in one step, see the page
        assert driven["arrived"] >= 250


def _entered(net_file: Path, left_open: list[str]) -> list[str]:
    """Return the edges to which others lead than *left_open* and what only these lead to."""
    net = sumolib.net.readNet(str(net_file))
    cars = {
        edge.getID() for edge in net.getEdges() if edge.allows("passenger") or edge.getType() == BEYOND_TYPE
    }
    before = {name: {edge.getID() for edge in net.getEdge(name).getIncoming()} for name in sorted(cars)}
    entered, last = set(before), set(left_open)
    while last:
        entered -= last
        last = {name for name in entered if not before[name] & entered}
    return sorted(entered)
