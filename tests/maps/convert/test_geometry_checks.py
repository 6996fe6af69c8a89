"""Centre lines, polygons and links that contradict each other are left out or corrected, with a sentence each."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import sumolib
from small_maps import MapBuilder, two_lane_road

from advdiff_sumo.core.errors import MapError
from advdiff_sumo.maps.convert import ConversionResult, convert_map
from advdiff_sumo.maps.convert.fidelity import measure
from advdiff_sumo.maps.convert.sources.nuscenes_map import read_nuscenes_map


def convert(road: MapBuilder, folder: Path) -> ConversionResult:
    return convert_map(road.write(folder / "m.json"), folder / "m.net.xml")


def left_out(result: ConversionResult) -> tuple[int, int, list[str]]:
    """Return lanes given, held and left out."""
    lanes = measure(result).figures["lanes"]
    return lanes["given"], lanes["held"], lanes["left_out"]


def test_an_arc_longer_than_the_map_is_refused_unsampled(tmp_path: Path) -> None:
    road = two_lane_road()
    road.data["arcline_path_3"]["d"][0].update(shape="LSL", segment_length=[1e7, 0.0, 0.0], radius=1e7)
    result = convert(road, tmp_path)
    assert left_out(result) == (6, 5, ["d"])
    assert any("'d' is left out: the path is 10000000 m long" in words for words in result.source.warnings)


def test_turning_round_a_million_times_is_refused(tmp_path: Path) -> None:
    road = two_lane_road()
    road.data["arcline_path_3"]["d"][0].update(shape="LSL", segment_length=[60.0, 0.0, 0.0], radius=1e-5)
    assert left_out(convert(road, tmp_path)) == (6, 5, ["d"])


def test_infinite_radius(tmp_path: Path) -> None:
    road = two_lane_road()
    road.data["arcline_path_3"]["d"][0].update(shape="LSL", segment_length=[60.0, 0.0, 0.0], radius=math.inf)
    result = convert(road, tmp_path)
    assert left_out(result) == (6, 5, ["d"])
    assert any("the radius of an arc-line piece is not finite" in words for words in result.source.warnings)


@pytest.mark.parametrize(("version", "words"), [("1.10", ""), ("2", ""), ("1.2", "older"), ("new", "number")])
def test_versions_are_numbers(tmp_path: Path, version: str, words: str) -> None:
    road = two_lane_road()
    road.data["version"] = version
    path = road.write(tmp_path / "m.json")
    if not words:
        assert len(read_nuscenes_map(path).lanes) == 6
        return
    with pytest.raises(MapError, match=words):
        read_nuscenes_map(path)


def test_missing_version(tmp_path: Path) -> None:
    road = two_lane_road()
    del road.data["version"]
    with pytest.raises(MapError, match="states no version"):
        read_nuscenes_map(road.write(tmp_path / "m.json"))


def test_byte_order_mark_is_read_over(tmp_path: Path) -> None:
    path = two_lane_road().write(tmp_path / "m.json")
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert len(read_nuscenes_map(path).lanes) == 6


def test_piece_elsewhere_on_the_map(tmp_path: Path) -> None:
    road = two_lane_road()
    road.straight("far", (400.0, 400.0, 0.0), 20.0)
    road.data["arcline_path_3"]["d"] += road.data["arcline_path_3"]["far"]
    result = convert(road, tmp_path)
    assert left_out(result) == (7, 6, ["d"])
    assert any("a piece begins" in words for words in result.source.warnings)


def test_start_heading_turned_by_half_a_turn_is_put_right(tmp_path: Path) -> None:
    road = two_lane_road()
    road.data["arcline_path_3"]["d"][0]["start_pose"][2] += math.pi
    result = convert(road, tmp_path)
    assert left_out(result) == (6, 6, [])
    assert result.counts["start headings turned by half a turn, put right"] == 1
    (line,) = [lane.centre_m for lane in result.source.lanes if lane.token == "d"]  # noqa: S105 - a lane
    assert line[-1].tolist() == pytest.approx([250.0, 100.0])


def test_end_pose_that_the_arcs_do_not_reach(tmp_path: Path) -> None:
    road = two_lane_road()
    road.data["arcline_path_3"]["d"][0]["end_pose"] = [250.0, 140.0, 0.0]
    assert left_out(convert(road, tmp_path)) == (6, 5, ["d"])


def test_circle(tmp_path: Path) -> None:
    road = two_lane_road()
    road.lane("round", (300.0, 100.0, 0.0), "LLL", [2.0 * math.pi * 10.0, 0.0, 0.0], 10.0)
    result = convert(road, tmp_path)
    assert left_out(result) == (7, 6, ["round"])
    assert "m.json: lane 'round' runs in a circle and is left out" in result.source.warnings


@pytest.mark.parametrize(
    ("link", "words"),
    [
        (("d", "d"), "linked to itself"),
        (("d", "a"), "from the beginning of"),
        (("b", "back"), "against the direction"),
    ],
)
def test_links_that_cannot_be(tmp_path: Path, link: tuple[str, str], words: str) -> None:
    road = two_lane_road()
    road.straight("back", (181.0, 99.0, math.pi), 40.0)
    road.link(*link)
    result = convert(road, tmp_path)
    assert [words in sentence for sentence in result.source.warnings].count(True) == 1
    figures = measure(result).figures["connections"]
    assert (figures["given"], figures["kept"], figures["lost"]) == (5, 4, [])


def test_polygon_elsewhere_is_not_used_where_neighbours_confirm_the_path(tmp_path: Path) -> None:
    road = two_lane_road()
    far = road.polygon([(300.0, 300.0), (340.0, 300.0), (340.0, 304.0)])
    next(row for row in road.data["lane"] if row["token"] == "d")["polygon_token"] = far  # noqa: S105 - a lane
    road.straight("alone", (20.0, 300.0, 0.0), 30.0)
    road.data["lane"][-1]["polygon_token"] = far
    result = convert(road, tmp_path)
    assert left_out(result) == (7, 6, ["alone"])
    assert result.source.notes["polygons away from their lane"] == 1
    assert result.source.notes["paths away from their polygon"] == 1


def test_lengths_of_ways_beside_each_other_are_their_own(tmp_path: Path) -> None:
    road = MapBuilder()  # two lanes round a left bend, of radius 10 m and 13.5 m
    for name, radius in (("in", 10.0), ("out", 13.5)):
        y = 110.0 - radius
        end = road.straight(f"{name}1", (40.0, y, 0.0), 60.0)
        end = road.lane(f"{name}2", end, "LSL", [0.5 * math.pi * radius, 0.0, 0.0], radius, connector=True)
        road.straight(f"{name}3", end, 60.0)
        road.link(f"{name}1", f"{name}2", f"{name}3")
    road.dashed([(40.0, 98.25), (100.0, 98.25)])
    road.dashed([(111.75, 110.0), (111.75, 170.0)])
    net = sumolib.net.readNet(str(convert(road, tmp_path).net), withInternal=True)
    inner = [lane for edge in net.getEdges() if edge.getFunction() == "internal" for lane in edge.getLanes()]
    assert sorted(lane.getLength() for lane in inner) == pytest.approx(
        [0.5 * math.pi * 10.0, 0.5 * math.pi * 13.5], abs=0.02
    )
