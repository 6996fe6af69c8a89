"""OpenDRIVE files agree with the plan: evaluated independently, by netconvert, and by ASAM's checker."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
import shapely
import sumolib
from defusedxml import ElementTree
from opendrive_eval import EvaluatedRoad, evaluate
from small_maps import MapBuilder, crossroads, two_lane_road

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert import ConversionResult, convert_map, polyline
from advdiff_sumo.maps.convert.reference_line import end_yaw, smooth, start_yaw
from advdiff_sumo.maps.convert.sources.arcline import drop_repeats

TOLERANCE_M = 0.1


def both(path: Path, folder: Path) -> tuple[ConversionResult, Path]:
    """Convert the map at *path* and return the result and the OpenDRIVE file."""
    result = convert_map(path, folder / "m.net.xml", opendrive=True)
    return result, folder / "m.xodr"


def distance(a: FloatArray, b: FloatArray) -> float:
    """Return the largest distance between two lines, in both directions, ends included."""
    one, other = (drop_repeats(line, 1e-6) for line in (a, b))
    there = polyline.project(one, polyline.resample(other, 0.5)[0])[1]
    back = polyline.project(other, polyline.resample(one, 0.5)[0])[1]
    return float(max(np.abs(there).max(), np.abs(back).max()))


def thinned(line: FloatArray) -> FloatArray:
    """Return *line* with fewer points, within a millimetre."""
    return np.asarray(shapely.LineString(line).simplify(0.001).coords)


def left_border(road: EvaluatedRoad) -> FloatArray:
    """Return the left border without the loops that it makes inside bends tighter than half the width."""
    centre, half = thinned(road.centre_m), np.hypot(*(road.left_m - road.centre_m).T)
    nearest = np.abs(polyline.project(drop_repeats(centre, 1e-6), road.left_m)[1])
    kept = nearest >= half - 0.01
    kept[[0, -1]] = True
    return thinned(road.left_m[kept])


def planned_lines(result: ConversionResult) -> dict[str, FloatArray]:
    """Return the line that each road should follow, by the road's name."""
    lanes = {
        f"{edge.id}_{index}": lane.shape_m
        for edge in result.plan.edges
        for index, lane in enumerate(edge.lanes)
    }
    for way in result.plan.connections:
        origin, target = (f"{edge}_{index}" for edge, index in (way.origin, way.target))
        ends = (lanes[origin][-1:], way.shape_m, lanes[target][:1])
        lanes[f"{origin}->{target}"] = drop_repeats(np.vstack(ends), 1e-6)
    return lanes


def check_file(result: ConversionResult, xodr: Path) -> None:
    """Every lane and connection exists, follows the plan over its whole length, and joins the planned lanes."""
    roads = evaluate(xodr)
    planned = planned_lines(result)
    by_name = {road.name: road for road in roads.values()}
    assert by_name.keys() == planned.keys()
    assert len(roads) == len(planned)
    for name, road in by_name.items():
        assert distance(thinned(road.centre_m), planned[name]) <= 0.03
        assert road.jumps_m <= 1e-4
        assert road.kinks_rad <= 1e-4
    for road in roads.values():
        if "->" in road.name:
            check_joints(roads, road)


def check_joints(roads: dict[str, EvaluatedRoad], way: EvaluatedRoad) -> None:
    """Centre line and borders of a connection continue those of its lanes, and its name names both."""
    before, after = roads[str(way.predecessor)], roads[str(way.successor)]
    assert way.name == f"{before.name}->{after.name}"
    for first, second in ((before, way), (way, after)):
        for side in ("centre_m", "left_m", "right_m"):
            gap = getattr(second, side)[0] - getattr(first, side)[-1]
            assert float(np.hypot(*gap)) <= 0.001


def imported(xodr: Path, folder: Path) -> tuple[dict[str, FloatArray], dict[tuple[str, str], FloatArray]]:
    """Return what netconvert reads from a file: inner borders by road id, connections by road ids."""
    command = [sumolib.checkBinary("netconvert"), "--opendrive-files", str(xodr), "--precision", "4"]
    command += ["--plain-output-prefix", str(folder / "plain"), "--offset.disable-normalization", "true"]
    command += ["--opendrive.internal-shapes", "true", "--opendrive.import-all-lanes", "true"]
    command += ["--no-turnarounds", "true", "-o", str(folder / "again.net.xml")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    nodes = {node.id: [(float(node.x), float(node.y))] for node in _rows(folder, "nod", "node")}
    edges = {}
    for edge in _rows(folder, "edg", "edge"):
        shape = _points(edge.shape) if edge.hasAttribute("shape") and edge.shape else None
        ends = np.array(nodes[edge.attr_from] + nodes[edge.to])
        edges[edge.id.lstrip("-")] = ends if shape is None else shape
    ways = {
        (row.attr_from.lstrip("-"), row.to.lstrip("-")): _points(row.shape)
        for row in _rows(folder, "con", "connection")
        if row.hasAttribute("to") and row.to
    }
    return edges, ways


def _rows(folder: Path, kind: str, tag: str) -> list[object]:
    return list(sumolib.xml.parse(str(folder / f"plain.{kind}.xml"), tag))


def _points(text: str) -> FloatArray:
    return np.array([[float(v) for v in point.split(",")[:2]] for point in text.split()])


def check_import(xodr: Path, folder: Path) -> None:
    """What netconvert reads, before it cuts lanes at its own junctions, is right within a decimetre."""
    roads = evaluate(xodr)
    edges, ways = imported(xodr, folder)
    assert set(edges) == {number for number, road in roads.items() if "->" not in road.name}
    joined = {(str(r.predecessor), str(r.successor)): r for r in roads.values() if "->" in r.name}
    assert set(ways) == set(joined)
    for number, line in edges.items():
        assert distance(line, left_border(roads[number])) <= TOLERANCE_M
    for pair, line in ways.items():
        assert distance(line, thinned(joined[pair].centre_m)) <= TOLERANCE_M


def curved() -> MapBuilder:
    """Return two lanes of different widths in a double bend, with a kink of 0.1 rad at the second joint."""
    road = MapBuilder()
    end = road.lane("a", (0.0, 0.0, 0.3), "LSR", [12.0, 7.0, 9.0], 25.0)
    end = road.lane("a-b", end, "RSL", [6.0, 0.0, 5.0], 7.0, connector=True)
    road.lane("b", (end[0], end[1], end[2] + 0.1), "RSL", [11.0, 3.0, 14.0], 40.0)
    road.link("a", "a-b", "b")
    return road


def tapering() -> MapBuilder:
    """Return a lane that narrows from 5 m to 3 m over 40 m, then widens to 4 m over 20 m, and the lane after it."""
    road = MapBuilder()
    end = road.straight("a", (100.0, 100.0, 0.0), 60.0)
    row = road.data["lane"][0]
    sides = [(100.0, 2.5), (140.0, 1.5), (160.0, 2.0)]
    outline = [(x, 100.0 + half) for x, half in sides] + [(x, 100.0 - half) for x, half in sides[::-1]]
    row["polygon_token"] = road.polygon(outline)
    end = road.straight("a-b", end, 10.0, connector=True)
    road.straight("b", end, 60.0)
    road.link("a", "a-b", "b")
    return road


def width_at(road: EvaluatedRoad, x: float) -> float:
    k = int(np.abs(road.centre_m[:, 0] - x).argmin())
    return float(np.hypot(*(road.left_m[k] - road.right_m[k])))


def test_a_width_that_varies_is_written_as_it_varies(tmp_path: Path) -> None:
    result, xodr = both(tapering().write(tmp_path / "m.json"), tmp_path)
    check_file(result, xodr)
    check_import(xodr, tmp_path)
    by_source = {}
    for road in evaluate(xodr).values():
        if "->" not in road.name:
            edge, index = road.name.rsplit("_", 1)
            (plan,) = [e for e in result.plan.edges if e.id == edge]
            by_source[plan.lanes[int(index)].source.split(":")[0]] = road
    narrowing = by_source["a"]
    for x, width in ((105.0, 4.75), (120.0, 4.0), (130.0, 3.5), (150.0, 3.5), (157.0, 3.85)):
        assert width_at(narrowing, x) == pytest.approx(width, abs=0.05)
    assert width_at(narrowing, 140.0) == pytest.approx(3.0, abs=0.1)  # measured every 4 m
    assert width_at(by_source["b"], 200.0) == pytest.approx(3.5, abs=0.01)


def test_a_flare_is_no_steeper_than_readers_can_draw(tmp_path: Path) -> None:
    road = MapBuilder()
    road.straight("a", (100.0, 100.0, 0.0), 40.0)
    outline = [(100.0, 105.5), (104.0, 101.5), (140.0, 101.5), (140.0, 98.5), (104.0, 98.5), (100.0, 94.5)]
    road.data["lane"][0]["polygon_token"] = road.polygon(outline)
    _, xodr = both(road.write(tmp_path / "m.json"), tmp_path)
    (lane,) = evaluate(xodr).values()
    assert width_at(lane, 120.0) == pytest.approx(3.0, abs=0.01)
    slopes = np.diff(np.hypot(*(lane.left_m - lane.right_m).T)) / 0.25
    assert -0.51 <= slopes.min() <= -0.45
    assert slopes.max() <= 1e-6


MAPS = {"tapering": tapering, "two lanes": two_lane_road, "crossing": crossroads, "double bend": curved}


@pytest.mark.parametrize("name", MAPS)
def test_every_lane_lies_where_planned(name: str, tmp_path: Path) -> None:
    check_file(*both(MAPS[name]().write(tmp_path / "m.json"), tmp_path))


@pytest.mark.parametrize("name", MAPS)
def test_netconvert_reads_it_back(name: str, tmp_path: Path) -> None:
    _, xodr = both(MAPS[name]().write(tmp_path / "m.json"), tmp_path)
    check_import(xodr, tmp_path)


def test_lane_without_way_out_touches_no_junction(tmp_path: Path) -> None:
    _, xodr = both(crossroads().write(tmp_path / "m.json"), tmp_path)
    roads = evaluate(xodr)
    left = {road.predecessor for road in roads.values() if "->" in road.name}
    ends = {number for number, road in roads.items() if "->" not in road.name and road.successor is None}
    assert ends == {number for number, road in roads.items() if "->" not in road.name} - left
    assert len(ends) == 2


def test_left_hand_traffic_is_told_in_the_header(tmp_path: Path) -> None:
    path = crossroads().write(tmp_path / "m.json")
    for left in (True, False):
        convert_map(path, tmp_path / "m.net.xml", lefthand=left, opendrive=True)
        header = ElementTree.fromstring((tmp_path / "m.xodr").read_bytes()).find("header")
        assert [row.get("value") for row in header.iter("userData")] == (["left"] if left else [])


def test_quarter_circle_of_chords_becomes_one_arc() -> None:
    angle = np.linspace(0.0, 0.5 * np.pi, 49)
    line = 10.0 * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=1)
    assert start_yaw(line) == pytest.approx(0.0, abs=1e-9)
    assert end_yaw(line) == pytest.approx(0.5 * np.pi, abs=1e-9)
    stretches = smooth(line, 0.0, 0.5 * np.pi)
    assert sum(stretch.length_m for stretch in stretches) == pytest.approx(5.0 * np.pi, rel=2e-3)
    longest = max(stretches, key=lambda stretch: stretch.length_m)
    assert longest.curvature == pytest.approx(0.1, rel=5e-3)
    assert longest.length_m > 10.0


def test_given_yaws_are_met_and_the_line_stays_in_place() -> None:
    line = np.array([[0.0, 0.0], [20.0, 0.0]])
    stretches = smooth(line, 0.1, -0.05)
    assert stretches[0].yaw_rad == pytest.approx(0.1)
    last = stretches[-1]
    assert last.yaw_rad + last.length_m * last.curvature == pytest.approx(-0.05)
    assert max(abs(stretch.y) for stretch in stretches) <= 0.02


@pytest.mark.data
def test_a_real_map(adv_data: Path, tmp_path: Path) -> None:
    name = adv_data / "nuscenes-mini" / "maps" / "expansion" / "singapore-onenorth.json"
    result, xodr = both(name, tmp_path)
    check_file(result, xodr)
    check_import(xodr, tmp_path)


@pytest.mark.parametrize("name", MAPS)
def test_the_checker_of_asam_finds_nothing(name: str, tmp_path: Path) -> None:
    """Runs qc_opendrive (pip install asam-qc-opendrive, in an environment of its own) where ADVDIFF_QC names it."""
    checker = os.environ.get("ADVDIFF_QC")
    if not checker:
        pytest.skip("ADVDIFF_QC does not name the program qc_opendrive of asam-qc-opendrive")
    _, xodr = both(MAPS[name]().write(tmp_path / "m.json"), tmp_path)
    config = tmp_path / "qc.xml"
    config.write_text(
        f'<Config><Param name="InputFile" value="{xodr}"/><CheckerBundle application="xodrBundle">'
        f'<Param name="resultFile" value="{tmp_path / "out.xqar"}"/></CheckerBundle></Config>',
        encoding="utf-8",
    )
    done = subprocess.run([checker, "-c", str(config)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    report = ElementTree.fromstring((tmp_path / "out.xqar").read_bytes())
    checks = list(report.iter("Checker"))
    assert [issue.get("description") for issue in report.iter("Issue")] == []
    assert sum(check.get("status") == "completed" for check in checks) >= 20
    assert not [check.get("checkerId") for check in checks if check.get("status") == "error"]
