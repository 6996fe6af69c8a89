"""A user's demand: when it begins, files that need each other, and which file a message names."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.core.errors import FileError, SceneError
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.demand_files import net_of_configuration, read_demand
from advdiff_sumo.sim.run_episodes import RunOptions, left_out
from advdiff_sumo.sim.seed_scene import SavedTraffic, SeedScene
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.warmup_scenes import NaturalTraffic
from advdiff_sumo.sweep.fingerprint import source_digest

SEVEN_S = 25_200
TYPES = '<routes><vType id="mine" length="7"/><route id="r" edges="WM ME"/></routes>'
SCENE = {
    "warmup_s": 10.0,
    "min_neighbours": 0,
    "min_route_m": 20.0,
    "min_speed_mps": 0.0,
    "scenes_per_warmup": 1,
}


@pytest.fixture(scope="module")
def road(street: Path) -> RoadMap:
    return RoadMap.read(street)


def cars(begin_s: int = SEVEN_S, count: int = 30, attributes: str = "") -> str:
    """Return a route file's content: a car every 3 s."""
    route = "" if "route=" in attributes else '<route edges="WM ME"/>'
    rows = (
        f'<vehicle id="v{k}" depart="{begin_s + 3 * k}" {attributes}>{route}</vehicle>' for k in range(count)
    )
    return f"<routes>{''.join(rows)}</routes>"


def files(folder: Path, **contents: str) -> Path:
    """Write NAME.rou.xml (NAME.add.xml for names that begin with "add") and a configuration; return the latter."""
    named: dict[str, list[str]] = {"rou": [], "add": []}
    for name, content in contents.items():
        kind = "add" if name.startswith("add") else "rou"
        (folder / f"{name}.{kind}.xml").write_text(content)
        named[kind].append(f"{name}.{kind}.xml")
    rows = (
        f'<route-files value="{",".join(named["rou"])}"/><additional-files value="{",".join(named["add"])}"/>'
    )
    path = folder / "all.sumocfg"
    path.write_text(f"<configuration><input>{rows}</input></configuration>")
    return path


def scene_of(road: RoadMap, demand: Path, **options: float) -> SeedScene:
    scene = SceneOptions.parse(SCENE | options)
    source = NaturalTraffic(road, read_demand(demand, road), scene, SimOptions(), 4.0, SeedTree(3))
    return source.batch(0)[0]


NAMED_ROUTES = "".join(f'<route id="r{k}" edges="WM ME"/>' for k in range(600))


@pytest.mark.parametrize(
    "content",
    [
        cars(),
        cars(attributes='route="r1"').replace("<routes>", f"<routes>{NAMED_ROUTES}"),
        cars().replace(f'"{SEVEN_S}"', '"7:00:00"'),
        cars().replace(
            "<routes>", '<routes><vehicle id="w" depart="triggered"><route edges="WM ME"/></vehicle>'
        ),
        f'<routes><flow id="f" begin="{SEVEN_S}" end="26000" period="3" from="WM" to="ME"/></routes>',
        f'<routes><person id="p" depart="{SEVEN_S}"><walk from="WM" to="ME"/></person>{cars(SEVEN_S + 1)[8:]}',
    ],
    ids=["seconds", "600 named routes first", "time of day", "somebody waits", "flow", "person first"],
)
def test_late_traffic_begins_with_its_first_departure(road: RoadMap, tmp_path: Path, content: str) -> None:
    (tmp_path / "late.rou.xml").write_text(content)
    assert read_demand(tmp_path / "late.rou.xml", road).begin_s == SEVEN_S
    start = scene_of(road, tmp_path / "late.rou.xml").start
    assert isinstance(start, SavedTraffic)
    assert start.time_s == SEVEN_S + SCENE["warmup_s"]


def test_a_configuration_says_when_the_simulation_begins(road: RoadMap, tmp_path: Path) -> None:
    path = files(tmp_path, a=cars(0, 200))
    early = read_demand(path, road)
    path.write_text(path.read_text().replace("</input>", '</input><time><begin value="0:05:00"/></time>'))
    late = read_demand(path, road)
    assert (early.begin_s, late.begin_s) == (0.0, 300.0)
    options = RunOptions(net=str(road.path), demand=str(path))
    assert source_digest(options, early) != source_digest(options, late)
    start = scene_of(road, path).start
    assert isinstance(start, SavedTraffic)
    assert start.time_s == 310.0


@pytest.mark.parametrize("first", ["types", "add_types"])
def test_files_that_need_each_other_are_judged_together(road: RoadMap, tmp_path: Path, first: str) -> None:
    path = files(tmp_path, **{first: TYPES, "cars": cars(attributes='type="mine" route="r"')})
    scene = scene_of(road, path)
    assert scene.history.size_m[scene.history.index[scene.target], 0] == 7.0


def test_vehicles_may_be_in_an_additional_file_alone(road: RoadMap, tmp_path: Path) -> None:
    assert scene_of(road, files(tmp_path, add_cars=cars())).target.startswith("v")


def test_the_file_with_the_vehicle_that_sumo_refuses_is_named(road: RoadMap, tmp_path: Path) -> None:
    second = cars(SEVEN_S + 1, attributes='type="none"').replace('id="v', 'id="w')
    path = files(tmp_path, first=cars(), second=second)
    refused = r"^\S*second\.rou\.xml: .*type 'none' for vehicle 'w0' is not known"
    with pytest.raises(
        SceneError, match=rf"{refused}.*; define it in this file, or give a \.sumocfg that names"
    ):
        scene_of(road, path)


def test_demand_that_sumo_refuses_for_another_reason_is_to_be_corrected(
    road: RoadMap, tmp_path: Path
) -> None:
    wrong = cars(SEVEN_S + 1, attributes='departSpeed="-5"').replace('id="v', 'id="w')
    with pytest.raises(
        SceneError, match=r"^\S*second\.rou\.xml: .*; correct the demand, or give other demand$"
    ):
        scene_of(road, files(tmp_path, first=cars(), second=wrong))


def test_the_file_of_another_net_is_named_though_the_first_one_fits(road: RoadMap, tmp_path: Path) -> None:
    path = files(tmp_path, first=cars(), second=cars().replace("WM ME", "A B"))
    with pytest.raises(SceneError, match=r"^\S*second\.rou\.xml: 30 of its first 30 routes"):
        read_demand(path, road)


def test_files_without_a_vehicle_are_named_by_their_configuration(road: RoadMap, tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"all\.sumocfg: holds no vehicle, trip or flow"):
        read_demand(files(tmp_path, types=TYPES, others=TYPES.replace("mine", "yours")), road)


def test_a_net_that_a_configuration_names_in_vain(tmp_path: Path) -> None:
    path = tmp_path / "all.sumocfg"
    path.write_text('<configuration><input><net-file value="gone.net.xml"/></input></configuration>')
    with pytest.raises(FileError, match=r"gone\.net\.xml: no such net; all\.sumocfg names it"):
        net_of_configuration(path)


@pytest.mark.parametrize(
    ("content", "options", "says"),
    [
        (
            cars(0, 300),
            {"min_route_m": 500.0},
            "all routes ahead were shorter.*longer routes, or lower scene.min_route_m and take a shorter horizon",
        ),
        (cars(0, 3), {"warmup_s": 100.0}, "no car was there .*goes on for longer, or lower scene.warmup_s"),
        (cars(0, 300), {"min_neighbours": 90}, "so many others near it.* lower scene.min_neighbours"),
        (
            cars(0, 300, 'type="cab"').replace("<routes>", '<routes><vType id="cab" vClass="taxi"/>'),
            {},
            "no car was of vClass passenger, as targets are .*: give cars a vType of vClass passenger",
        ),
    ],
    ids=["short routes", "over before", "alone", "taxis"],
)
def test_demand_that_gives_no_target_is_named_with_what_it_lacks(
    road: RoadMap, tmp_path: Path, content: str, options: dict[str, float], says: str
) -> None:
    path = tmp_path / "own.rou.xml"
    path.write_text(content)
    with pytest.raises(SceneError, match=rf"^\S*own\.rou\.xml: no vehicle with .*{says}") as raised:
        scene_of(road, path, **options)
    assert "density_per_km" not in str(raised.value)
    assert road.path.name not in str(raised.value)


@pytest.mark.parametrize(
    ("last", "unordered"),
    [
        ('<vehicle id="late" route="r" depart="10"/>', False),
        ('<vehicle id="late" route="r" depart="00:00:09"/>', True),
        ('<flow id="late" route="r" begin="0" end="99" period="9"/>', True),
        ('<person id="late" depart="triggered"/>', False),
    ],
)
def test_departures_that_sumo_leaves_out_are_noted(
    road: RoadMap, tmp_path: Path, last: str, unordered: bool
) -> None:
    path = tmp_path / "a.rou.xml"
    path.write_text(f'{TYPES[:-9]}<vehicle id="first" route="r" depart="10"/>{last}</routes>')
    notes = left_out(RunOptions(demand=str(path)), road, read_demand(path, road), None)
    problem = "'late' departs before one above it, so SUMO leaves it and all others out of order out"
    assert notes == ([f"{path.resolve()}: {problem}; sort the file by departure"] if unordered else [])
