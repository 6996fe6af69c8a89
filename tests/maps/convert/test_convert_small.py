"""Hand-made maps are converted with netconvert and read back."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sumolib
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from small_maps import MapBuilder, crossroads, two_lane_road

from advdiff_sumo.core.errors import NetError
from advdiff_sumo.maps.convert import ConversionResult, convert_map
from advdiff_sumo.maps.convert.fidelity import measure, statistics_of
from advdiff_sumo.maps.convert.poses import compare_poses
from advdiff_sumo.maps.convert.repair import repair
from advdiff_sumo.maps.convert.sources.read_map import read_map
from advdiff_sumo.maps.convert.sources.source_map import Signal
from advdiff_sumo.maps.convert.written_net import read_net


def converted(road: MapBuilder, folder: Path, **options: bool) -> ConversionResult:
    return convert_map(road.write(folder / "small.json"), folder / "small.net.xml", **options)


def check_invariants(result: ConversionResult) -> None:
    """Every lane is drawn, every link is kept, nothing is invented, and centre lines are exact."""
    figures = measure(result).as_dict()
    assert figures["lanes"]["lost"] == []
    assert figures["connections"]["lost"] == []
    assert figures["connections"]["invented"] == []
    for way in ("source_to_net", "net_to_source"):
        assert figures["centre_line_error_m"][way]["max"] <= 0.02


def test_an_error_that_was_not_measured_is_not_zero() -> None:
    assert statistics_of([]) == {"median": None, "p95": None, "max": None}
    assert statistics_of([np.array([np.nan])]) == statistics_of([])
    values = [np.array([1.0, 3.0]), np.array([2.0, np.nan])]
    assert statistics_of(values) == {"median": 2.0, "p95": 2.9, "max": 3.0}


def test_lanes_side_by_side_share_an_edge_right_to_left(tmp_path: Path) -> None:
    result = converted(two_lane_road(), tmp_path)
    net = sumolib.net.readNet(str(result.net))
    assert sorted(edge.getLaneNumber() for edge in net.getEdges()) == [2, 2]
    for edge in net.getEdges():
        assert [lane.getShape()[0][1] for lane in edge.getLanes()] == pytest.approx([100.0, 103.5])
    check_invariants(result)


def test_a_colon_in_the_path_of_the_net(tmp_path: Path) -> None:
    folder = tmp_path / "at 10:30"
    folder.mkdir()
    check_invariants(converted(two_lane_road(), folder))


def test_a_net_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "small.net.xml").mkdir()
    with pytest.raises(
        NetError, match=r"small\.net\.xml: cannot be written \(Is a directory\); choose another"
    ):
        converted(two_lane_road(), tmp_path)


def test_lefthand_counts_lanes_from_the_left(tmp_path: Path) -> None:
    result = converted(two_lane_road(), tmp_path, lefthand=True)
    for edge in sumolib.net.readNet(str(result.net)).getEdges():
        assert [lane.getShape()[0][1] for lane in edge.getLanes()] == pytest.approx([103.5, 100.0])
    check_invariants(result)


def test_longer_lane_is_cut_where_its_neighbour_begins(tmp_path: Path) -> None:
    result = converted(two_lane_road(lead_m=30.0), tmp_path)
    lanes = sorted(edge.getLaneNumber() for edge in sumolib.net.readNet(str(result.net)).getEdges())
    assert lanes == [1, 2, 2]
    assert result.counts["lanes cut"] == 1
    check_invariants(result)


def test_dashed_pairs_are_found_and_grouped(tmp_path: Path) -> None:
    figures = measure(converted(two_lane_road(lead_m=30.0), tmp_path)).as_dict()["lane_changes"]
    assert (figures["dashed_pairs"], figures["share"]) == (2, 1.0)


def test_crossing_ways_share_a_junction_and_one_yields(tmp_path: Path) -> None:
    result = converted(crossroads(), tmp_path)
    net = sumolib.net.readNet(str(result.net), withInternal=True)
    inner = [node for node in net.getNodes() if len(node.getIncoming()) > 1]
    assert len(inner) == 1
    node = inner[0]
    entering = [c for c in node.getConnections() if c.getFrom().getFunction() == ""]
    links = {(c.getFrom().getID(), c.getTo().getID()): node.getLinkIndex(c) for c in entering}
    assert len(links) == 3
    foes = [(a, b) for a in links.values() for b in links.values() if a < b and node.areFoes(a, b)]
    assert foes
    check_invariants(result)


def test_turn_is_slower_than_the_road(tmp_path: Path) -> None:
    result = converted(crossroads(), tmp_path)
    slow = min(connection.speed_mps for connection in result.plan.connections)
    assert slow == pytest.approx(math.sqrt(2.5 * 10.0), rel=0.05)  # a turn of 10 m radius at 2.5 m/s²


def test_missing_link_is_added_by_geometry_and_counted(tmp_path: Path) -> None:
    road = MapBuilder()
    end = road.straight("a", (0.0, 0.0, 0.0), 40.0)
    road.straight("b", (end[0] + 0.3, 0.1, 0.0), 40.0)
    result = converted(road, tmp_path)
    assert result.counts["links added by geometry"] == 1
    assert result.counts["gaps under 0.5 m bridged"] == 1
    assert len(read_net(result.net).connections) == 1


def test_lane_across_the_end_is_not_linked(tmp_path: Path) -> None:
    road = MapBuilder()
    end = road.straight("a", (0.0, 0.0, 0.0), 40.0)
    road.straight("b", (end[0], 0.0, 0.5 * math.pi), 40.0)
    assert converted(road, tmp_path).counts["links added by geometry"] == 0


def test_duplicate_lane_is_merged(tmp_path: Path) -> None:
    road = two_lane_road()
    road.straight("a2", (100.0, 103.5, 0.0), 80.0)
    road.link("a2", "a-c")
    result = converted(road, tmp_path)
    assert result.counts["duplicate lanes merged"] == 1
    check_invariants(result)


def test_signals_of_a_lane_that_is_merged_stop_the_one_that_stays(tmp_path: Path) -> None:
    road = two_lane_road()
    road.straight("a2", (100.0, 103.5, 0.0), 80.0)
    source = read_map(road.write(tmp_path / "m.json"))
    lights = tuple(Signal(f"over {lane}", None, lanes=(lane,)) for lane in ("a2", "b"))
    mended = repair(replace(source, signals=lights))
    assert "a2" not in {lane.token for lane in mended.lanes}
    assert [light.lanes for light in mended.signals] == [("a",), ("b",)]


def test_poses_near_no_lane_are_no_difference(tmp_path: Path) -> None:
    result = converted(two_lane_road(), tmp_path)
    figures = compare_poses(result, np.array([(5000.0, 5000.0, 0.0), (120.0, 103.5, 0.0)]))
    assert (figures["poses"], figures["on_a_lane_of_the_map"]) == (2, 1)
    assert figures["differences_above_0.05_m"] == 0


def test_connector_at_the_rim_ends_in_an_edge(tmp_path: Path) -> None:
    road = MapBuilder()
    end = road.straight("a", (0.0, 0.0, 0.0), 40.0)
    road.straight("out", end, 20.0, connector=True)
    road.link("a", "out")
    result = converted(road, tmp_path)
    assert result.counts["connectors that end at the rim"] == 1
    check_invariants(result)


def test_side_car_holds_areas_and_holes(tmp_path: Path) -> None:
    road = two_lane_road()
    road.area("ped_crossing", [(150.0, 95.0), (153.0, 95.0), (153.0, 108.0), (150.0, 108.0)])
    road.area("carpark_area", [(100.0, 90.0), (120.0, 90.0), (120.0, 97.0), (100.0, 97.0)])
    result = converted(road, tmp_path)
    kinds = {poly.type for poly in sumolib.xml.parse(str(result.sidecar), "poly")}
    assert kinds == {"drivable_area", "ped_crossing", "carpark_area"}


def test_same_map_same_bytes(tmp_path: Path) -> None:
    first = converted(crossroads(), tmp_path).net.read_bytes()
    assert converted(crossroads(), tmp_path).net.read_bytes() == first


def test_two_ways_between_the_same_two_lanes_are_both_kept(tmp_path: Path) -> None:
    road = MapBuilder()
    end = road.straight("a", (40.0, 100.0, 0.0), 60.0)
    road.straight("direct", end, 60.0 * math.sin(0.8), connector=True)
    last = road.lane("round", end, "LRL", [12.0, 24.0, 12.0], 15.0, connector=True)
    assert last == pytest.approx((100.0 + 60.0 * math.sin(0.8), 100.0, 0.0))
    road.straight("b", last, 60.0)
    road.link("a", "direct", "b")
    road.link("a", "round", "b")
    result = converted(road, tmp_path)
    check_invariants(result)
    assert measure(result).figures["connections"]["second_ways_left_out"] == []
    assert result.counts["connectors made edges as a second way between two lanes"] == 1


def test_bus_lane_is_for_buses(tmp_path: Path) -> None:
    road = two_lane_road()
    road.data["lane"][1]["lane_type"] = "BUS"
    net = sumolib.net.readNet(str(converted(road, tmp_path).net))
    lanes = [lane for edge in net.getEdges() for lane in edge.getLanes()]
    assert sum(not lane.allows("passenger") and lane.allows("bus") for lane in lanes) == 1


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    lanes=st.integers(1, 4),
    leads=st.lists(st.floats(0.0, 60.0), min_size=4, max_size=4),
    radius=st.floats(15.0, 400.0),
    lefthand=st.booleans(),
    split=st.booleans(),
)
def test_any_road_keeps_every_invariant(
    tmp_path: Path, lanes: int, leads: list[float], radius: float, lefthand: bool, split: bool
) -> None:
    road = MapBuilder()
    for number in range(lanes):
        y = 3.5 * number
        x = 100.0 + leads[number]
        end = road.straight(f"in{number}", (x, 100.0 + y, 0.0), 200.0 - x)
        road.lane(f"c{number}", end, "LSR", [min(20.0, radius), 5.0, 0.0], radius + 20.0 - y, connector=True)
        last = road.data["arcline_path_3"][f"c{number}"][0]["end_pose"]
        road.straight(f"out{number}", (last[0], last[1], last[2]), 50.0)
        road.link(f"in{number}", f"c{number}", f"out{number}")
    if split:
        road.lane("turn", (200.0, 100.0, 0.0), "RSL", [12.0, 0.0, 0.0], 9.0, connector=True)
        road.link("in0", "turn")
    result = converted(road, tmp_path, lefthand=lefthand)
    check_invariants(result)
    for edge in result.plan.edges:
        ys = [lane.shape_m[0] for lane in edge.lanes]
        along = edge.lanes[0].shape_m[1] - edge.lanes[0].shape_m[0]
        left = np.array([-along[1], along[0]])
        order = [float(left @ point) for point in ys]
        assert order == sorted(order, reverse=lefthand)
