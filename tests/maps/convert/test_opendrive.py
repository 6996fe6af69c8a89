"""The OpenDRIVE file against the plan, and netconvert as an outside reader."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
import sumolib
from defusedxml import ElementTree
from small_maps import crossroads, two_lane_road

from advdiff_sumo.maps.convert import convert_map
from advdiff_sumo.maps.convert.netread import read_net


def test_reference_lines_start_where_lanes_do(tmp_path: Path) -> None:
    path = crossroads().write(tmp_path / "m.json")
    result = convert_map(path, tmp_path / "m.net.xml", opendrive=True)
    root = ElementTree.fromstring((tmp_path / "m.xodr").read_bytes())
    roads = {road.get("name"): road for road in root.iterfind("road")}
    assert len(roads) == len(result.plan.connections) + sum(len(edge.lanes) for edge in result.plan.edges)
    for edge in result.plan.edges:
        for index, lane in enumerate(edge.lanes):
            road = roads[f"{edge.id}_{index}"]
            first = next(road.iter("geometry"))
            assert (float(first.get("x")), float(first.get("y"))) == pytest.approx(
                tuple(lane.shape_m[0]), abs=1e-5
            )
            total = sum(float(piece.get("length")) for piece in road.iter("geometry"))
            assert total == pytest.approx(float(road.get("length")), abs=1e-4)
            offset, width = road.find("lanes/laneOffset"), next(road.iter("width"))
            assert float(offset.get("a")) == pytest.approx(0.5 * float(width.get("a")))


def test_netconvert_reads_it_back(tmp_path: Path) -> None:
    path = two_lane_road().write(tmp_path / "m.json")
    result = convert_map(path, tmp_path / "m.net.xml", opendrive=True)
    again = tmp_path / "again.net.xml"
    command = [
        sumolib.checkBinary("netconvert"),
        "--opendrive-files",
        str(tmp_path / "m.xodr"),
        "-o",
        str(again),
    ]
    done = subprocess.run(
        [*command, "--offset.disable-normalization", "true"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    net, before = read_net(again), read_net(result.net)
    assert (len(net.lanes), len(net.ways)) == (len(before.lanes), len(before.ways))
    ys = sorted({round(float(line[0, 1]), 1) for line, _ in net.lanes.values()})
    assert ys == [100.0, 103.5]
