"""Generated traffic, and demand files of users."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from pathlib import Path
from xml.etree.ElementTree import Element, parse

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from advdiff_sumo.core.errors import FileError, NetError, SceneError
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.demand import write_demand
from advdiff_sumo.sim.demand_files import read_demand
from advdiff_sumo.sim.session import Session, SessionOptions
from advdiff_sumo.sim.sim_options import SceneOptions
from advdiff_sumo.sim.training_windows.mixed_demand import WeightedStreets
from tests.sim import nets

SHIPPED = ("downtown", "downtown-left", "motorway")


def vehicles(path: Path) -> list[Element]:
    return parse(path).getroot().findall("vehicle")  # noqa: S314 - we wrote it a moment ago


def route_of(vehicle: Element) -> list[str]:
    route = vehicle.find("route")
    assert route is not None
    return route.get("edges", "").split()


def test_the_same_seed_writes_the_same_bytes(road: RoadMap, tmp_path: Path) -> None:
    made = [
        write_demand(road, SceneOptions(), 60.0, SeedTree(seed), tmp_path / name).read_bytes()
        for seed, name in ((7, "a"), (7, "b"), (8, "c"))
    ]
    assert made[0] == made[1] != made[2]


@pytest.mark.parametrize("name", SHIPPED)
def test_every_route_can_be_driven(networks: Path, tmp_path: Path, name: str) -> None:
    road = RoadMap.read(networks / f"{name}.net.xml")
    path = write_demand(road, SceneOptions(), 120.0, SeedTree(1), tmp_path / "a.rou.xml")
    kinds = {v.get("id"): v.get("vClass", "") for v in parse(path).getroot().iter("vType")}  # noqa: S314 - ours
    made = vehicles(path)
    assert len(made) > 20
    for vehicle in made:
        route = route_of(vehicle)
        graph = road.edge_graph(kinds[vehicle.get("type")])
        assert len(route) >= 2
        assert all(after in graph.successors[before] for before, after in pairwise(route))
    departs = [float(vehicle.get("depart", "")) for vehicle in made]
    assert departs == sorted(departs)
    assert departs[-1] <= 120.0


def test_density_is_vehicles_per_kilometre_of_lane(road: RoadMap, tmp_path: Path) -> None:
    lane_km = sum(e.length_m * len(e.lane_ids) for e in road.edges.values() if not e.is_internal) / 1000.0
    for density in (2.0, 4.0):
        options = SceneOptions(density_per_km=density, max_vehicles=10_000)
        path = write_demand(road, options, 10.0, SeedTree(1), tmp_path / "a.rou.xml")
        at_once = sum(v.get("departPos") == "random_free" for v in vehicles(path))
        assert at_once == pytest.approx(density * lane_km, rel=0.1, abs=2.0)
    bounded = SceneOptions(density_per_km=40.0, max_vehicles=12)
    path = write_demand(road, bounded, 10.0, SeedTree(1), tmp_path / "a.rou.xml")
    assert sum(v.get("departPos") == "random_free" for v in vehicles(path)) <= 12


def test_density_counts_lanes_for_cars_alone(tmp_path: Path) -> None:
    """Four edges of 200 m with one lane for cars, a sidewalk and one for bicycles: 20 per km of 0.8 km are 16."""
    nodes, edges = nets.STREET
    beside = '><lane index="0" allow="pedestrian"/><lane index="1" allow="bicycle"/></edge>'
    lanes = edges.replace('numLanes="2"', 'numLanes="3"').replace("/>", beside)
    road = RoadMap.read(nets.build(tmp_path, nodes, lanes, turnarounds=True))
    options = SceneOptions(density_per_km=20.0)
    path = write_demand(road, options, 10.0, SeedTree(1), tmp_path / "a.rou.xml")
    assert sum(v.get("departPos") == "random_free" for v in vehicles(path)) == pytest.approx(16, abs=1)
    assert WeightedStreets.of(road).lane_m == pytest.approx([200.0] * 4, abs=10.0)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_share_of_trucks(road: RoadMap, tmp_path: Path, share: float) -> None:
    options = SceneOptions(trucks_share=share)
    path = write_demand(road, options, 10.0, SeedTree(1), tmp_path / "a.rou.xml")
    heavy = Counter(v.get("type") in {"truck", "bus"} for v in vehicles(path))
    assert set(heavy) == {bool(share)}


def test_sumo_drives_it(road: RoadMap, tmp_path: Path) -> None:
    options = SceneOptions(max_vehicles=40)
    path = write_demand(road, options, 20.0, SeedTree(3), tmp_path / "a.rou.xml")
    with Session(SessionOptions(road.path, seed=1, routes=(path,))) as session:
        for _ in range(100):
            session.step()
        names = session.api.vehicle.getIDList()
        assert len(names) >= 0.8 * min(40, len(vehicles(path)))
        speeds = [session.api.vehicle.getSpeed(name) for name in names]
        assert sum(speed > 3.0 for speed in speeds) > 0.4 * len(speeds)


def test_a_net_in_which_nothing_is_connected(tmp_path: Path) -> None:
    nodes = '<nodes><node id="A" x="0" y="0"/><node id="B" x="100" y="0"/></nodes>'
    road = RoadMap.read(nets.build(tmp_path, nodes, '<edges><edge id="AB" from="A" to="B"/></edges>'))
    with pytest.raises(NetError, match="holds no drivable route; give a net in which edges are connected"):
        write_demand(road, SceneOptions(), 10.0, SeedTree(1), tmp_path / "a.rou.xml")


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31), density=st.floats(0.5, 20.0), duration_s=st.floats(1.0, 60.0))
def test_every_seed_gives_connected_routes(
    road: RoadMap, tmp_path_factory: pytest.TempPathFactory, seed: int, density: float, duration_s: float
) -> None:
    path = tmp_path_factory.mktemp("any") / "a.rou.xml"
    write_demand(road, SceneOptions(density_per_km=density), duration_s, SeedTree(seed), path)
    successors = road.edge_graph().successors
    ids = [vehicle.get("id") for vehicle in vehicles(path)]
    assert len(set(ids)) == len(ids) > 0
    for vehicle in vehicles(path):
        assert all(after in successors[before] for before, after in pairwise(route_of(vehicle)))


# --- demand of a user ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def plain_street(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    return RoadMap.read(nets.street(tmp_path_factory.mktemp("demand")))


def test_a_route_file(plain_street: RoadMap, tmp_path: Path) -> None:
    path = tmp_path / "a.rou.xml"
    path.write_text(
        '<routes><vehicle id="b" depart="12.5"><route edges="WM ME"/></vehicle>'
        '<trip id="a" depart="7" from="WM" to="ME"/></routes>'
    )
    found = read_demand(path, plain_street)
    assert (found.routes, found.additional, found.begin_s) == ((path,), (), 7.0)


def test_a_configuration_names_files_beside_it(plain_street: RoadMap, tmp_path: Path) -> None:
    sub = tmp_path / "sub"
    sub.mkdir()
    (sub / "a.rou.xml").write_text(
        '<routes><flow id="f" begin="3" end="9" number="2" from="WM" to="ME"/></routes>'
    )
    (sub / "b.rou.xml").write_text(
        '<routes><vehicle id="b" depart="5"><route edges="WM ME"/></vehicle></routes>'
    )
    (sub / "types.add.xml").write_text('<additional><vType id="slow" maxSpeed="3"/></additional>')
    detector = '<inductionLoop id="d" lane="WM_0" pos="5" period="60" file="out.xml"/>'
    (sub / "count.add.xml").write_text(f"<additional>{detector}</additional>")
    (sub / "all.sumocfg").write_text(
        '<configuration><input><route-files value="a.rou.xml,b.rou.xml"/>'
        '<additional-files value="types.add.xml, count.add.xml"/></input></configuration>'
    )
    found = read_demand(sub / "all.sumocfg", plain_street)
    assert [path.name for path in found.routes] == ["a.rou.xml", "b.rou.xml"]
    assert [path.name for path in found.additional] == ["types.add.xml"]  # detectors would write files
    assert found.begin_s == 3.0


def test_a_few_foreign_routes_are_no_other_net(plain_street: RoadMap, tmp_path: Path) -> None:
    trip = '<trip id="{}" depart="0" from="{}" to="ME"/>'
    path = tmp_path / "a.rou.xml"
    path.write_text(f"<routes>{trip.format('a', 'WM')}{trip.format('b', 'gone')}</routes>")
    assert read_demand(path, plain_street).begin_s == 0.0
    path.write_text(f"<routes>{trip.format('a', 'gone')}{trip.format('b', 'gone')}</routes>")
    with pytest.raises(
        SceneError, match=r"2 of its first 2 routes use edges that street\.net\.xml does not have"
    ):
        read_demand(path, plain_street)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("<routes/>", "holds no vehicle, trip or flow with a route"),
        ("<routes><trip", "not well-formed XML .*line 1.*export it again"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><routes>&b;</routes>', "not well-formed XML"),
    ],
)
def test_files_that_are_no_demand(plain_street: RoadMap, tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "a.rou.xml"
    path.write_text(text)
    with pytest.raises(FileError, match=says):
        read_demand(path, plain_street)
