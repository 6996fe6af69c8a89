"""Crossings in mid-block: edges part for them, nothing is lost, and vehicles and people go in the right order."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import pytest
from defusedxml.ElementTree import parse
from foot_runs import drive
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from small_maps import MapBuilder

from advdiff_sumo.maps.convert import ConversionResult, convert_map
from advdiff_sumo.maps.convert.fidelity import measure
from tests.example_counts import examples

ACROSS = [(48.0, -6.0), (51.0, -6.0), (51.0, 6.0), (48.0, 6.0)]  # 3 m wide, 12 m long


def road(*areas: list[tuple[float, float]], gap_m: float = 3.5) -> MapBuilder:
    """Return 100 m of road: lane "east" on y = 0, "fast" on its left, and "west" on the other side of *gap_m*."""
    built = MapBuilder()
    built.straight("east", (0.0, -3.5, 0.0), 100.0)
    built.straight("fast", (0.0, 0.0, 0.0), 100.0)
    built.dashed([(0.0, -1.75), (100.0, -1.75)])
    built.straight("west", (100.0, gap_m, np.pi), 100.0)
    for area in areas:
        built.area("ped_crossing", area)
    return built


def convert(built: MapBuilder, folder: Path, crossings: str = "map") -> ConversionResult:
    return convert_map(built.write(folder / "m.json"), folder / "m.net.xml", crossings=crossings)  # type: ignore[arg-type] - one of its names


def sources(net: Path) -> dict[str, str]:
    """Return the lanes of edges, by what they come from."""
    edges = [edge for edge in parse(net).getroot().iter("edge") if not edge.get("function")]
    lanes = [lane for edge in edges for lane in edge.iter("lane")]
    return {
        param.get("value", ""): lane.get("id", "")
        for lane in lanes
        for param in lane.iter("param")
        if param.get("key") == "source"
    }


def crossings(net: Path) -> list[Element]:
    return [edge for edge in parse(net).getroot().iter("edge") if edge.get("function") == "crossing"]


def test_edges_part_where_the_crossing_is(tmp_path: Path) -> None:
    """From 0.5 m before the 3 m of paint to 0.5 m behind, the lanes lie in the ways of one junction."""
    result = convert(road(ACROSS), tmp_path)
    assert sources(result.net).keys() == {
        *("east:0.000:47.500", "east:51.500:100.000", "fast:0.000:47.500", "fast:51.500:100.000"),
        *("west:0.000:48.500", "west:52.500:100.000"),
    }
    (crossing,) = crossings(result.net)
    assert len({way for way in result.plan.connection_of if way[0] != way[2]}) == 3
    assert len(crossing.get("crossingEdges", "").split()) == 4
    figures, plain = measure(result).as_dict(), measure(convert(road(), tmp_path)).as_dict()
    assert (figures["crossings"]["given"], figures["crossings"]["kept"]) == (1, 1)
    assert figures["lanes"]["held"] == plain["lanes"]["held"] == 3
    assert figures["lanes"]["lost"] == figures["connections"]["lost"] == []
    assert figures["connections"]["invented"] == []
    assert figures["lane_changes"] == plain["lane_changes"]
    assert all(error["max"] <= 0.001 for error in figures["centre_line_error_m"].values())
    assert figures["routes_no_lane_follows"] == []


def test_an_island_parts_the_crossing(tmp_path: Path) -> None:
    """12 m between the carriageways: two junctions, and a step over the island."""
    area = [(48.0, -6.0), (51.0, -6.0), (51.0, 15.0), (48.0, 15.0)]
    result = convert(road(area, gap_m=12.0), tmp_path)
    assert len(crossings(result.net)) == 2
    assert len({row.get("id", "").rpartition("_")[0] for row in crossings(result.net)}) == 2
    assert measure(result).figures["crossings"]["kept"] == 1


def lead_on(built: MapBuilder) -> MapBuilder:
    """Let lane "east" and its neighbour end in a junction with two ways."""
    for name, y in (("east", -3.5), ("fast", 0.0)):
        end = built.straight(f"{name}-way", (100.0, y, 0.0), 10.0, connector=True)
        built.straight(f"{name}-after", end, 60.0)
        built.link(name, f"{name}-way", f"{name}-after")
    built.straight("west-before", (170.0, 3.5, np.pi), 60.0)
    built.straight("west-way", (110.0, 3.5, np.pi), 10.0, connector=True)
    built.link("west-before", "west-way", "west")
    return built


def test_near_a_junction_the_edges_end_before_the_crossing(tmp_path: Path) -> None:
    """From 95.5 to 99 m: a car has no room behind it, so its ways are those of the junction, which become longer."""
    area = [(x + 47.5, y) for x, y in ACROSS]
    result = convert(lead_on(road(area)), tmp_path)
    names = sources(result.net).keys()
    assert {"east:0.000:95.000", "fast:0.000:95.000", "west:5.000:100.000"} <= names
    figures = measure(result).as_dict()
    assert figures["crossings"]["kept"] == 1
    assert figures["lanes"]["lost"] == figures["connections"]["lost"] == []
    assert figures["mended_and_cut"]["edges shortened before crossings on foot"] == 2


@pytest.mark.parametrize("x", [2.0, 45.0])
def test_no_edge_is_cut_in_vain(x: float, tmp_path: Path) -> None:
    """At the rim of the map, and where a crossing runs along the lanes, nothing changes."""
    along = [(x, -5.0), (x + 40.0, -5.0), (x + 40.0, -2.0), (x, -2.0)]
    rim = [(1.0, -6.0), (4.0, -6.0), (4.0, 6.0), (1.0, 6.0)]
    result = convert(road(rim if x < 10.0 else along), tmp_path)
    assert sources(result.net) == sources(convert(road(), tmp_path).net)
    assert not crossings(result.net)


def test_vehicles_wait_for_people(tmp_path: Path) -> None:
    """Somebody sets out northwards every 1.5 s; the crossing lies from x = 48 to 51 before the car."""
    result = convert(road(ACROSS), tmp_path)
    alone = drive(result.net, ["east"], None, 20.0)
    assert min(step["speed"] for step in alone if "front_m" in step) > 6.0
    met = 0
    for begin in np.arange(0.0, 9.0, 1.5):
        steps = drive(result.net, ["east"], float(begin), 60.0)
        before = [
            s for s in steps if "_c0" in s.get("where", "") and -5.3 < s["y"] < -1.7
        ]  # in the car's lane
        assert before
        assert not [s for s in before if "front_m" in s and 48.0 < s["front_m"] < 56.0]
        met += any("front_m" in s and s["front_m"] < 48.5 and s["speed"] < 0.5 for s in before)
        assert all("front_m" not in s for s in steps[-10:])  # it drove on
    assert met


def with_stop_line(built: MapBuilder, kind: str) -> MapBuilder:
    """Add a stop line across the lanes eastwards, 3 m before the crossing, with a light where *kind* says so."""
    line = built.polygon([(44.5, -5.0), (45.0, -5.0), (45.0, 1.5), (44.5, 1.5)])
    row = {"token": "stop0", "polygon_token": line, "stop_line_type": kind}
    lights = ["light"] if kind == "TRAFFIC_LIGHT" else []
    built.data["stop_line"].append({**row, "traffic_light_tokens": lights})
    built.data["traffic_light"] += [{"token": light, "line_token": ""} for light in lights]
    return built


def test_the_stop_line_of_the_crossing_is_where_vehicles_stop(tmp_path: Path) -> None:
    """The edge ends at 47.5 m and the line begins at 44.5 m."""
    result = convert(with_stop_line(road(ACROSS), "PED_CROSSING"), tmp_path)
    offsets = {
        lane.get("id"): [float(row.get("value", "")) for row in lane.iter("stopOffset")]
        for lane in parse(result.net).getroot().iter("lane")
    }
    names = sources(result.net)
    assert offsets[names["east:0.000:47.500"]] == [3.0]
    assert offsets[names["east:51.500:100.000"]] == []


@pytest.mark.parametrize(("lefthand", "yellow", "all_red"), [(False, "3", "1.5"), (True, "3.5", "1")])
def test_at_a_light_vehicles_have_passed_when_people_get_green(
    lefthand: bool, yellow: str, all_red: str, tmp_path: Path
) -> None:
    """At 11.18 and 13.89 m/s: yellow of 2.83 and 3.28 s, then 6.5 m and 6.1 m of vehicle from the stop line on."""
    built = with_stop_line(road(ACROSS), "TRAFFIC_LIGHT")
    result = convert_map(built.write(tmp_path / "m.json"), tmp_path / "m.net.xml", lefthand=lefthand)
    (program,) = parse(result.net).getroot().iter("tlLogic")
    phases = [(phase.get("duration"), phase.get("state")) for phase in program]
    assert [state for _, state in phases] == ["GGGr", "yyyr", "rrrr", "rrrG", "rrrr"]
    assert [seconds for seconds, _ in phases[1:4]] == [yellow, all_red, "10"]


def test_at_a_light_people_wait_for_green(tmp_path: Path) -> None:
    result = convert(with_stop_line(road(ACROSS), "TRAFFIC_LIGHT"), tmp_path)
    assert result.plan.idle_signals == ()
    root = parse(result.net).getroot()
    name = crossings(result.net)[0].get("id")
    index = next(int(row.get("linkIndex", "")) for row in root.iter("connection") if row.get("to") == name)
    vehicles = {int(r.get("linkIndex", "")) for r in root.iter("connection") if r.get("tl")} - {index}
    waited = 0
    for begin in np.arange(0.0, 60.0, 10.0):
        steps = drive(result.net, ["east"], float(begin), begin + 120.0)
        on = next(k for k, s in enumerate(steps) if s.get("where") == name)
        assert steps[on]["lights"][index] == "G"
        assert {steps[on]["lights"][link] for link in vehicles} == {"r"}
        waited += any(s.get("pace", 1.0) < 0.1 and s["lights"][index] == "r" for s in steps[:on])
    assert waited


def test_paint_behind_the_end_of_the_road_is_no_crossing(tmp_path: Path) -> None:
    """It touches a lane, yet its middle lies 1 m before the lane begins."""
    area = [(-2.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-2.5, 0.5)]
    assert measure(convert(road(area), tmp_path)).figures["crossings"]["kept"] == 0


@pytest.mark.slow
@settings(
    max_examples=examples(10, 25), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    x=st.floats(-5.0, 175.0),
    angle=st.floats(0.0, 3.1),
    length=st.floats(3.0, 30.0),
    width=st.floats(0.5, 9.0),
    y=st.floats(-6.0, 6.0),
)
def test_whatever_is_painted_nothing_of_the_lanes_is_lost(
    x: float, angle: float, length: float, width: float, y: float, tmp_path: Path
) -> None:
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    box = 0.5 * np.array([[-length, -width], [length, -width], [length, width], [-length, width]])
    result = convert(lead_on(road([(px, py) for px, py in (box @ turn + (x, y)).tolist()])), tmp_path)
    figures = measure(result).as_dict()
    assert figures["lanes"]["lost"] == figures["connections"]["lost"] == []
    assert figures["connections"]["invented"] == []
    assert all(error["max"] <= 0.001 for error in figures["centre_line_error_m"].values())
