"""Return edges beyond the rim: everything reaches everything, and nobody measures there."""

from __future__ import annotations

import json
from pathlib import Path

import libsumo
import numpy as np
import pytest
import sumolib
from small_maps import crossroads, two_lane_road

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.convert import convert_source
from advdiff_sumo.maps.convert.fidelity import measure
from advdiff_sumo.maps.convert.rim import LENGTH_M, WAY_M
from advdiff_sumo.maps.convert.sources.read_map import read_map
from advdiff_sumo.maps.read_net import BEYOND_TYPE
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


@pytest.mark.data
def test_queenstown_is_connected_in_both_directions(adv_data: Path, tmp_path: Path) -> None:
    path = adv_data / "nuscenes-mini" / "maps" / "expansion" / "singapore-queenstown.json"
    figures = measure(convert_source(read_map(path), tmp_path / "n.net.xml", close_rim=True)).figures
    assert figures["routability"]["largest_part_share_of_length"] == 1.0
    assert figures["routes_no_lane_follows"] == []
    assert all(row["meaning"] != "not explained" for row in figures["netconvert_warnings"])
