"""Return edges beyond the rim: every edge can reach every other, and nothing is measured on return edges."""

from __future__ import annotations

import json
import math
from pathlib import Path

import libsumo
import numpy as np
import pytest
import sumolib
from signal_checks import check_signals
from small_maps import MapBuilder, crossroads, two_lane_road

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.convert import convert_source
from advdiff_sumo.maps.convert.fidelity import measure
from advdiff_sumo.maps.convert.rim import CONNECTION_M, LENGTH_M
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
    assert closed["connections"] == plain["connections"]  # only the map is measured
    assert closed["lanes"] == plain["lanes"]
    assert closed["centre_line_error_m"] == plain["centre_line_error_m"]


def test_the_road_map_ends_where_the_map_ends(tmp_path: Path) -> None:
    source = read_map(two_lane_road().write(tmp_path / "m.json"))
    convert_source(source, tmp_path / "n.net.xml", close_rim=True)
    convert_source(source, tmp_path / "plain.net.xml")
    closed, plain = RoadMap.read(tmp_path / "n.net.xml"), RoadMap.read(tmp_path / "plain.net.xml")
    assert set(closed.lanes) == set(plain.lanes)
    assert closed.bounds == plain.bounds
    assert closed.edge_graph().successors == plain.edge_graph().successors


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
    assert metres == pytest.approx(2.0 * 150.0 + LENGTH_M + 2.0 * CONNECTION_M, abs=25.0)
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
    """A lane that begins in the middle of another one and leads north out of the map gets no return edge.

    Another lane begins 10.2 m beside the nearest one, so that a car and its gap (7.5 m) are 2.7 m away from that lane
    (2.2 m are needed). It gets a return edge.
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


def solid(road: MapBuilder, token: str, side: str, x: float, y: float) -> None:
    """Draw a solid line of 50 m northwards from (*x*, *y*) on a *side* of a lane."""
    (row,) = [row for row in road.data["lane"] if row["token"] == token]
    row[f"{side}_lane_divider_segments"] = [
        {"node_token": road.node(x, place), "segment_type": "SINGLE_SOLID_WHITE"} for place in (y, y + 50.0)
    ]


def clipped_at_a_light(open_lane: str) -> MapBuilder:
    """Return crossroads with a light, where one of two lanes of a direction has no connectors.

    Lane *open_lane* "ends" beside "south" or "begins" beside "north". It is an edge of its own, as vehicles from or to
    the "side" can only use this lane.
    """
    road = crossroads()
    nodes = [road.node(90.0, y) for y in (98.0, 102.0)]
    road.data["line"].append({"token": "line", "node_tokens": nodes})
    road.data["traffic_light"].append({"token": "light", "line_token": "line"})
    north = 0.5 * math.pi
    y, beside = (40.0, "south") if open_lane == "ends" else (110.0, "north")
    road.straight(open_lane, (103.5, y, north), 50.0)
    solid(road, beside, "right", 101.75, y)
    solid(road, open_lane, "left", 101.75, y)
    if open_lane == "ends":
        end = road.straight("before", (100.0, -30.0, north), 60.0)
        road.straight("on", end, 10.0, connector=True)
        end = road.straight("side", (173.5, 30.0, math.pi), 60.0)
        road.lane("turn", end, "LSR", [0.0, 0.0, 5.0 * math.pi], 10.0, connector=True)
        road.link("before", "on", beside)
        road.link("side", "turn", open_lane)
    else:
        road.straight("on", (100.0, 160.0, north), 10.0, connector=True)
        road.straight("after", (100.0, 170.0, north), 60.0)
        road.lane("turn", (103.5, 160.0, north), "LSR", [0.0, 0.0, 5.0 * math.pi], 10.0, connector=True)
        road.straight("side", (113.5, 170.0, 0.0), 60.0)
        road.link(beside, "on", "after")
        road.link(open_lane, "turn", "side")
    return road


@pytest.mark.parametrize("open_lane", ["ends", "begins"])
def test_lanes_that_end_or_begin_at_a_light_inside_the_map_stay_open(open_lane: str, tmp_path: Path) -> None:
    """All other ends are joined, and every link of the signal gets green."""
    source = read_map(clipped_at_a_light(open_lane).write(tmp_path / "m.json"))
    result = convert_source(source, tmp_path / "n.net.xml", close_rim=True)
    assert check_signals(result.net) == 1
    part = measure(result).figures["routability"]
    still_open = part["dead_ends" if open_lane == "ends" else "sources"]
    net = sumolib.net.readNet(str(result.net))
    assert [net.getEdge(name).getLane(0).getParam("source").split(":")[0] for name in still_open] == [
        open_lane
    ]
    assert part["dead_ends" if open_lane == "begins" else "sources"] == []
    left_open = result.counts["beginnings on other lanes, without return edge"]
    assert left_open == (open_lane == "begins")


PLACES = [
    ("singapore-onenorth", (1,)),
    pytest.param("singapore-onenorth", (2, 3), marks=pytest.mark.nightly),
    pytest.param("singapore-queenstown", (1,), marks=pytest.mark.nightly),
    pytest.param("singapore-hollandvillage", (1,), marks=pytest.mark.nightly),
    pytest.param("boston-seaport", (1,), marks=pytest.mark.nightly),
]
"""Maps and seeds of the traffic (an hour on the large maps takes long)."""


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize(("place", "seeds"), PLACES)
def test_genuine_maps_are_connected_and_nobody_collides(
    place: str, seeds: tuple[int, ...], adv_data: Path, tmp_path: Path
) -> None:
    """All edges reach each other, except those behind entries on other lanes; an hour of traffic with 300 cars."""
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
    """Return the edges that can be reached other than from *left_open* edges alone."""
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


@pytest.mark.data
def test_a_genuine_map_that_is_clipped_at_a_light(adv_data: Path, tmp_path: Path) -> None:
    """Two lanes of Pittsburgh, one edge, end at a junction whose signal is guessed."""
    name = "log_map_archive_adcf7d18-0510-35b0-a2fa-b4cea13a6d76____PIT_city_57819.json"
    source = read_map(adv_data / "argoverse2" / name)
    result = convert_source(source, tmp_path / "n.net.xml", guess_signals=True, close_rim=True)
    assert check_signals(result.net) == 4
    (end,) = measure(result).figures["routability"]["dead_ends"]
    lanes = sumolib.net.readNet(str(result.net)).getEdge(end).getLanes()
    assert [lane.getParam("source").split(":")[0] for lane in lanes] == ["42819648", "42819649"]
