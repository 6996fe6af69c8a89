"""Right of way by stop lines, lights and narrow junctions, and solid dividers, on hand-made maps."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import libsumo
import pytest
import sumolib
from defusedxml.ElementTree import parse
from small_maps import MapBuilder, crossroads, two_lane_road

from advdiff_sumo.maps.convert import convert_map
from advdiff_sumo.maps.convert.fidelity import measure

AT_WEST = [
    (88.0, 98.0),
    (90.0, 98.0),
    (90.0, 102.0),
    (88.0, 102.0),
]  # where lane "west" of the crossroads ends
AT_SOUTH = [(98.0, 88.0), (102.0, 88.0), (102.0, 90.0), (98.0, 90.0)]


def stop_line(
    road: MapBuilder, kind: str, points: list[tuple[float, float]], light: str | None = None
) -> None:
    row = {"token": f"stop{len(road.data['stop_line'])}", "polygon_token": road.polygon(points)}
    tokens = [light] if light else []
    road.data["stop_line"].append({**row, "stop_line_type": kind, "traffic_light_tokens": tokens})


def net_of(road: MapBuilder, folder: Path, **options: bool) -> Any:
    result = convert_map(road.write(folder / "small.json"), folder / "small.net.xml", **options)
    return sumolib.net.readNet(str(result.net), withInternal=True, withPrograms=True)


def crossing(net: Any) -> Any:
    """Return the only junction with more than one approach."""
    (node,) = [
        node for node in net.getNodes() if len(node.getIncoming()) > 1 and node.getType() != "internal"
    ]
    return node


def states(node: Any) -> dict[str, set[str]]:
    """Return the right of way of the links of each approach, by the source lane of the approach."""
    found: dict[str, set[str]] = {}
    for link in node.getConnections():
        if link.getFrom().getFunction() == "":
            lane = link.getFromLane().getParam("source").split(":")[0]
            found.setdefault(lane, set()).add(link.getState())
    return found


def test_stop_sign_on_one_approach(tmp_path: Path) -> None:
    road = crossroads()
    stop_line(road, "STOP_SIGN", AT_WEST)
    node = crossing(net_of(road, tmp_path))
    assert node.getType() == "priority_stop"
    assert states(node) == {"west": {"s"}, "south": {"M"}}


def test_stop_signs_on_all_approaches(tmp_path: Path) -> None:
    road = crossroads()
    stop_line(road, "STOP_SIGN", AT_WEST)
    stop_line(road, "STOP_SIGN", AT_SOUTH)
    node = crossing(net_of(road, tmp_path))
    assert node.getType() == "allway_stop"
    assert states(node) == {"west": {"w"}, "south": {"w"}}


@pytest.mark.parametrize(("at", "first", "second"), [(AT_WEST, "south", "west"), (AT_SOUTH, "west", "south")])
def test_yield_sign(tmp_path: Path, at: list[tuple[float, float]], first: str, second: str) -> None:
    road = crossroads()
    stop_line(road, "YIELD", at)
    found = states(crossing(net_of(road, tmp_path)))
    assert found[second] == {"m"}
    assert "M" in found[first]


def test_line_before_a_crossing_on_foot_tells_where_to_stop_alone(tmp_path: Path) -> None:
    """The upstream border of the line lies 2 m before the end of lane "west"."""
    plain = states(crossing(net_of(crossroads(), tmp_path)))
    road = crossroads()
    stop_line(road, "PED_CROSSING", AT_WEST)
    assert states(crossing(net_of(road, tmp_path))) == plain
    offsets = [float(row.get("value")) for row in parse(tmp_path / "small.net.xml").iter("stopOffset")]
    assert offsets == pytest.approx([2.0])


@pytest.mark.parametrize(("waits", "at"), [("west", (98.0, 101.0)), ("south", (100.0, 92.0))])
def test_turn_stop_lets_its_way_wait(tmp_path: Path, waits: str, at: tuple[float, float]) -> None:
    """A line inside the junction crosses the left turn from the west, or the connection from the south."""
    road = crossroads()
    x, y = at
    stop_line(
        road, "TURN_STOP", [(x - 1.0, y - 0.5), (x + 1.0, y - 0.5), (x + 1.0, y + 0.5), (x - 1.0, y + 0.5)]
    )
    node = crossing(net_of(road, tmp_path))
    found = {
        (
            link.getFromLane().getParam("source").split(":")[0],
            link.getToLane().getParam("source").split(":")[0],
        ): link.getState()
        for link in node.getConnections()
        if link.getFrom().getFunction() == ""
    }
    assert found[waits, "north"] == "m"
    assert found["south" if waits == "west" else "west", "north"] == "M"


def test_vehicles_stop_where_the_stop_line_is(tmp_path: Path) -> None:
    """The upstream border of the stop line lies 13 m before the end of lane "west": at red, the front stops there."""
    road = crossroads()
    stop_line(
        road, "TRAFFIC_LIGHT", [(77.0, 98.0), (78.0, 98.0), (78.0, 102.0), (77.0, 102.0)], light="light"
    )
    road.data["traffic_light"].append({"token": "light", "line_token": ""})
    result = convert_map(road.write(tmp_path / "m.json"), tmp_path / "m.net.xml")
    net = sumolib.net.readNet(str(result.net))
    (west,) = [e for e in net.getEdges() if e.getLane(0).getParam("source").startswith("west:")]
    (east,) = [e for e in net.getEdges() if e.getLane(0).getParam("source").startswith("east:")]
    libsumo.start(["sumo", "-n", str(result.net), "--no-step-log", "--step-length", "0.1"])
    try:
        (light,) = libsumo.trafficlight.getIDList()
        red = "r" * len(libsumo.trafficlight.getRedYellowGreenState(light))
        libsumo.trafficlight.setRedYellowGreenState(light, red)
        libsumo.route.add("on", [west.getID(), east.getID()])
        libsumo.vehicle.add("car", "on")
        for _ in range(300):
            libsumo.simulationStep()
        x, _ = libsumo.vehicle.getPosition("car")
    finally:
        libsumo.close()
    assert 75.0 < x <= 77.0


def test_light_by_its_stop_line(tmp_path: Path) -> None:
    road = crossroads()
    stop_line(road, "TRAFFIC_LIGHT", AT_WEST, light="light")
    road.data["traffic_light"].append({"token": "light", "line_token": ""})
    net = net_of(road, tmp_path)
    assert crossing(net).getType() == "traffic_light"
    (light,) = net.getTrafficLights()
    (program,) = light.getPrograms().values()
    links = {link[0].getParam("source").split(":")[0]: link[2] for link in light.getConnections()}
    assert set(links) == {"west", "south"}
    for phase in program.getPhases():  # crossing approaches are never green together
        assert not {phase.state[links["west"]], phase.state[links["south"]]} <= {"G"}


@pytest.mark.parametrize(
    ("x", "kind"), [(90.0, "traffic_light"), (66.0, "traffic_light"), (50.0, "priority")]
)
def test_light_by_its_own_line_counts_within_thirty_metres(tmp_path: Path, x: float, kind: str) -> None:
    road = crossroads()
    nodes = [road.node(x, 98.0), road.node(x, 102.0)]
    road.data["line"].append({"token": "line", "node_tokens": nodes})
    road.data["traffic_light"].append({"token": "light", "line_token": "line"})
    assert crossing(net_of(road, tmp_path)).getType() == kind


def light(road: MapBuilder, ends: list[tuple[float, float]], **fields: Any) -> None:
    """Add a traffic light with a line of its own between two points."""
    number = len(road.data["traffic_light"])
    nodes = [road.node(x, y) for x, y in ends]
    road.data["line"].append({"token": f"line{number}", "node_tokens": nodes})
    row = {"token": f"light{number}", "line_token": f"line{number}", **fields}
    road.data["traffic_light"].append(row)


def road_block(road: MapBuilder, token: str, points: list[tuple[float, float]]) -> None:
    road.data.setdefault("road_block", []).append({"token": token, "polygon_token": road.polygon(points)})


@pytest.mark.parametrize("by_stop_line", [True, False])
def test_light_by_its_road_block_wherever_it_stands(tmp_path: Path, by_stop_line: bool) -> None:
    road = crossroads()
    road_block(road, "block", [(38.0, 98.0), (90.5, 98.0), (90.5, 102.0), (38.0, 102.0)])
    if by_stop_line:  # 45 m before the end of the lane
        stop_line(road, "TRAFFIC_LIGHT", [(44.0, 98.0), (45.0, 98.0), (45.0, 102.0), (44.0, 102.0)], "light0")
        road.data["stop_line"][0]["road_block_token"] = "block"  # noqa: S105 - the name of a road block
        road.data["traffic_light"].append({"token": "light0", "line_token": ""})
    else:  # a light on the far side of the crossing
        light(road, [(130.0, 98.0), (130.0, 102.0)], from_road_block_token="block")  # noqa: S106 - as above
    result = convert_map(road.write(tmp_path / "m.json"), tmp_path / "m.net.xml")
    assert result.plan.idle_signals == ()
    assert crossing(sumolib.net.readNet(str(result.net))).getType() == "traffic_light"


def test_light_along_a_lane_is_not_that_lanes(tmp_path: Path) -> None:
    road = crossroads()
    light(road, [(85.0, 101.0), (90.0, 101.0)])  # ends beside the end of "west", in its direction
    result = convert_map(road.write(tmp_path / "m.json"), tmp_path / "m.net.xml")
    assert result.plan.idle_signals == ("light0",)
    assert result.source.warnings[-1] == "m.json: 1 of 1 traffic lights stop no lane: 'light0'"
    assert measure(result).figures["signals"] == {"given": 1, "that_stop_nobody": ["light0"]}
    assert crossing(sumolib.net.readNet(str(result.net))).getType() == "priority"


def test_light_that_is_never_red_is_named(tmp_path: Path) -> None:
    """The light at the end of "west" stops it for "south"; nothing crosses the road "alone"."""
    road = crossroads()
    light(road, AT_WEST[1:3])
    end = road.straight("alone", (40.0, 300.0, 0.0), 50.0)
    end = road.straight("alone-on", end, 20.0, connector=True)
    road.straight("alone-out", end, 50.0)
    road.link("alone", "alone-on", "alone-out")
    light(road, [(90.0, 298.0), (90.0, 302.0)])
    result = convert_map(road.write(tmp_path / "m.json"), tmp_path / "m.net.xml")
    assert result.plan.idle_signals == ()
    assert measure(result).figures["signals"] == {"given": 2, "that_stop_nobody": ["light1"]}


@pytest.mark.parametrize(("wide", "kind"), [(True, "traffic_light"), (False, "priority")])
def test_signals_are_guessed_at_large_junctions_only(tmp_path: Path, wide: bool, kind: str) -> None:
    road = crossroads()
    end = road.straight("opposite", (160.0, 110.0, math.pi), 50.0)
    road.straight("opposite-on", end, 20.0, connector=True)
    road.straight("west-out", (90.0, 110.0, math.pi), 50.0)
    road.link("opposite", "opposite-on", "west-out")
    if wide:
        end = road.straight("west2", (40.0, 96.5, 0.0), 50.0)
        road.straight("west2-on", end, 20.0, connector=True)
        road.straight("east2", (110.0, 96.5, 0.0), 50.0)
        road.link("west2", "west2-on", "east2")
    assert crossing(net_of(road, tmp_path, guess_signals=True)).getType() == kind


@pytest.mark.parametrize(("lefthand", "side"), [(False, "changeRight"), (True, "changeLeft")])
def test_solid_divider_forbids_the_change(tmp_path: Path, lefthand: bool, side: str) -> None:
    road = two_lane_road()  # "a" lies left of "b"
    road.data["lane"][0]["right_lane_divider_segments"] = [
        {"node_token": road.node(x, 101.75), "segment_type": "SINGLE_SOLID_WHITE"} for x in (100.0, 180.0)
    ]
    result = convert_map(road.write(tmp_path / "small.json"), tmp_path / "n.net.xml", lefthand=lefthand)
    lanes = [
        lane
        for edge in sumolib.xml.parse(str(result.net), "edge")
        for lane in edge.lane
        if any(p.value.startswith("a:") or p.value.startswith("b:") for p in lane.param or [])
    ]
    assert len(lanes) == 2
    for lane in lanes:
        is_a = lane.param[0].value.startswith("a:")
        for attribute in ("changeLeft", "changeRight"):
            assert lane.hasAttribute(attribute) == (is_a and attribute == side)


def test_ways_that_pass_too_near_yield(tmp_path: Path) -> None:
    road = MapBuilder()
    for name, y, yaw, x in (("on", 100.0, 0.0, 40.0), ("back", 101.2, math.pi, 190.0)):
        end = road.straight(f"{name}-in", (x, y, yaw), 60.0)
        road.straight(f"{name}-way", end, 30.0, connector=True)
        road.straight(f"{name}-out", (end[0] + 30.0 * math.cos(yaw), y, yaw), 60.0)
        road.link(f"{name}-in", f"{name}-way", f"{name}-out")
    result = convert_map(road.write(tmp_path / "small.json"), tmp_path / "small.net.xml")
    assert result.counts["conflicts in junctions added to netconvert's"] == 1
    node = crossing(sumolib.net.readNet(str(result.net), withInternal=True))
    assert node.areFoes(0, 1)
    assert sorted(state for own in states(node).values() for state in own) == ["M", "m"]


@pytest.mark.parametrize("guess", [False, True])
def test_signals_where_ways_run_along_each_other(tmp_path: Path, guess: bool) -> None:
    """Two opposite turns on which vehicles touch for 22 m: the conflict is stated, or a signal separates them."""
    road = crossroads()
    end = road.straight("on-in", (40.0, 200.0, 0.0), 60.0)
    end = road.straight("on-way", end, 30.0, connector=True)
    road.straight("on-out", end, 60.0)
    end = road.lane("back-in", (190.0, 201.0, math.pi), "LSR", [0.0, 60.0, 0.0])
    end = road.lane("back-way", end, "LSL", [2.0, 26.0, 2.0], 20.0, connector=True)
    road.straight("back-out", end, 60.0)
    for name in ("on", "back"):
        road.link(f"{name}-in", f"{name}-way", f"{name}-out")
    result = convert_map(road.write(tmp_path / "m.json"), tmp_path / "m.net.xml", guess_signals=guess)
    kinds = [node.getType() for node in sumolib.net.readNet(str(result.net)).getNodes()]
    assert kinds.count("traffic_light") == guess
    assert result.counts["pairs of ways with stated conflicts"] == 1


def test_open_end_that_juts_out_becomes_a_piece_of_its_own(tmp_path: Path) -> None:
    result = convert_map(two_lane_road(lead_m=8.0).write(tmp_path / "small.json"), tmp_path / "small.net.xml")
    assert result.counts["open ends cut off to even an edge"] == 1
    edges = sumolib.net.readNet(str(result.net)).getEdges()
    assert sorted((e.getLaneNumber(), round(e.getLength())) for e in edges)[0] == (1, 7)
    for edge in result.plan.edges:
        lengths = [lane.piece.length_m for lane in edge.lanes]
        assert max(lengths) - min(lengths) < 1.0
