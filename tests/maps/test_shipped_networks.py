"""The shipped nets: what they hold, how they look to a car, that they drive, that their generator makes them."""

from __future__ import annotations

import itertools
import random
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import libsumo
import numpy as np
import pytest
import shapely
import sumolib
from defusedxml import ElementTree
from shapely import LineString, Polygon

from advdiff_sumo.maps.on_foot.footways import read_footways

NAMES = ("downtown", "downtown-left", "motorway")
PEOPLE = "downtown-people"  # the downtown with crossings and sidewalks
TOOLS = Path(__file__).resolve().parents[2] / "tools"


@pytest.fixture(scope="module", params=NAMES)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def net(name: str, networks: Path) -> Any:
    return sumolib.net.readNet(str(networks / f"{name}.net.xml"), withInternal=True, withPrograms=True)


def _streets(net: Any) -> list[Any]:
    return list(net.getEdges(withInternal=False))


def _meetings(net: Any) -> list[Any]:
    """Nodes at which at least three ways meet."""
    found = []
    for node in net.getNodes():
        ways = {e.getFromNode().getID() for e in node.getIncoming() if not e.isSpecial()}
        ways |= {e.getToNode().getID() for e in node.getOutgoing() if not e.isSpecial()}
        if len(ways - {node.getID()}) >= 3:
            found.append(node)
    return found


def _fringe(net: Any) -> tuple[list[Any], list[Any]]:
    sources = [e for e in _streets(net) if e.getFromNode().getType() == "dead_end"]
    return sources, [e for e in _streets(net) if e.getToNode().getType() == "dead_end"]


def _closed_set(start: Any, onward: bool) -> set[str]:
    seen, queue = {start.getID()}, [start]
    while queue:
        edge = queue.pop()
        ways = edge.getOutgoing() if onward else edge.getIncoming()
        fresh = [e for e in ways if not e.isSpecial() and e.getID() not in seen]
        seen |= {e.getID() for e in fresh}
        queue += fresh
    return seen


# counted on the layouts' tables: 42 junctions and the 8 nodes of a four-armed roundabout; 14 and 14 ramp ends
@pytest.mark.parametrize(
    ("name", "count"), [("downtown", 50), ("downtown-left", 50), ("motorway", 28)], scope="module"
)
def test_number_of_junctions(net: Any, count: int) -> None:
    assert len(_meetings(net)) == count


@pytest.mark.parametrize(
    ("name", "signals", "kinds"),
    [
        ("downtown", 14, {"priority", "traffic_light", "allway_stop", "right_before_left"}),
        ("downtown-left", 12, {"priority", "traffic_light", "allway_stop", "right_before_left"}),
        ("motorway", 5, {"priority", "traffic_light", "right_before_left"}),
    ],
    scope="module",
)
def test_kinds_of_junctions(net: Any, signals: int, kinds: set[str]) -> None:
    types = [node.getType() for node in net.getNodes() if node.getType() != "dead_end"]
    # netconvert calls the left-hand counterpart of "right before left" by its own name
    assert {t.replace("left_before_right", "right_before_left") for t in types} == kinds
    assert types.count("traffic_light") == signals


@pytest.mark.parametrize("name", ["downtown", "downtown-left"], scope="module")
def test_district_has_a_roundabout_whose_circle_has_priority(net: Any) -> None:
    (ring,) = net.getRoundabouts()
    circle = set(ring.getEdges())
    assert len(circle) == 8
    entries = [e for n in ring.getNodes() for e in net.getNode(n).getIncoming() if not e.isSpecial()]
    entries = [e for e in entries if e.getID() not in circle]
    assert len(entries) == 4
    for entry in entries:
        links = [c for cs in entry.getOutgoing().values() for c in cs if not c.getTo().isSpecial()]
        assert {c.getState() for c in links} == {"m"}  # minor: gives way


def test_no_junction_is_unregulated_and_only_the_fringe_is_a_dead_end(net: Any) -> None:
    for node in net.getNodes():
        assert node.getType() != "unregulated"
        incoming = [e for e in node.getIncoming() if not e.isSpecial()]
        outgoing = [e for e in node.getOutgoing() if not e.isSpecial()]
        across = [*(e.getOutgoing() for e in incoming), *(e.getIncoming() for e in outgoing)]
        assert {bool(ways) for ways in across} == {node.getType() != "dead_end"}
        if node.getType() == "dead_end":
            assert max(len(incoming), len(outgoing)) == 1


def test_signals_show_yellow_and_all_red_between_greens(net: Any) -> None:
    for light in net.getTrafficLights():
        (program,) = light.getPrograms().values()
        states = [phase.state for phase in program.getPhases()]
        for before, after in itertools.pairwise([*states, states[0]]):
            cut = [a + b for a, b in zip(before, after, strict=True) if a in "Gg" and b == "r"]
            assert not cut, f"{light.getID()}: green turns red without yellow"
        assert any(set(state) == {"r"} for state in states)
        assert 40 <= sum(phase.duration for phase in program.getPhases()) <= 120


def test_hand_of_traffic_and_lane_order(name: str, net: Any, networks: Path) -> None:
    root: Any = ElementTree.parse(networks / f"{name}.net.xml").getroot()
    left = root.get("lefthand") == "true"
    assert left == (name == "downtown-left")
    for edge in (e for e in _streets(net) if e.getLaneNumber() > 1):
        for kerb, inner in itertools.pairwise(edge.getLanes()):
            a, b, c = (np.asarray(p) for p in (*kerb.getShape()[:2], inner.getShape()[0]))
            ahead, across = b - a, c - a
            assert (ahead[0] * across[1] - ahead[1] * across[0] < 0) == left


def test_widths_and_limits(net: Any) -> None:
    for edge in net.getEdges(withInternal=False):
        assert 30 / 3.6 - 0.01 <= edge.getSpeed() <= 130 / 3.6 + 0.01
        assert all(3.2 <= lane.getWidth() <= 3.5 for lane in edge.getLanes())


def test_motorway_has_three_lanes_and_more(networks: Path) -> None:
    net = sumolib.net.readNet(str(networks / "motorway.net.xml"))
    lanes = {e.getID(): e.getLaneNumber() for e in net.getEdges() if e.getSpeed() > 100 / 3.6}
    assert len(lanes) == 16 + 13  # sections eastbound and westbound
    assert set(lanes.values()) == {3, 4, 5}
    weave = net.getEdge("E4-E5")
    assert {e.getID() for e in weave.getIncoming()} == {"E3-E4", "J1-E4"}
    assert {e.getID() for e in weave.getOutgoing()} == {"E5-E6", "E5-J2"}
    assert 350 < weave.getLength() < 500


def test_every_source_reaches_every_sink(net: Any) -> None:
    sources, sinks = _fringe(net)
    assert len(sources) >= 8
    assert len(sinks) >= 8
    pairs = [(s, t) for s in sources for t in sinks if s.getFromNode() != t.getToNode()]
    reached = {s.getID(): _closed_set(s, True) for s in sources}
    missing = [(s.getID(), t.getID()) for s, t in pairs if t.getID() not in reached[s.getID()]]
    assert not missing


def test_no_edge_is_cut_off_or_a_trap(net: Any) -> None:
    sources, sinks = _fringe(net)
    ahead = set().union(*(_closed_set(s, True) for s in sources))
    back = set().union(*(_closed_set(t, False) for t in sinks))
    every = {e.getID() for e in _streets(net)}
    assert ahead == back == every


def _turning(shape: list[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Change of heading (rad) at each inner vertex, and the length (m) it is spread over."""
    steps = np.diff(np.asarray(shape), axis=0)
    lengths = np.hypot(*steps.T)
    heading = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    return np.abs(np.diff(heading)), (lengths[1:] + lengths[:-1]) / 2


def test_lanes_bend_as_a_car_can_follow(net: Any) -> None:
    for edge in net.getEdges():
        for lane in edge.getLanes():
            angle, spread = _turning(lane.getShape())
            if len(angle):
                assert np.degrees(angle.max()) <= 10.0, f"{lane.getID()} has a kink"
                smooth = np.convolve(angle, [0.5, 0.5], "valid") if len(angle) > 1 else angle
                over = np.convolve(spread, [0.5, 0.5], "valid") if len(angle) > 1 else spread
                assert (over / np.maximum(smooth, 1e-9)).min() >= 4.5, f"{lane.getID()} is tighter than 4.5 m"


def test_limits_suit_the_bends(net: Any) -> None:
    for edge in net.getEdges():
        for lane in edge.getLanes():
            angle, spread = _turning(lane.getShape())
            if len(angle) > 1:
                over = np.convolve(spread, [0.5, 0.5], "valid")
                bend = np.convolve(angle, [0.5, 0.5], "valid") / over
                assert lane.getSpeed() ** 2 * bend.max() <= 5.0, f"{lane.getID()}: lateral acceleration, m/s²"


def test_lanes_join_without_a_gap_or_a_kink(net: Any) -> None:
    for edge in net.getEdges():
        for lane in edge.getLanes():
            for link in lane.getOutgoing():
                via = link.getViaLaneID()
                onward = net.getLane(via) if via else link.getToLane()
                gap = np.subtract(lane.getShape()[-1], onward.getShape()[0])
                assert np.hypot(*gap) <= 0.1, f"{lane.getID()} → {onward.getID()}"
                angle, _ = _turning([*lane.getShape()[-2:], onward.getShape()[1]])
                assert np.degrees(angle.max()) <= 10.0, f"{lane.getID()} → {onward.getID()}"


def test_side_car_covers_every_lane(name: str, net: Any, networks: Path) -> None:
    polygons = list(sumolib.shapes.polygon.read(str(networks / f"{name}.poly.xml")))
    assert all(Polygon(p.shape).is_valid for p in polygons)
    area, holes = (
        shapely.union_all([Polygon(p.shape) for p in polygons if p.type == kind])
        for kind in ("drivable_area", "drivable_area_hole")
    )
    drivable = area.difference(holes)
    lanes = [lane for edge in net.getEdges() for lane in edge.getLanes()]
    bands = shapely.union_all(
        [LineString(k.getShape()).buffer(k.getWidth() / 2, cap_style="flat") for k in lanes]
    )
    assert bands.intersection(drivable).area >= 0.999 * bands.area
    assert drivable.area <= 1.45 * bands.area  # margins, corners and tapers, no filled-in blocks
    walkways = shapely.union_all([Polygon(p.shape) for p in polygons if p.type == "walkway"])
    assert walkways.intersection(drivable).area <= 1e-3 * max(walkways.area, 1.0)


def test_generator_reproduces_the_committed_files(tmp_path: Path, networks: Path) -> None:
    command = [sys.executable, str(TOOLS / "make_networks.py"), "--out", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True)
    for stem, kind in itertools.product((*NAMES, PEOPLE), ("net", "poly")):
        made, kept = tmp_path / f"{stem}.{kind}.xml", networks / f"{stem}.{kind}.xml"
        assert made.read_bytes() == kept.read_bytes(), f"{kept.name} differs from what its generator makes"


def _for_vehicles(path: Path) -> list[tuple[str | None, ...]]:
    root: Any = ElementTree.parse(path).getroot()
    lanes = [lane for lane in root.iter("lane") if lane.get("allow") != "pedestrian"]
    rows = [row for row in root.iter("connection") if row.get("via")]
    return [
        *(tuple(lane.get(key) for key in ("id", "shape", "length", "speed", "width")) for lane in lanes),
        *(tuple(row.get(key) for key in ("from", "to", "fromLane", "toLane", "via", "tl")) for row in rows),
    ]


def test_the_downtown_with_people_is_the_same_for_vehicles(networks: Path) -> None:
    plain, walked = (networks / f"{name}.net.xml" for name in ("downtown", PEOPLE))
    assert _for_vehicles(walked) == _for_vehicles(plain)
    ways = read_footways(walked)
    assert set(ways.part.tolist()) == {0}  # one can walk from any sidewalk to any other
    root: Any = ElementTree.parse(walked).getroot()
    crossings = [edge for edge in root.iter("edge") if edge.get("function") == "crossing"]
    assert len(crossings) == 171  # over 161 arms, some in two parts with an island between
    lights = {row.get("tl") for row in root.iter("connection") if row.get("to", "").startswith(":")} - {None}
    assert len(lights) == 14


OPTIONS = (
    *("--step-length", "0.1", "--lateral-resolution", "0.4", "--time-to-teleport", "120", "--seed", "7"),
    *("--collision.action", "warn", "--collision.check-junctions", "true", "--collision.mingap-factor", "0"),
    *("--no-step-log", "true", "--no-warnings", "true", "--xml-validation", "never"),
)


@pytest.fixture
def traffic(name: str, networks: Path) -> Iterator[None]:
    libsumo.start(["sumo", "-n", str(networks / f"{name}.net.xml"), *OPTIONS])
    yield
    libsumo.close()


@pytest.mark.usefixtures("traffic")
def test_five_minutes_of_traffic_run_without_collision_or_teleport(net: Any) -> None:
    draw = random.Random(7)  # noqa: S311 - traffic demand, no secret
    sources, sinks = _fringe(net)
    arrived = 0
    for step in range(3000):
        if step % 12 == 0 and step < 2400:
            start = draw.choice(sources)
            end = draw.choice([t for t in sinks if t.getToNode() != start.getFromNode()])
            libsumo.route.add(f"r{step}", [start.getID(), end.getID()])
            libsumo.vehicle.add(f"v{step}", f"r{step}", departLane="best", departSpeed="max")
        libsumo.simulationStep()
        assert not libsumo.simulation.getCollisions(), libsumo.simulation.getCollisions()
        assert not libsumo.simulation.getStartingTeleportIDList()
        arrived += libsumo.simulation.getArrivedNumber()
    assert arrived >= 80  # of 200 sent in four minutes; the motorway takes more than two to cross
