"""OpenStreetMap streets beyond the rim lead back to the map, and the map is not changed."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small_sources
import sumolib
from osm_extracts import OsmExtract, extract_of_net
from shapely.geometry import MultiPolygon, box
from small_maps import MapBuilder
from test_bad_formats import FILES, VALUE, WRONG

from advdiff_sumo.core.errors import MapError
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.convert import ConversionResult, convert_source
from advdiff_sumo.maps.convert.fidelity import measure
from advdiff_sumo.maps.convert.projection import projection_of
from advdiff_sumo.maps.convert.sources.read_map import read_map
from advdiff_sumo.maps.convert.written_net import read_net
from advdiff_sumo.maps.read_net import BEYOND_TYPE
from advdiff_sumo.sim.driving_test import driving_test
from advdiff_sumo.sim.session import Session, SessionOptions
from advdiff_sumo.sim.world import World, read, register
from tests.e2e.commands import advdiff

PLACES = {False: "boston-seaport", True: "singapore-queenstown"}
CHANGED = ("routability", "streets_beyond_the_rim", "mended_and_cut", "netconvert_warnings")
BARS = ("teleports", "collisions_sumo", "collisions_boxes")


def road_both_ways(folder: Path, lefthand: bool = False) -> Path:
    """Write a road from x = 100 to 220 at y = 100 and 103.5, with a connector in the middle of each lane."""
    road = MapBuilder()
    east, west = (103.5, 100.0) if lefthand else (100.0, 103.5)
    for name, start, yaw, y in (("e", 100.0, 0.0, east), ("w", 220.0, math.pi, west)):
        middle = road.straight(f"{name}1", (start, y, yaw), 50.0)
        end = road.straight(f"{name}-", middle, 10.0, connector=True)
        road.straight(f"{name}2", end, 60.0)
        road.link(f"{name}1", f"{name}-", f"{name}2")
    return road.write(folder / f"{PLACES[lefthand]}.json")


def town(lefthand: bool = False) -> OsmExtract:
    """Return the street of that road, 1.5 m off, and a ring of streets from one end of the road to the other.

    A dead-end street with a turnaround branches off the ring. There are also a street that meets the road from the
    side and ends there, one without contact to others, and a footpath.
    """
    extract = OsmExtract(projection_of(PLACES[lefthand]))
    extract.way((0.0, 103.25), (400.0, 103.25), maxspeed="50", highway="secondary")
    extract.way((400.0, 103.25), (400.0, 220.0), (0.0, 220.0), (0.0, 103.25))
    extract.way((400.0, 220.0), (500.0, 220.0))
    extract.way((160.0, 103.25), (160.0, 40.0), (160.0, 0.0))
    extract.way((1000.0, 1000.0), (1200.0, 1000.0))
    extract.way((0.0, 103.25), (0.0, 0.0), highway="footway")
    return extract


def converted(folder: Path, lefthand: bool = False, **options: Any) -> ConversionResult:
    """Convert the road with the town around it."""
    osm = town(lefthand).write(folder / "town.osm")
    return convert_source(
        read_map(road_both_ways(folder, lefthand)), folder / "n.net.xml", osm=osm, **options
    )


def streets(net: Path) -> list[Any]:
    """Return the edges beyond the rim."""
    return [edge for edge in sumolib.net.readNet(str(net)).getEdges() if edge.getType() == BEYOND_TYPE]


@pytest.mark.parametrize("lefthand", [False, True])
def test_streets_lead_from_one_end_of_the_map_to_the_other(lefthand: bool, tmp_path: Path) -> None:
    result = converted(tmp_path, lefthand)
    figures = measure(result).figures
    beyond = figures["streets_beyond_the_rim"]
    assert (beyond["edges_that_lead_into_streets"], beyond["edges_that_streets_lead_into"]) == (2, 2)
    assert beyond["ends_without_street"] == 0
    assert beyond["largest_part_share_of_length_without"] == pytest.approx(
        0.25, abs=0.03
    )  # one of four edges
    assert figures["routability"]["largest_part_share_of_length"] == 1.0
    assert figures["routability"]["dead_ends"] == []
    lines = [np.array(lane.getShape())[:, :2] for edge in streets(result.net) for lane in edge.getLanes()]
    assert not any(((line > (101.0, 90.0)) & (line < (219.0, 115.0))).all(axis=1).any() for line in lines)
    assert not any((line[:, 1] < 90.0).any() or (line[:, 1] > 900.0).any() for line in lines)
    ring_m = 2 * 400.0 + 2 * 116.75 - 120.0 + 100.0
    assert beyond["km"] == pytest.approx(2 * ring_m / 1000.0, abs=0.15)


@pytest.mark.parametrize("lefthand", [False, True])
def test_the_map_stays_as_it_is(lefthand: bool, tmp_path: Path) -> None:
    result = converted(tmp_path, lefthand)
    plain = convert_source(result.given, tmp_path / "plain.net.xml")
    with_streets, without = measure(result).figures, measure(plain).figures
    for topic in without.keys() - set(CHANGED):
        assert with_streets[topic] == without[topic], topic
    assert with_streets["netconvert_warnings"] == without["netconvert_warnings"]
    lanes, own = read_net(result.net), read_net(plain.net)
    assert lanes.lanes.keys() == own.lanes.keys()
    assert lanes.connections.keys() == own.connections.keys()
    for key, (line, width_m) in own.lanes.items():
        assert np.abs(lanes.lanes[key][0] - line).max() < 1e-3
        assert lanes.lanes[key][1] == width_m
    assert _sources(result.net) == _sources(plain.net)
    road, alone = RoadMap.read(result.net), RoadMap.read(plain.net)
    assert set(road.lanes) == set(alone.lanes)
    assert road.bounds == alone.bounds
    assert road.edge_graph().successors == alone.edge_graph().successors
    assert road.source_edges() == alone.source_edges()


def _sources(net: Path) -> list[str]:
    return [line.strip() for line in net.read_text("utf-8").splitlines() if 'key="source"' in line]


def test_a_car_drives_from_the_map_through_streets_and_back_without_a_jump(tmp_path: Path) -> None:
    """The car appears in the scene only while it is on the map."""
    net = converted(tmp_path).net
    road = RoadMap.read(net)
    graph = sumolib.net.readNet(str(net))
    first = next(
        edge for edge in graph.getEdges() if edge.getID() in road.source_edges() and _x(edge) < 101.0
    )
    sinks = {edge for edge, onward in road.edge_graph().successors.items() if not onward}
    last = next(edge for edge in graph.getEdges() if edge.getID() in sinks and _x(edge, -1) > 219.0)
    onward = [edge.getID() for edge in graph.getShortestPath(last, first)[0]]
    world = World(beyond_rim=road.beyond_rim)
    places, present = [], []
    with Session(SessionOptions(net=net, seed=1)) as session:
        api = session.api
        api.route.add("round", [first.getID(), *onward])
        api.vehicle.add("car", "round", departSpeed="max")
        for _ in range(3000):
            session.step()
            if "car" not in api.vehicle.getIDList():
                break
            register(world, api, set(api.vehicle.getIDList()) - world.index.keys())
            world.remove(read(world, api, ()))
            places.append((*api.vehicle.getPosition("car"), api.vehicle.getAngle("car")))
            present.append(bool(np.isfinite(world.xy_m[0]).all()))
    path = np.array(places)
    assert np.hypot(*np.diff(path[:, :2], axis=0).T).max() < 2.0  # 50 km/h are 1.4 m in a step
    turns = np.diff(np.unwrap(np.radians(path[:, 2])))
    off_corners = (np.abs(path[1:, 0] - 200.0) < 190.0) & (path[1:, 1] < 120.0)
    assert np.degrees(np.abs(turns[off_corners])).max() < 5.0
    on_map = (path[:, 0] > 106.0) & (path[:, 0] < 219.0) & (path[:, 1] < 120.0)
    assert np.array(present)[on_map].all()
    assert not np.array(present)[path[:, 1] > 120.0].any()
    assert on_map[-1]


def _x(edge: Any, end: int = 0) -> float:
    return float(edge.getShape()[end][0])


def test_traffic_flows_over_the_joints(tmp_path: Path) -> None:
    figures = driving_test(converted(tmp_path).net, vehicles=100, duration_s=900.0)
    assert {bar: figures[bar] for bar in BARS} == dict.fromkeys(BARS, 0)
    assert figures["arrived"] >= 80


def test_an_end_that_no_street_fits_stays_open_or_gets_a_return_edge(tmp_path: Path) -> None:
    """In the east, the street continues to a turnaround; in the west there is no street."""
    osm = OsmExtract()
    osm.way((160.0, 102.0), (400.0, 102.0))
    source = read_map(road_both_ways(tmp_path))
    result = convert_source(source, tmp_path / "n.net.xml", osm=osm.write(tmp_path / "east.osm"))
    figures = measure(result).figures
    assert figures["streets_beyond_the_rim"]["ends_without_street"] == 2
    assert len(figures["routability"]["dead_ends"]) == len(figures["routability"]["sources"]) == 1
    closed = convert_source(source, tmp_path / "c.net.xml", osm=tmp_path / "east.osm", close_rim=True)
    part = measure(closed).figures["routability"]
    assert closed.counts["return edges beyond the rim"] == 1
    assert part["largest_part_edges"] == part["edges"]
    assert RoadMap.read(closed.net).edges.keys() == RoadMap.read(result.net).edges.keys()


def test_streets_that_do_not_lead_back_are_left_out(tmp_path: Path) -> None:
    osm = OsmExtract()
    osm.way((160.0, 100.0), (400.0, 100.0), oneway="yes")
    result = convert_source(
        read_map(road_both_ways(tmp_path)), tmp_path / "n.net.xml", osm=osm.write(tmp_path / "one.osm")
    )
    assert result.streets is not None
    assert result.streets.edges == result.streets.left == 0
    plain = convert_source(result.given, tmp_path / "plain.net.xml")
    assert result.net.read_bytes() == plain.net.read_bytes()


def test_two_lanes_lead_to_two_lanes_though_the_street_lies_aside(tmp_path: Path) -> None:
    road = MapBuilder()
    road.straight("right", (100.0, 100.0, 0.0), 80.0)
    road.straight("left", (100.0, 103.5, 0.0), 80.0)
    road.dashed([(100.0, 101.75), (180.0, 101.75)])
    osm = OsmExtract()
    osm.way(
        (100.0, 105.0),
        (400.0, 105.0),
        (400.0, 300.0),
        (0.0, 300.0),
        (0.0, 105.0),
        (100.0, 105.0),
        oneway="yes",
        lanes="2",
    )
    source = read_map(road.write(tmp_path / "boston-seaport.json"))
    result = convert_source(source, tmp_path / "n.net.xml", osm=osm.write(tmp_path / "ring.osm"))
    net = sumolib.net.readNet(str(result.net))
    for edge in (edge for edge in net.getEdges() if edge.getType() != BEYOND_TYPE):
        pairs = {
            (c.getFromLane().getIndex(), c.getToLane().getIndex())
            for group in (*edge.getOutgoing().values(), *edge.getIncoming().values())
            for c in group
        }
        assert pairs == {(0, 0), (1, 1)}


def test_a_street_that_changes_its_lanes_just_beyond_the_map(tmp_path: Path) -> None:
    """Only 2 m of the first part lie outside junctions, so the second part gets the joint, in both directions."""
    osm = OsmExtract()
    osm.way((0.0, 101.75), (92.0, 101.75), lanes="4")
    osm.way((92.0, 101.75), (228.0, 101.75), lanes="2")
    osm.way((228.0, 101.75), (400.0, 101.75), lanes="4")
    osm.way((400.0, 101.75), (400.0, 220.0), (0.0, 220.0), (0.0, 101.75), lanes="2")
    result = convert_source(
        read_map(road_both_ways(tmp_path)), tmp_path / "n.net.xml", osm=osm.write(tmp_path / "wide.osm")
    )
    assert result.streets is not None
    assert (result.streets.left, result.streets.entered, result.streets.open_ends) == (2, 2, 0)
    assert min(lane.getLength() for edge in streets(result.net) for lane in edge.getLanes()) > 5.0
    figures = driving_test(result.net, vehicles=50, duration_s=600.0)
    assert {bar: figures[bar] for bar in BARS} == dict.fromkeys(BARS, 0)


@pytest.mark.parametrize("on_the_map", [False, True])
def test_a_gap_to_the_street_may_be_long_where_the_map_is_drivable(on_the_map: bool, tmp_path: Path) -> None:
    """Streets begin 60 m beyond the last lanes, either because they are cut there or on their own."""
    source = read_map(road_both_ways(tmp_path))
    osm = OsmExtract()
    osm.way((160.0 if on_the_map else 280.0, 101.75), (400.0, 101.75))
    if on_the_map:
        source = replace(source, drivable=MultiPolygon([box(95.0, 95.0, 277.0, 110.0)]))
    result = convert_source(source, tmp_path / "n.net.xml", osm=osm.write(tmp_path / "far.osm"))
    assert result.streets is not None
    assert (result.streets.left, result.streets.entered) == ((1, 1) if on_the_map else (0, 0))


@pytest.mark.parametrize("kind", ["lanelet2", "argoverse2"])
def test_other_sources(kind: str, tmp_path: Path) -> None:
    """The road leads eastwards in two lanes; the left one turns north and leads out of the map."""
    path = small_sources.write(kind, tmp_path)
    if kind == "argoverse2":
        path = path.rename(tmp_path / "log_map_archive_1____PIT_city_2.json")
    source = read_map(path)
    osm = OsmExtract(source.projection)
    corner = np.concatenate([lane.centre_m for lane in source.lanes]).min(axis=0)  # (0, 0) of the road
    osm.way(*_moved([(20.0, 1.0), (180.0, 1.0), (180.0, 130.0), (61.0, 130.0)], corner))
    osm.way(*_moved([(61.0, 30.0), (61.0, 130.0), (-80.0, 130.0), (-80.0, 1.5), (30.0, 1.5)], corner))
    result = convert_source(source, tmp_path / "n.net.xml", osm=osm.write(tmp_path / "around.osm.xml"))
    figures = measure(result).figures
    assert result.streets is not None
    assert (result.streets.left, result.streets.entered, result.streets.open_ends) == (1, 1, 0)
    assert figures["routability"]["largest_part_share_of_length"] == 1.0
    assert figures["centre_line_error_m"]["source_to_net"]["max"] < 0.02


def _moved(points: Sequence[tuple[float, float]], corner: Any) -> list[tuple[float, float]]:
    return [(x + float(corner[0]), y + float(corner[1])) for x, y in points]


def _elsewhere(path: Path) -> None:
    osm = OsmExtract()
    osm.way((9000.0, 0.0), (9100.0, 0.0))
    osm.write(path)


def _on_foot(path: Path) -> None:
    osm = OsmExtract()
    osm.way((160.0, 100.0), (300.0, 100.0), highway="footway")
    osm.write(path)


BAD = {
    "lies elsewhere: streets near latitude 42.336": _elsewhere,
    "holds no street for cars": _on_foot,
    "holds no way": lambda path: path.write_text('<osm version="0.6"></osm>', "utf-8"),
    "is no OpenStreetMap data: its root element is <net>": lambda path: path.write_text("<net/>", "utf-8"),
    "is no XML text": lambda path: path.write_text('<osm version="0.6"><way', "utf-8"),
    "is no XML text (unknown encoding: x)": lambda path: path.write_text(
        '<?xml version="1.0" encoding="x"?><osm version="0.6"/>', "utf-8"
    ),
    "cannot be read": Path.exists,
    "holds no street": lambda path: path.write_text(
        '<osm version="0.6"><way id="1"><nd ref="7"/><nd ref="8"/><tag k="highway" v="service"/></way></osm>',
        "utf-8",
    ),
    "cannot be imported": lambda path: path.write_text(
        '<osm version="0.6"><node id="x" lat="1" lon="nan"/><way id="1"><nd ref="x"/></way></osm>', "utf-8"
    ),
}


@pytest.mark.parametrize("problem", BAD)
def test_extracts_that_cannot_be_used_get_one_sentence(problem: str, tmp_path: Path) -> None:
    BAD[problem](osm := tmp_path / "bad.osm")  # type: ignore[no-untyped-call]  # lambdas and functions alike
    net = tmp_path / "n.net.xml"
    with pytest.raises(Exception, match=r"bad\.osm: ") as raised:
        convert_source(read_map(road_both_ways(tmp_path)), net, osm=osm)
    assert type(raised.value).__name__ == "MapError"
    assert problem in str(raised.value)
    assert "\n" not in str(raised.value)
    assert not net.exists()


@pytest.mark.slow
def test_wrong_values_anywhere(tmp_path: Path) -> None:
    source, osm = read_map(road_both_ways(tmp_path)), town().write(tmp_path / "town.osm")
    text = osm.read_text("utf-8")
    places = [match.span(1) for match in VALUE.finditer(text)]
    draw = random.Random(7)  # noqa: S311 - no secret
    refusals: list[str] = []
    for number in range(FILES):
        spoiled = text
        for first, last in sorted(draw.sample(places, draw.choice((1, 1, 3, 10))), reverse=True):
            spoiled = spoiled[:first] + draw.choice((*WRONG, "motorway", "no")) + spoiled[last:]
        osm.write_text(spoiled[: draw.randrange(len(spoiled))] if number % 10 == 9 else spoiled, "utf-8")
        try:
            assert convert_source(source, tmp_path / "n.net.xml", osm=osm).streets is not None
        except MapError as error:
            refusals.append(str(error))
    assert 0 < len(refusals) < FILES
    assert not [text for text in refusals if "\n" in text]


def test_command(tmp_path: Path) -> None:
    path, osm = road_both_ways(tmp_path), town().write(tmp_path / "town.osm")
    done = advdiff("convert", path, "-o", tmp_path / "n", "--osm", osm, cwd=tmp_path)
    assert done.code == 0, done.err
    assert "lead on from 2 edges and back to 2, 0 ends have none: 100% of the map's length" in done.out
    figures = json.loads((tmp_path / "n.fidelity.json").read_text("utf-8"))
    assert figures["routability"]["dead_ends"] == []
    again = advdiff("convert", path, "-o", tmp_path / "m", "--osm", osm, cwd=tmp_path, hash_seed=1)
    assert again.code == 0
    assert (tmp_path / "n.net.xml").read_bytes() == (tmp_path / "m.net.xml").read_bytes()
    several = advdiff("convert", "--all", tmp_path, "--osm", osm, cwd=tmp_path)
    assert several.code == 2
    assert "--osm is an extract of one place: give it with one MAP" in several.err
    unknown = path.rename(tmp_path / "somewhere.json")
    refused = advdiff("convert", unknown, "-o", tmp_path / "x", "--osm", osm, cwd=tmp_path)
    assert refused.code == 2
    assert "the HD map does not say where on earth it lies" in refused.err
    assert len(refused.err.strip().splitlines()) == 1


@pytest.mark.data
@pytest.mark.slow
def test_genuine_streets_around_a_genuine_map(adv_data: Path, tmp_path: Path) -> None:
    """An hour of traffic on a map with the OpenStreetMap streets that DriveArena uses around it."""
    place = "singapore-onenorth"
    extract = extract_of_net(adv_data / "sumo" / f"drivearena-{place}" / "osm.net.xml")
    source = read_map(adv_data / "nuscenes-mini" / "maps" / "expansion" / f"{place}.json")
    osm = extract.write(tmp_path / "streets.osm")
    result = convert_source(source, tmp_path / "n.net.xml", osm=osm, guess_signals=True)
    plain = convert_source(source, tmp_path / "plain.net.xml", guess_signals=True)
    with_streets, without = measure(result).figures, measure(plain).figures
    for topic in without.keys() - set(CHANGED):
        assert with_streets[topic] == without[topic], topic
    assert _sources(result.net) == _sources(plain.net)
    share, before = (f["routability"]["largest_part_share_of_length"] for f in (with_streets, without))
    assert share > before + 0.3
    figures = driving_test(result.net, vehicles=300, seed=1)
    assert {bar: figures[bar] for bar in BARS} == dict.fromkeys(BARS, 0)
    assert figures["arrived"] >= 250


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "seeds"),
    [
        ("singapore-onenorth", (1,)),
        pytest.param("singapore-onenorth", (2, 3), marks=pytest.mark.nightly),
        pytest.param("boston-seaport", (1,), marks=pytest.mark.nightly),
    ],
)
def test_nobody_collides_with_streets_and_return_edges(
    place: str, seeds: tuple[int, ...], adv_data: Path, tmp_path: Path
) -> None:
    extract = extract_of_net(adv_data / "sumo" / f"drivearena-{place}" / "osm.net.xml")
    source = read_map(adv_data / "nuscenes-mini" / "maps" / "expansion" / f"{place}.json")
    osm = extract.write(tmp_path / "streets.osm")
    result = convert_source(source, tmp_path / "n.net.xml", osm=osm, guess_signals=True, close_rim=True)
    for seed in seeds:
        figures = driving_test(result.net, vehicles=300, seed=seed)
        assert {bar: figures[bar] for bar in BARS} == dict.fromkeys(BARS, 0)
        assert figures["arrived"] >= 250
