"""Crossings and sidewalks in converted nets: worked by hand, obeyed by SUMO, and without a change for vehicles."""

from __future__ import annotations

import itertools
import json
import shutil
from pathlib import Path
from xml.etree.ElementTree import Element

import libsumo
import numpy as np
import pytest
from defusedxml.ElementTree import parse
from foot_runs import drive
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from shapely.geometry import Polygon
from small_maps import MapBuilder, crossroads

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.convert import convert_map, convert_source
from advdiff_sumo.maps.convert.fidelity import measure
from advdiff_sumo.maps.convert.sources.read_map import read_map
from advdiff_sumo.maps.on_foot.add_paths import add_foot_paths
from tests.e2e.commands import Outcome, advdiff

EAST = [(104.0, 96.0), (107.0, 96.0), (107.0, 104.0), (104.0, 104.0)]  # over the way "west-east", 8 m by 3 m
ROUTE = ("west", "east")  # of the car
VEHICLE_FREE = {"crossing", "walkingarea"}


def with_crossing(*areas: list[tuple[float, float]]) -> MapBuilder:
    road = crossroads()
    for area in areas:
        road.area("ped_crossing", area)
    return road


def with_light(road: MapBuilder) -> MapBuilder:
    at_west = road.polygon([(88.0, 98.0), (90.0, 98.0), (90.0, 102.0), (88.0, 102.0)])
    row = {"token": "stop0", "polygon_token": at_west, "stop_line_type": "TRAFFIC_LIGHT"}
    road.data["stop_line"].append({**row, "traffic_light_tokens": ["light"]})
    road.data["traffic_light"].append({"token": "light", "line_token": ""})
    return road


def for_vehicles(net: Path) -> list[dict[str, str]]:
    """Return the attributes of all lanes and connections that vehicles use, but who yields."""
    root = parse(net).getroot()
    lanes = [
        dict(lane.attrib)
        for edge in root.iter("edge")
        if edge.get("function") not in VEHICLE_FREE
        for lane in edge.iter("lane")
        if lane.get("allow") != "pedestrian"
    ]
    on_foot = {edge.get("id") for edge in root.iter("edge") if _on_foot(edge)}
    rows = [
        {key: value for key, value in row.items() if key != "state"}
        for row in root.iter("connection")
        if not {row.get("from"), row.get("to")} & on_foot
    ]
    return lanes + rows


def _on_foot(edge: Element) -> bool:
    return all(lane.get("allow") == "pedestrian" for lane in edge.iter("lane"))


def edges_of(net: Path, function: str) -> list[Element]:
    return [edge for edge in parse(net).getroot().iter("edge") if edge.get("function") == function]


def test_a_crossing_worked_by_hand(tmp_path: Path) -> None:
    """3 m wide, 8 m long across the eastward way at x = 105.5, which enters edge "east" at x = 110."""
    result = convert_map(with_crossing(EAST).write(tmp_path / "m.json"), tmp_path / "m.net.xml")
    (edge,) = edges_of(result.net, "crossing")
    (lane,) = edge.iter("lane")
    assert float(lane.get("width", "")) == pytest.approx(3.0)
    ends = np.array([[float(v) for v in p.split(",")] for p in lane.get("shape", "").split()])
    assert ends[:, 0] == pytest.approx([105.5, 105.5])
    assert sorted(ends[:, 1].tolist()) == pytest.approx([96.0, 104.0])
    root = parse(result.net).getroot()
    rows = [r for r in root.iter("junction") if r.get("id") == edge.get("id", "")[1:].rpartition("_")[0]]
    lanes = rows[0].get("intLanes", "").split()
    requests = rows[0].findall("request")
    assert lanes[-1] == f"{edge.get('id')}_0"
    assert len(requests) == len(lanes) == 4
    over = [i for i, name in enumerate(lanes[:-1]) if requests[-1].get("foes", "")[::-1][i] == "1"]
    straight = {row.get("via") for row in root.iter("connection") if row.get("dir") == "s"}
    assert [lanes[i] in straight for i in over] == [
        True
    ]  # the way straight on, not the turn that left before
    assert requests[over[0]].get("response", "")[::-1][-1] == "1"  # the vehicles yield
    assert set(requests[-1].get("response", "")) == {"0"}
    assert RoadMap.read(result.net).pedestrian_shapes.keys() >= {edge.get("id")}


@pytest.mark.parametrize("light", [False, True])
def test_nothing_changes_for_vehicles(light: bool, tmp_path: Path) -> None:
    road = with_crossing(EAST)
    path = (with_light(road) if light else road).write(tmp_path / "m.json")
    plain = convert_map(path, tmp_path / "plain.net.xml", crossings="none")
    walked = convert_map(path, tmp_path / "walked.net.xml")
    assert for_vehicles(walked.net) == for_vehicles(plain.net)
    before, after = measure(plain).figures, measure(walked).figures
    assert before.pop("crossings") is None
    assert after.pop("crossings")["kept"] == 1
    assert after == before


AWAY = [(205.0, 96.0), (208.0, 96.0), (208.0, 104.0), (205.0, 104.0)]
ON_LANE = [(135.0, 96.0), (138.0, 96.0), (138.0, 104.0), (135.0, 104.0)]
NEAR_RIM = [(156.0, 96.0), (159.0, 96.0), (159.0, 104.0), (156.0, 104.0)]
ALONG = [(96.0, 98.5), (112.0, 98.5), (112.0, 101.5), (96.0, 101.5)]


@pytest.mark.parametrize(
    ("areas", "kept", "reason"),
    [
        ([EAST], 1, None),
        ([EAST, EAST], 1, "over another crossing"),
        ([AWAY], 0, "no lane"),
        ([ON_LANE], 1, None),
        ([NEAR_RIM], 0, "outside the ways of a junction"),
        ([[(104.0, -96.0), (107.0, -96.0), (107.0, 304.0), (104.0, 304.0)]], 0, "longer than 100 m"),
    ],
)
def test_crossings_left_out_have_a_reason(
    areas: list[list[tuple[float, float]]], kept: int, reason: str | None, tmp_path: Path
) -> None:
    result = convert_map(with_crossing(*areas).write(tmp_path / "m.json"), tmp_path / "m.net.xml")
    figures = measure(result).figures["crossings"]
    assert (figures["given"], figures["kept"]) == (len(areas), kept)
    (told,) = figures["left_out"] or [None]
    assert (told is None) if reason is None else reason in told
    assert len(edges_of(result.net, "crossing")) == kept
    libsumo.start(["sumo", "-n", str(result.net), "--no-step-log"])
    libsumo.close()


def test_vehicles_wait_for_people_on_a_crossing_without_signals(tmp_path: Path) -> None:
    """The crossing's near side is at x = 104; alone, the car does not stop."""
    result = convert_map(with_crossing(EAST).write(tmp_path / "m.json"), tmp_path / "m.net.xml")
    alone = drive(result.net, ROUTE, None, 20.0)
    assert min(step["speed"] for step in alone if "front_m" in step) > 3.0
    met = 0
    for begin in np.arange(0.0, 12.0, 1.5):
        steps = drive(result.net, ROUTE, float(begin), 60.0)
        crossing = [s for s in steps if "_c0" in s.get("where", "") and 98.0 < s["y"] < 102.0]
        assert crossing
        assert not [s for s in crossing if "front_m" in s and 104.5 < s["front_m"] < 110.0]
        met += any("front_m" in s and s["front_m"] < 104.5 and s["speed"] < 0.5 for s in crossing)
        assert all("front_m" not in s for s in steps[-10:])  # it drove on
    assert met


def test_people_wait_at_red(tmp_path: Path) -> None:
    """Whoever steps on the crossing does so while it is green, and the way straight over it is red then."""
    result = convert_map(with_light(with_crossing(EAST)).write(tmp_path / "m.json"), tmp_path / "m.net.xml")
    root = parse(result.net).getroot()
    name = edges_of(result.net, "crossing")[0].get("id")
    index = next(int(row.get("linkIndex", "")) for row in root.iter("connection") if row.get("to") == name)
    over = next(
        int(row.get("linkIndex", ""))
        for row in root.iter("connection")
        if row.get("tl") and (row.get("fromLane"), row.get("dir"), row.get("state")) == ("0", "s", "o")
    )
    waited = 0
    for begin in np.arange(0.0, 60.0, 7.0):
        steps = drive(result.net, ROUTE, float(begin), begin + 120.0)
        on = next(k for k, s in enumerate(steps) if s.get("where") == name)
        assert steps[on]["lights"][index] == "G"
        assert steps[on]["lights"][over] == "r"
        waited += any(s.get("pace", 1.0) < 0.1 and s["lights"][index] == "r" for s in steps[:on])
    assert waited


def test_crossings_are_guessed_at_junctions_alone(tmp_path: Path) -> None:
    """The crossroads have four arms, each of one lane."""
    path = crossroads().write(tmp_path / "m.json")
    assert measure(convert_map(path, tmp_path / "m.net.xml")).figures["crossings"]["given"] == 0
    result = convert_map(path, tmp_path / "g.net.xml", crossings="guess")
    figures = measure(result).figures["crossings"]
    assert figures["guessed"] is True
    assert (figures["given"], figures["kept"]) == (4, 4)
    plain = convert_map(path, tmp_path / "plain.net.xml", crossings="none")
    assert for_vehicles(result.net) == for_vehicles(plain.net)
    given = convert_map(with_crossing(EAST).write(path), tmp_path / "m.net.xml", crossings="guess")
    assert measure(given).figures["crossings"]["guessed"] is False  # the map has its own


@pytest.fixture(scope="module")
def plain_net(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("net")
    return convert_map(crossroads().write(folder / "m.json"), folder / "plain.net.xml", crossings="none").net


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    x=st.floats(80.0, 120.0),
    y=st.floats(80.0, 120.0),
    angle=st.floats(0.0, 3.1),
    length=st.floats(0.5, 40.0),
    width=st.floats(0.1, 12.0),
    again=st.booleans(),
)
def test_any_crossing_leaves_vehicles_alone_and_a_net_that_sumo_reads(
    x: float, y: float, angle: float, length: float, width: float, again: bool, plain_net: Path
) -> None:
    net = plain_net.with_name("any.net.xml")
    shutil.copy(plain_net, net)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    box = 0.5 * np.array([[-length, -width], [length, -width], [length, width], [-length, width]])
    areas = [Polygon(box @ turn + (x, y)), *([Polygon(box + np.array([105.0, 100.0]))] if again else [])]
    paths = add_foot_paths(net, areas)
    assert paths.kept + sum(map(len, paths.left_out.values())) == paths.given == len(areas)
    assert for_vehicles(net) == for_vehicles(plain_net)
    libsumo.start(["sumo", "-n", str(net), "--no-step-log"])
    try:
        assert sum("_c" in name for name in libsumo.edge.getIDList()) == paths.crossings
    finally:
        libsumo.close()


def convert(path: Path, *options: str) -> Outcome:
    return advdiff("convert", path, "-o", path.parent / "o.net.xml", *options, cwd=path.parent)


@pytest.mark.slow
def test_command(tmp_path: Path) -> None:
    path = with_crossing(EAST, AWAY).write(tmp_path / "m.json")
    done = convert(path)
    assert done.code == 0, done.err
    assert "1 of 2 crossings are in the net" in done.out
    assert "note: 1 of the crossings left out: no lane leads over it" in done.out
    figures = json.loads((tmp_path / "o.fidelity.json").read_text())["crossings"]
    assert figures["left_out"] == {"no lane leads over it": [[206.5, 100.0]]}
    assert convert(path, "--crossings", "none").code == 0
    assert not edges_of(tmp_path / "o.net.xml", "crossing")
    wrong = convert(path, "--crossings", "some")
    assert wrong.code == 2
    assert "--crossings some: known are 'map', 'guess' and 'none'" in " ".join(wrong.err.split())


@pytest.mark.slow
def test_a_malformed_crossing_is_one_sentence(tmp_path: Path) -> None:
    road = with_crossing(EAST, EAST, EAST)
    road.data["ped_crossing"][1]["polygon_token"] = "nowhere"  # noqa: S105 - the name of an area
    del road.data["ped_crossing"][2]["polygon_token"]
    done = convert(road.write(tmp_path / "m.json"))
    assert done.code == 0
    notes = [line for line in done.out.splitlines() if line.startswith("note:")]
    assert len(notes) == 2, done.out
    assert "polygon 'nowhere' does not exist" in notes[0]
    assert "ped_crossing 'ped_crossing2' has no polygon and is left out" in notes[1]
    assert "1 of 1 crossings are in the net" in done.out


@pytest.mark.data
def test_crossings_of_a_genuine_map(adv_data: Path, tmp_path: Path) -> None:
    """Miami: people walk on every crossing and sidewalk that a trip leads over, and nothing is said against them."""
    (path,) = (adv_data / "argoverse2").rglob("log_map_archive_*MIA*.json")
    walked = convert_source(read_map(path), tmp_path / "w.net.xml")
    plain = convert_source(read_map(path), tmp_path / "p.net.xml", crossings="none")
    assert for_vehicles(walked.net) == for_vehicles(plain.net)
    assert walked.foot_paths is not None
    assert walked.foot_paths.kept == walked.foot_paths.given == 6
    names = [edge.get("id", "") for edge in parse(walked.net).getroot().iter("edge") if _on_foot(edge)]
    walks = sorted(name for name in names if not name.startswith(":"))
    messages = tmp_path / "messages.txt"
    libsumo.start(["sumo", "-n", str(walked.net), "--no-step-log", "--message-log", str(messages)])
    walked_on = set()
    try:
        for number, (start, end) in enumerate(itertools.product(walks[::3], walks[1::3])):
            stages = libsumo.simulation.findIntermodalRoute(start, end)
            if stages:
                libsumo.person.add(f"p{number}", start, 0.0, depart=number)
                libsumo.person.appendStage(f"p{number}", stages[0])
        while libsumo.simulation.getMinExpectedNumber():
            libsumo.simulationStep()
            walked_on |= {libsumo.person.getRoadID(name) for name in libsumo.person.getIDList()}
    finally:
        libsumo.close()
    assert {edge.get("id") for edge in edges_of(walked.net, "crossing")} <= walked_on
    assert "could not find route" not in messages.read_text()
    assert "jam" not in messages.read_text()
