"""Rare but valid nets and demand: links without signal at a light, railways, "<" in ids, gzip, lanes for buses."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.errors import FileError, NotInsertedError
from advdiff_sumo.core.record import Controller
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.actuate import Actuator
from advdiff_sumo.sim.demand import write_demand
from advdiff_sumo.sim.demand_files import DemandFiles, read_demand
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.warmup_scenes import NaturalTraffic
from advdiff_sumo.sim.world import World
from tests.sim import nets
from tests.sim.nets import LENGTH_M, WIDTH_M, stage
from tests.sim.scenes import episode

SCENE = {
    "warmup_s": 10.0,
    "min_neighbours": 0,
    "min_route_m": 20.0,
    "density_per_km": 20.0,
    "min_speed_mps": 0.0,
}


def rewritten(net: Path, old: str, new: str) -> Path:
    """Write *net* beside itself with every match of a pattern *old* replaced."""
    text, changes = re.subn(old, new, net.read_text())
    assert changes
    out = net.with_name(f"rewritten-{net.name}")
    out.write_text(text)
    return out


def natural_scene(road: RoadMap, demand: DemandFiles | None = None) -> SeedScene:
    """Return a seed scene of natural traffic on a small net."""
    options = SceneOptions.parse({**SCENE, "scenes_per_warmup": 1})
    return NaturalTraffic(road, demand, options, SimOptions(), 4.0, SeedTree(3)).batch(0)[0]


def test_a_link_that_its_light_leaves_alone_has_no_signal(tmp_path: Path) -> None:
    """Its linkIndex is −1, which would read the last letter of the state string, that of another link."""
    net = rewritten(
        nets.crossing(tmp_path, "traffic_light"), r'linkIndex="\d+"(?= dir="s")', 'linkIndex="-1"'
    )
    road = RoadMap.read(net)
    straight, turn = road.links["WC_0", "CE_0"], road.links["WC_0", "CS_0"]
    assert (straight.tls_id, straight.tls_index) == (None, None)
    assert turn.tls_index is not None
    assert turn.tls_index >= 0
    red = {str(turn.tls_id): "r" * 12}
    assert (straight.signal(red), turn.signal(red)) == ("", "r")
    assert all(index >= 0 for _, index in road.pieces().signal_links)


def test_ids_that_xml_must_escape_come_through_a_saved_state(tmp_path: Path) -> None:
    road = RoadMap.read(rewritten(nets.crossing(tmp_path), "WC", "W&lt;C&amp;"))
    assert "W<C&" in road.edges
    record, _ = episode(natural_scene(road), road, "IDM", horizon_s=3.0).run()
    assert record.failure is None
    assert record.tracks.steps == 31


@pytest.mark.parametrize("situation", ["any", "yellow"])
def test_a_railway_signal_has_no_phases(tmp_path: Path, situation: str) -> None:
    """It is listed among the traffic lights; cars at the crossing with lights are found all the same."""
    nodes = nets.CROSSING[0].format(kind="traffic_light")
    rails = "".join(
        f'<node id="{name}" x="{x}" y="400"{kind}/>'
        for name, x, kind in (("R", -150, ""), ("T", 0, ' type="rail_signal"'), ("U", 150, ""))
    )
    tracks = '<edge id="RT" from="R" to="T" allow="rail"/><edge id="TU" from="T" to="U" allow="rail"/>'
    with_rails = nodes.replace("</nodes>", f"{rails}</nodes>")
    path = nets.build(
        tmp_path, with_rails, nets.CROSSING[1].replace("</edges>", f"{tracks}</edges>"), name="rail"
    )
    road = RoadMap.read(path)
    options = SceneOptions.parse({**SCENE, "scenes_per_warmup": 1, "situation": situation})
    (scene,) = NaturalTraffic(road, None, options, SimOptions(), 4.0, SeedTree(3)).batch(0)
    assert road.edges[scene.routes[scene.target][0]].to_junction == "C"


def test_gzipped_demand_is_read_and_a_truncated_one_is_named(crossing: Path, tmp_path: Path) -> None:
    road = RoadMap.read(crossing)
    plain = write_demand(road, SceneOptions.parse(SCENE), 60.0, SeedTree(1), tmp_path / "plain.rou.xml")
    zipped = tmp_path / "zipped.rou.xml.gz"
    zipped.write_bytes(gzip.compress(plain.read_bytes(), mtime=0))
    scenes = [natural_scene(road, read_demand(path, road)) for path in (plain, zipped)]
    assert scenes[0].history.ids == scenes[1].history.ids
    np.testing.assert_array_equal(scenes[0].log.xy_m, scenes[1].log.xy_m)
    zipped.write_bytes(zipped.read_bytes()[:200])
    with pytest.raises(FileError, match="gzip data are cut off or damaged"):
        read_demand(zipped, road)


def test_additional_files_of_a_configuration_that_only_write_are_named(
    crossing: Path, tmp_path: Path
) -> None:
    road = RoadMap.read(crossing)
    write_demand(road, SceneOptions.parse(SCENE), 60.0, SeedTree(1), tmp_path / "d.rou.xml")
    (tmp_path / "types.add.xml").write_text('<additional><vType id="mine"/></additional>')
    (tmp_path / "loops.add.xml").write_text(
        '<additional><e1Detector id="e" lane="WC_0" pos="1" period="1" file="x"/></additional>'
    )
    configuration = tmp_path / "a.sumocfg"
    configuration.write_text(
        '<configuration><input><route-files value="d.rou.xml"/>'
        '<additional-files value="types.add.xml,loops.add.xml"/></input></configuration>'
    )
    files = read_demand(configuration, road)
    assert [file.name for file in files.additional] == ["types.add.xml"]
    assert [file.name for file in files.ignored] == ["loops.add.xml"]


def buses_westbound(folder: Path) -> Path:
    """The net of :func:`nets.street`, westbound for buses only."""
    edges = re.sub(r'(id="(?:EM|MW)"[^/]*)/', r'\1 allow="bus"/', nets.STREET[1])
    return nets.build(folder, nets.STREET[0], edges, name="buses")


@pytest.mark.parametrize(
    ("agent_class", "edges"), [(AgentClass.CAR, ("WM", "ME")), (AgentClass.BUS, ("EM", "MW"))]
)
def test_a_vehicle_is_inserted_on_a_lane_that_is_open_to_it(
    tmp_path: Path, agent_class: AgentClass, edges: tuple[str, str]
) -> None:
    net = buses_westbound(tmp_path)
    with stage(net) as s:
        actuator, row = placed(s.api, net, agent_class)
        vtype = "car" if agent_class == AgentClass.CAR else "bus"
        if vtype == "bus":
            s.api.vehicletype.copy("car", "bus")
            s.api.vehicletype.setVehicleClass("bus", "bus")
        actuator.insert(row, vtype)
        s.session.step()
        assert s.api.vehicle.getRoadID("b") in edges


def test_a_vehicle_that_sumo_refuses_stays_outside_and_is_counted(tmp_path: Path) -> None:
    """A car on lanes for buses only: the vType decides whether SUMO accepts it, whatever its class is here."""
    net = buses_westbound(tmp_path)
    with stage(net) as s:
        actuator, row = placed(s.api, net, AgentClass.BUS)
        with pytest.raises(NotInsertedError, match="SUMO refuses to insert 'b'"):
            actuator.insert(row, "car")
        actuator.try_insert(row, "car")
        assert actuator.refused == actuator.outside == {row}
        assert not actuator.moved
        s.session.step()
        assert s.api.vehicle.getIDList() == ()


def placed(api: object, net: Path, agent_class: AgentClass) -> tuple[Actuator, int]:
    """Return an actuator with one row on the westbound half of the street."""
    actuator = Actuator(api, World(), RoadMap.read(net))
    row = actuator.world.add("b", agent_class, LENGTH_M, WIDTH_M)
    where = np.array([[150.0, 1.6]])
    actuator.world.set_state(np.array([row]), where, np.array([np.pi]), np.array([5.0]), Controller.POLICY)
    return actuator, row
