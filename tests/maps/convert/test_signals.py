"""Signal programs: links with green together, yellow and all-red times, computed by hand and on real maps."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import sumolib
from signal_checks import LEAST_SIGNALS, check_signals, written_signals
from small_maps import crossroads

from advdiff_sumo.core.errors import NetError
from advdiff_sumo.maps.convert import convert_map, convert_source
from advdiff_sumo.maps.convert.signals.fixed_times import set_fixed_times
from advdiff_sumo.maps.convert.signals.programs import all_red_s, yellow_s
from advdiff_sumo.maps.convert.signals.signal_links import SignalLink
from advdiff_sumo.maps.convert.signals.stages import stages, state_of
from advdiff_sumo.maps.convert.sources.read_map import read_map
from advdiff_sumo.maps.convert.sources.source_map import CIRCULAR, Direction, Lamp
from tests.e2e.commands import advdiff

EAST, WEST, NORTH = (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0)
LEFT_ARROW = Lamp(frozenset({Direction.LEFT}), protected=True)
LEFT_ARROWS = Lamp(frozenset({Direction.LEFT}), protected=True, exclusive=True)  # green and red ones


def link(
    index: int,
    edge: str,
    heading: tuple[float, float] = EAST,
    direction: Direction = Direction.STRAIGHT,
    *,
    target: str = "",
    lane: int = 0,
    foes: set[int] | None = None,
    yields_to: set[int] | None = None,
    approach_mps: float = 10.0,
    junction_mps: float = 5.0,
    stop_offset_m: float = 0.0,
) -> SignalLink:
    """Return a link of 20 m through the origin."""
    line_m = np.outer([-10.0, 10.0], heading)
    return SignalLink(
        index=index,
        origin=(edge, lane),
        target=target or f"to{index}",
        direction=direction,
        line_m=line_m,
        approach_m=3.0 * line_m,
        approach_mps=approach_mps,
        junction_mps=junction_mps,
        stop_offset_m=stop_offset_m,
        foes=frozenset(foes or ()),
        yields_to=frozenset(yields_to or ()),
    )


@pytest.mark.parametrize(("speed_mps", "seconds"), [(8.0, 3.0), (13.89, 3.5), (25.0, 5.5), (40.0, 6.0)])
def test_yellow(speed_mps: float, seconds: float) -> None:
    """1 s + v / (2 · 3.048 m/s²) is 2.31, 3.28, 5.10 and 7.56 s; the slower of two links does not count."""
    assert yellow_s([link(0, "a", approach_mps=speed_mps), link(1, "b", approach_mps=5.0)]) == seconds


@pytest.mark.parametrize(
    ("direction", "stop_offset_m", "seconds"),
    [
        (Direction.STRAIGHT, 0.0, 2.0),
        (Direction.STRAIGHT, 3.0, 2.5),
        (Direction.LEFT, 0.0, 4.0),
        (Direction.LEFT, 30.0, 6.0),
    ],
)
def test_all_red(direction: Direction, stop_offset_m: float, seconds: float) -> None:
    """10 m to the path of the foe, 2.2 m across it and 6.1 m of vehicle: 18.3 m at 10 m/s, or at 5 m/s in a turn."""
    ending = link(0, "a", EAST, direction, foes={1}, stop_offset_m=stop_offset_m)
    assert all_red_s([ending], [link(1, "b", NORTH, foes={0})]) == seconds


def test_who_runs_along_another_gets_clear_in_full() -> None:
    """18.3 m, and 30 m from the stop line to the junction, at 5 m/s: 9.7 s."""
    ending = link(0, "a", EAST, Direction.LEFT, foes={1}, stop_offset_m=30.0)
    starting = [link(1, "b", NORTH, foes={0})]
    assert all_red_s([ending], starting, {frozenset({("a", "to0"), ("b", "to1")})}) == 10.0


def test_no_all_red_for_those_who_do_not_cross() -> None:
    assert all_red_s([link(0, "a", EAST)], [link(1, "b", NORTH)]) == 0.0


def crossing_with_a_left_turn(*, own_lane: bool = False) -> list[SignalLink]:
    """Links 0 and 1 lead straight and left from "a", 2 is oncoming, 3 crosses all."""
    lane = 1 if own_lane else 0
    return [
        link(0, "a", EAST, foes={3}),
        link(1, "a", EAST, Direction.LEFT, lane=lane, foes={2, 3}, yields_to={2, 3}),
        link(2, "b", WEST, foes={1, 3}),
        link(3, "c", NORTH, foes={0, 1, 2}, yields_to={0, 2}),
    ]


@pytest.mark.parametrize(
    ("lamps", "states"),
    [
        ({CIRCULAR}, ["GgGr", "rrrG"]),  # permitted
        ({CIRCULAR, LEFT_ARROW}, ["GgGr", "GGrr", "rrrG"]),  # permitted and protected
        ({CIRCULAR, LEFT_ARROWS}, ["GrGr", "GGrr", "rrrG"]),  # protected
        (set(), ["GgGr", "rrrG"]),  # as with a circular lamp
    ],
)
def test_lamps_decide_on_left_turns(lamps: set[Lamp], states: list[str]) -> None:
    links = crossing_with_a_left_turn()
    cycle = stages(links, {"a": lamps}, (), lefthand=False)
    assert [state_of(stage, links, 4) for stage in cycle] == states


def test_a_turn_with_a_lane_of_its_own_gets_an_arrow_where_the_map_tells_nothing() -> None:
    links = crossing_with_a_left_turn(own_lane=True)
    for lefthand, count in ((False, 3), (True, 2)):
        assert len(stages(links, {}, (), lefthand)) == count


def test_ways_that_run_along_each_other_never_go_together() -> None:
    links = crossing_with_a_left_turn()
    apart = {frozenset({("a", "to1"), ("b", "to2")})}
    cycle = stages(links, {}, apart, lefthand=False)
    assert [state_of(stage, links, 4) for stage in cycle] == ["GGrr", "rrGr", "rrrG"]


def test_links_that_no_lamp_governs_are_served() -> None:
    links = crossing_with_a_left_turn()
    cycle = stages(links, {"a": {LEFT_ARROWS}}, (), lefthand=False)
    assert frozenset[int]().union(*cycle) == {0, 1, 2, 3}


@pytest.mark.parametrize(
    ("lights", "states"),
    [
        ({"a": {"one"}, "b": {"one"}}, ["GGr", "rrG"]),  # one road in two edges
        ({"a": {"one"}, "b": {"other"}}, ["GGr", "rGG"]),  # a separate road without conflicts
        ({"a": {"one"}, "c": {"one"}}, ["GGr", "rGG"]),  # one light for links that cross: never together
    ],
)
def test_edges_that_share_a_light_get_green_together(lights: dict[str, set[str]], states: list[str]) -> None:
    """Links 0 and 1 run side by side from different edges; 2 crosses only link 0."""
    links = [link(0, "a", EAST, foes={2}), link(1, "b", EAST), link(2, "c", NORTH, foes={0}, yields_to={0})]
    shared = {edge: frozenset(names) for edge, names in lights.items()}
    cycle = stages(links, {}, (), lefthand=False, lights=shared)
    assert [state_of(stage, links, 3) for stage in cycle] == states


def test_a_turn_under_a_light_that_nobody_crosses_goes_with_its_road() -> None:
    """Link 0 leads straight from "a", 1 turns right under an arrow, 2 crosses only link 0; "c" has no light."""
    right = Lamp(frozenset({Direction.RIGHT}), protected=True, exclusive=True)
    links = [
        link(0, "a", EAST, foes={2}),
        link(1, "a", EAST, Direction.RIGHT, lane=1),
        link(2, "c", NORTH, foes={0}, yields_to={0}),
    ]
    lit = {"a": frozenset({"light", "arrow"})}
    cycle = stages(links, {"a": {CIRCULAR, right}}, (), lefthand=False, lights=lit)
    assert [state_of(stage, links, 3) for stage in cycle] == ["GGr", "rrG"]


@pytest.mark.data
def test_all_lanes_of_a_real_light_get_red(adv_data: Path, tmp_path: Path) -> None:
    """The middle lane of light 11528 is a separate edge; left arrow 11522 and right turn 11526 have no conflicts."""
    source = read_map(adv_data / "commonroad/USA_Lanker-1_3_T-1.xml.gz")
    result = convert_source(source, tmp_path / "n.net.xml", crossings="none")
    assert check_signals(result.net) == 2
    states = {signal.name: [state for _, state in signal.phases] for signal in written_signals(result.net)}
    lit = [
        row
        for row in sumolib.xml.parse(str(result.net), "connection")
        if row.tl and row.attr_from in result.plan.lights
    ]
    assert len(lit) == 20
    for row in lit:
        assert "r" in {state[int(row.linkIndex)] for state in states[row.tl]}, row.attr_from


@pytest.mark.parametrize(
    ("shapes", "letters"),
    [(("CIRCLE",), {"g"}), (("CIRCLE", "LEFT"), {"g", "G"}), (("CIRCLE", "LEFT", "RED LEFT"), {"G"})],
)
def test_arrows_of_a_map_file(shapes: tuple[str, ...], letters: set[str], tmp_path: Path) -> None:
    """The left turn of the crossroads, with an oncoming road."""
    road = crossroads()
    end = road.straight("oncoming", (160.0, 104.0, math.pi), 50.0)
    road.straight("oncoming-on", end, 20.0, connector=True)
    road.straight("west-out", (90.0, 104.0, math.pi), 50.0)
    road.link("oncoming", "oncoming-on", "west-out")
    items = [
        {"color": "RED" if shape.startswith("RED") else "GREEN", "shape": shape.split()[-1]}
        for shape in shapes
    ]
    nodes = [road.node(90.0, y) for y in (98.0, 102.0)]
    road.data["line"].append({"token": "line", "node_tokens": nodes})
    road.data["traffic_light"].append({"token": "light", "line_token": "line", "items": items})
    result = convert_map(road.write(tmp_path / "m.json"), tmp_path / "m.net.xml")
    assert check_signals(result.net) == 1
    (turn,) = [
        row.linkIndex
        for row in sumolib.xml.parse(str(result.net), "connection")
        if row.tl and row.param and row.param[0].value.startswith("west-north")
    ]
    (signal,) = written_signals(result.net)
    assert {state[int(turn)] for _, state in signal.phases} - {"r", "y"} == letters


@pytest.mark.slow
def test_fixed_times_for_the_traffic_of_an_hour(tmp_path: Path) -> None:
    """By Webster's formula, green times follow traffic; yellow and all-red, and nets without signals, do not change."""
    road = crossroads()
    nodes = [road.node(90.0, y) for y in (98.0, 102.0)]
    road.data["line"].append({"token": "line", "node_tokens": nodes})
    road.data["traffic_light"].append({"token": "light", "line_token": "line"})
    states, greens = [], []
    for vehicles in ("0", "300", "1500"):
        net = tmp_path / f"{vehicles}.net.xml"
        path = road.write(tmp_path / "m.json")
        done = advdiff("convert", path, "-o", net, "--tls-cycle", vehicles, cwd=tmp_path)
        assert (done.code, done.err) == (0, "")
        assert check_signals(net) == 1
        (program,) = sumolib.xml.parse(str(net), "tlLogic")
        assert program.type == ("actuated" if vehicles == "0" else "static")
        (signal,) = written_signals(net)
        states.append([state for _, state in signal.phases])
        greens.append([seconds for seconds, state in signal.phases if set(state) & set("gG")])
    assert states[0] == states[1] == states[2]
    assert sum(greens[1]) < sum(greens[2]), "more traffic, longer cycle"
    plain = convert_source(read_map(crossroads().write(tmp_path / "p.json")), tmp_path / "p.net.xml")
    timed = convert_source(read_map(tmp_path / "p.json"), tmp_path / "t.net.xml", cycle_for=300)
    assert timed.net.read_bytes() == plain.net.read_bytes()


@pytest.mark.slow
def test_a_net_that_the_tools_refuse_is_one_sentence(tmp_path: Path) -> None:
    net = tmp_path / "none.net.xml"
    net.write_text(
        '<net><tlLogic id="j"><phase duration="30" state="G" minDur="5" maxDur="50"/></tlLogic></net>',
        "utf-8",
    )
    with pytest.raises(NetError, match=r"none.net.xml.*randomTrips.py failed"):
        set_fixed_times(net, 300)


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "least"),
    [
        pytest.param(name, least, marks=[pytest.mark.nightly] if least > 10 else [])
        for name, least in LEAST_SIGNALS.items()
    ],
)
def test_real_maps_with_crossings(name: str, least: int, adv_data: Path, tmp_path: Path) -> None:
    """``test_hour`` tests the same without crossings."""
    source = read_map(adv_data / name)
    result = convert_source(source, tmp_path / "n.net.xml", guess_signals=True, crossings="guess")
    assert check_signals(result.net) >= least
