"""Pedestrians in SUMO's traffic: their trips, their states in the world, and who sees them."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import libsumo
import numpy as np
import pytest
from defusedxml.ElementTree import parse
from shapely.geometry import LineString

from advdiff_sumo.core.errors import NetError
from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.record import Controller, EndReason, EpisodeRecord
from advdiff_sumo.core.scene import AgentClass, Scene, Tracks
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.convert import convert_source
from advdiff_sumo.maps.convert.sources.read_map import read_map
from advdiff_sumo.maps.on_foot.add_paths import add_foot_paths
from advdiff_sumo.maps.on_foot.footways import read_footways
from advdiff_sumo.maps.read_net import shape_of
from advdiff_sumo.metrics.background_metrics import compare_with_sumo
from advdiff_sumo.metrics.collision import collisions
from advdiff_sumo.models.view import look
from advdiff_sumo.sim.demand import write_demand
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.sumo_perception import visible_ids
from advdiff_sumo.sim.warmup_scenes import NaturalTraffic
from advdiff_sumo.sim.world import World, read, register
from tests.sim.scenes import episode

PER_KM = 60.0


@pytest.fixture(scope="module")
def net(crossing: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fast street crosses a slower one; each arm of the slower one has a crossing."""
    path = tmp_path_factory.mktemp("people") / "crossing.net.xml"
    shutil.copy(crossing, path)
    assert add_foot_paths(path, [], guess=True).kept == 2
    return path


@pytest.fixture(scope="module")
def road(net: Path) -> RoadMap:
    return RoadMap.read(net)


def options(**values: float) -> SceneOptions:
    return SceneOptions.parse({"pedestrians_per_km": PER_KM, **values})


def test_sidewalks_hang_together_over_crossings(net: Path) -> None:
    ways = read_footways(net)
    assert set(ways.part.tolist()) == {0, 1}  # nothing leads over the fast street
    assert all(name.startswith("walk") for name in ways.edges)
    lanes = {lane.get("id"): lane for lane in parse(net).getroot().iter("lane")}
    lengths = [float(lanes[f"{name}_0"].get("length", "")) for name in ways.edges]
    np.testing.assert_allclose(ways.length_m, lengths, atol=0.01)


def test_the_density_of_people_is_kept(road: RoadMap, net: Path, tmp_path: Path) -> None:
    """60 per km at the beginning, and as many again every 200 s."""
    path = write_demand(road, options(), 100.0, SeedTree(1), tmp_path / "d.rou.xml")
    people = list(parse(path).getroot().iter("person"))
    present = round(PER_KM * read_footways(net).length_m.sum() / 1000.0)
    assert sum(person.get("depart") == "0.0" for person in people) == present
    assert len(people) == present + round(present * 100.0 / 200.0)
    departs = [float(row.get("depart", "")) for row in parse(path).getroot() if row.tag != "vType"]
    assert departs == sorted(departs)


def test_without_the_option_demand_is_as_it_was(road: RoadMap, crossing: Path, tmp_path: Path) -> None:
    """The vehicles of a net are the same with pedestrians, without them, and without sidewalks."""
    texts = []
    for number, (place, per_km) in enumerate(((road, PER_KM), (road, 0.0), (RoadMap.read(crossing), 0.0))):
        path = tmp_path / f"{number}.rou.xml"
        write_demand(place, options(pedestrians_per_km=per_km), 60.0, SeedTree(1), path)
        rows = parse(path).getroot().iter("vehicle")
        texts.append([(row.attrib, row.find("route").attrib) for row in rows])
    assert texts[0] == texts[1] == texts[2]


def test_people_on_a_net_without_sidewalks_are_one_sentence(crossing: Path, tmp_path: Path) -> None:
    with pytest.raises(
        NetError, match=r"has no sidewalks with crossings for people on foot; convert it with"
    ):
        write_demand(RoadMap.read(crossing), options(), 60.0, SeedTree(1), tmp_path / "d.rou.xml")


def test_the_world_holds_people_while_they_walk(net: Path) -> None:
    """A person and a vehicle may have the same name. SUMO's position is the front of the body, ours its centre."""
    ways = read_footways(net).edges
    world = World()
    libsumo.start(["sumo", "-n", str(net), "--no-step-log", "--step-length", "0.1"])
    try:
        libsumo.person.add("same", ways[0], 0.0)
        libsumo.person.appendWalkingStage("same", [ways[0]], 10.0)
        edge = next(name for name in libsumo.edge.getIDList() if not name.startswith((":", "walk")))
        libsumo.route.add("r", [edge])
        libsumo.vehicle.add("same", "r")
        there = []
        for _ in range(200):
            libsumo.simulationStep()
            register(world, libsumo, libsumo.simulation.getDepartedIDList())
            world.remove(read(world, libsumo, ()))
            row = world.row_of("person.same")
            there.append(row is not None and bool(world.frame().present[row]))
            if there[-1] and row is not None:
                front = np.array(libsumo.person.getPosition("same"))
                assert world.classes[row] == AgentClass.PEDESTRIAN
                assert np.linalg.norm(front - world.xy_m[row]) == pytest.approx(0.5 * world.size_m[row, 0])
        assert there[0]
        assert not there[-1]
        assert world.on_foot == set()
        assert world.row_of("same") != world.row_of("person.same")
    finally:
        libsumo.close()


@pytest.fixture(scope="module")
def scene(road: RoadMap) -> SeedScene:
    wanted = options(
        warmup_s=15.0, scenes_per_warmup=1, min_route_m=20.0, min_neighbours=0, density_per_km=20.0
    )
    return NaturalTraffic(road, None, wanted, SimOptions.parse({}), 4.0, SeedTree(3)).batch(0)[0]


class Grasping:
    """A policy that tries to move all road users."""

    everywhere = True

    def start(self, road: RoadMap, scene: Scene, log: Tracks, rng: np.random.Generator) -> None:
        assert AgentClass.PEDESTRIAN not in log.classes

    def plan(
        self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator
    ) -> tuple[JointPlan, Any]:
        assert AgentClass.PEDESTRIAN in scene.history.classes  # policies see them
        assert not scene.movable[scene.history.classes == AgentClass.PEDESTRIAN].any()
        rows = [row for row in range(scene.history.agents) if row != scene.target]
        now = scene.history.rows(rows)
        still = replace(
            now,
            **{
                name: np.repeat(getattr(now, name)[:, -1:], 10, axis=1)
                for name in ("xy_m", "yaw_rad", "speed_mps", "valid")
            },
            t0_s=scene.time_s + 0.1,
            dt_s=0.1,
        )
        return JointPlan(still, exact=True), None


def test_people_walk_in_an_episode_as_fast_as_before_it(scene: SeedScene, road: RoadMap) -> None:
    """At 1.1 to 1.6 m/s, also those that SUMO has from the saved state."""
    tracks = episode(scene, road, horizon_s=4.0).run()[0].tracks
    before = scene.history.speed_mps[scene.history.classes == AgentClass.PEDESTRIAN]
    during = tracks.speed_mps[tracks.classes == AgentClass.PEDESTRIAN]
    for speed_mps in (before, during):
        assert len(speed_mps) > 5
        assert 0.9 < np.nanmedian(speed_mps) < 1.5
        assert np.nanmax(speed_mps) <= 1.7


@pytest.mark.parametrize("background", ["sumo", "replay", "grasping"])
def test_people_walk_by_themselves_in_an_episode(background: str, scene: SeedScene, road: RoadMap) -> None:
    policy: Any = Grasping() if background == "grasping" else background
    record = episode(scene, road, target="lane_graph", background=policy, horizon_s=4.0).run()[0]
    assert record.failure is None
    walks = record.tracks.classes == AgentClass.PEDESTRIAN
    assert walks.sum() >= 5
    who = record.controller[walks]
    assert set(who[record.tracks.valid[walks]].tolist()) == {Controller.SUMO}
    moved = np.nanmax(
        np.linalg.norm(record.tracks.xy_m[walks] - record.tracks.xy_m[walks][:, :1], axis=-1), axis=1
    )
    assert np.nanmax(moved) > 2.0  # they walk on from the saved state
    both = np.intersect1d(scene.log.ids, [n for n, w in zip(record.tracks.ids, walks, strict=True) if w])
    assert len(both) >= 5


def test_the_learned_models_see_people(scene: SeedScene, road: RoadMap) -> None:
    """They are in the scene's tensor as pedestrians, and get no plan."""
    agents = scene.history.agents
    target = scene.history.index[scene.target]
    near = np.linalg.norm(scene.history.xy_m[:, -1] - scene.history.xy_m[target, -1], axis=-1) < 60.0
    now = Scene(scene.history, target, near, ((),) * agents, {})
    view = look(road, now)
    walks = view.batch.classes[0].numpy() == AgentClass.PEDESTRIAN
    assert walks.sum() == (scene.history.classes[view.rows] == AgentClass.PEDESTRIAN).sum() > 0
    assert view.batch.present[0].numpy()[walks].all()
    assert not view.batch.moved[0].numpy()[walks].any()
    assert not view.moved[walks].any()


def test_a_driver_of_sumo_sees_people_on_the_crossing_ahead(net: Path) -> None:
    root = parse(net).getroot()
    row = next(e for e in root.iter("edge") if e.get("function") == "crossing")
    name = row.get("id", "")
    shapes = {lane.get("id"): LineString(shape_of(lane)) for lane in root.iter("lane") if lane.get("shape")}
    origin = next(
        c
        for c in root.iter("connection")
        if c.get("via") and c.get("dir") == "s" and shapes[c.get("via")].crosses(shapes[f"{name}_0"])
    )
    ends = [c for c in root.iter("connection") if name in (c.get("from"), c.get("to"))]
    areas = {c.get("from") if c.get("to") == name else c.get("to") for c in ends}
    doors = [
        c.get("to")
        for c in root.iter("connection")
        if c.get("from") in areas and c.get("to", "").startswith("walk")
    ]
    libsumo.start(["sumo", "-n", str(net), "--no-step-log", "--step-length", "0.1", "--no-warnings"])
    try:
        libsumo.route.add("on", [origin.get("from", ""), origin.get("to", "")])
        libsumo.vehicle.add("car", "on", departPos="last", departSpeed="0")
        for start in doors:
            for end in doors:
                libsumo.person.add(f"{start}-{end}", start, 0.0)
                libsumo.person.appendWalkingStage(f"{start}-{end}", [start, end], -1)
        looked = 0
        for _ in range(300):
            libsumo.simulationStep()
            if "car" not in libsumo.vehicle.getIDList():
                break
            libsumo.vehicle.setSpeed("car", 0.0)
            crossing = {f"person.{p}" for p in libsumo.edge.getLastStepPersonIDs(name)}
            assert crossing <= visible_ids(libsumo, "car")
            looked += bool(crossing)
        assert looked
    finally:
        libsumo.close()


def two(classes: tuple[AgentClass, AgentClass], who: Controller) -> EpisodeRecord:
    """Return a record of two pedestrians half a metre long that walk through each other, moved by *who*."""
    t = np.arange(12) * 0.1
    x = np.stack((t, 1.0 - t))
    tracks = Tracks(
        ids=("a", "b"),
        classes=np.array(classes),
        size_m=np.full((2, 2), 0.5),
        xy_m=np.stack((x, np.zeros_like(x)), axis=-1),
        yaw_rad=np.array([[0.0], [np.pi]]).repeat(12, axis=1),
        speed_mps=np.ones((2, 12)),
        valid=np.ones((2, 12), dtype=np.bool_),
        t0_s=0.0,
        dt_s=0.1,
    )
    return EpisodeRecord(0, 0, "", tracks, 0, np.full((2, 12), who), (), EndReason.HORIZON)


@pytest.mark.parametrize(
    ("classes", "who", "hits"),
    [
        ((AgentClass.PEDESTRIAN, AgentClass.PEDESTRIAN), Controller.SUMO, 0),
        ((AgentClass.PEDESTRIAN, AgentClass.PEDESTRIAN), Controller.REPLAYED, 1),
        ((AgentClass.CAR, AgentClass.PEDESTRIAN), Controller.SUMO, 1),
    ],
)
def test_people_of_sumo_pass_through_each_other_and_are_hit_by_cars(
    classes: tuple[AgentClass, AgentClass], who: Controller, hits: int
) -> None:
    record = two(classes, who)
    assert len(collisions(record)) == hits
    assert (compare_with_sumo(record).ours_only > 0) == bool(hits)


def behind_front_m(vehicle: str, person: str) -> float:
    """Return how far the person is behind the vehicle's front bumper, along the vehicle."""
    yaw = np.deg2rad(90.0 - libsumo.vehicle.getAngle(vehicle))
    gap = np.subtract(libsumo.vehicle.getPosition(vehicle), libsumo.person.getPosition(person))
    return float(gap @ (np.cos(yaw), np.sin(yaw)))


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["singapore-onenorth", pytest.param("singapore-queenstown", marks=pytest.mark.nightly)]
)
def test_ten_minutes_of_people_and_cars_on_a_converted_map(name: str, adv_data: Path, tmp_path: Path) -> None:
    """No vehicle runs into a pedestrian, none is teleported, and no trip leaves the net.

    A pedestrian may touch the flank of a vehicle that is already turning over the crossing.
    """
    source = read_map(adv_data / "nuscenes-mini" / "maps" / "expansion" / f"{name}.json")
    net = convert_source(source, tmp_path / f"{name}.net.xml", crossings="guess").net
    demand = SceneOptions.parse({"pedestrians_per_km": 10.0, "density_per_km": 4.0})
    path = write_demand(RoadMap.read(net), demand, 480.0, SeedTree(1), tmp_path / "d.rou.xml")
    messages = tmp_path / "messages.txt"
    libsumo.start(
        [
            *("sumo", "-n", str(net), "-r", str(path), "--no-step-log", "--step-length", "0.1"),
            *("--collision.action", "warn", "--collision.check-junctions", "true"),
            *(
                "--collision.mingap-factor",
                "0",
                "--lateral-resolution",
                "0.4",
                "--message-log",
                str(messages),
            ),
        ]
    )
    crossed, run_over, teleports = 0, [], 0
    known: set[tuple[str, str]] = set()
    try:
        for step in range(6000):
            libsumo.simulationStep()
            for hit in libsumo.simulation.getCollisions():
                pair = (hit.collider, hit.victim)
                if pair not in known and not (hit.type == "crossing" and behind_front_m(*pair) > 1.0):
                    run_over.append((*pair, hit.lane))
                known.add(pair)
            teleports += libsumo.simulation.getStartingTeleportNumber()
            if step % 50 == 0:
                crossed += sum("_c" in libsumo.person.getRoadID(p) for p in libsumo.person.getIDList())
    finally:
        libsumo.close()
    assert crossed > 50
    assert run_over == []
    assert len(known) <= 1
    assert teleports == 0
    assert "could not find route" not in messages.read_text()
