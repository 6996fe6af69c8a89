"""Converted nuScenes maps and shipped nets: round trips, and other people's programs on what is exported there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.data import ScenarioNetReader
from advdiff_sumo.data.pickles import load_plain
from advdiff_sumo.export import EXPORTERS, ExportScene, import_scene, make_exporter
from advdiff_sumo.export.export_check import HEADING_RAD, POSITION_M, compare
from advdiff_sumo.export.lane_use import LaneKind, lane_kind
from advdiff_sumo.export.net_opendrive import plan_of
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.convert import convert_map
from advdiff_sumo.maps.convert.sources.scenarionet_map import read_record_map
from advdiff_sumo.metrics.criticality import time_to_collision
from advdiff_sumo.metrics.following import following_gaps
from tests.export.drives import STEPS, junction_traffic
from tests.export.outside import CommonRoadReader, netconverted, played, quality, same_obstacles, states_of

FORMATS = tuple(EXPORTERS.builtins)
TTC_STEPS = (0, 5, 10, 20)
CONVERTED = {
    "singapore-onenorth": [pytest.mark.data, pytest.mark.slow],  # left-hand
    "boston-seaport": [pytest.mark.data, pytest.mark.slow, pytest.mark.nightly],  # right-hand
}
SHIPPED = ("motorway", "downtown-left")


@dataclass(frozen=True)
class Place:
    """Traffic on a net, and the files of every format."""

    scene: ExportScene
    files: dict[str, tuple[Path, ...]]

    @property
    def folder(self) -> Path:
        """Where the files are."""
        return self.files["csv"][0].parent


@pytest.fixture(
    scope="module",
    params=[
        *(pytest.param(name, marks=marks) for name, marks in CONVERTED.items()),
        *SHIPPED,
    ],
)
def place(request: pytest.FixtureRequest, networks: Path, tmp_path_factory: pytest.TempPathFactory) -> Place:
    """Traffic at a junction of each net, a converted one converted now."""
    folder = tmp_path_factory.mktemp(request.param)
    net = networks / f"{request.param}.net.xml"
    if request.param in CONVERTED:
        maps = request.getfixturevalue("adv_data") / "nuscenes-mini" / "maps" / "expansion"
        net = convert_map(maps / f"{request.param}.json", folder / net.name).net
    scene = junction_traffic(RoadMap.read(net))
    assert set(scene.tracks.classes) == {int(kind) for kind in AgentClass}
    return Place(scene, {name: make_exporter(name).write(scene, folder) for name in FORMATS})


@pytest.mark.parametrize("name", FORMATS)
def test_everybody_comes_back(name: str, place: Place) -> None:
    assert list(compare(import_scene(place.files[name][0]), place.scene)) == []


def test_commonroad_reads_everybody_and_agrees_on_ttc(place: Place, commonroad: CommonRoadReader) -> None:
    """commonroad-crime rounds to 0.01 s; the target closes in at 8 m/s on a gap of 25 − 4.6 m."""
    found = commonroad(place.files["commonroad"][0], *TTC_STEPS)
    scene, steps = place.scene, list(TTC_STEPS)
    same_obstacles(found, scene)
    lanes = {lane.id for lane in scene.lanes if lane_kind(lane) is not LaneKind.OTHER}
    assert found["lanelets"] == len(lanes)
    assert found["links"] == len(scene.joints(lanes)) > 0
    ours = time_to_collision(scene.tracks, scene.target)[0, steps]
    lane = following_gaps(scene.tracks, scene.target, scene.road, ()).time_to_collision()[0, steps]
    assert ours == pytest.approx([20.4 / 8.0 - 0.1 * step for step in steps], abs=1e-3)
    assert lane == pytest.approx(ours, abs=1e-3)
    assert found["ttc"] == pytest.approx(ours, abs=0.01)


def test_the_checkers_of_asam_find_nothing(place: Place, tmp_path: Path) -> None:
    story, roads = place.files["openscenario"]
    assert quality("qc_openscenario", "xoscBundle", story, tmp_path) == []
    assert quality("qc_opendrive", "xodrBundle", roads, tmp_path) == []


def test_netconvert_reads_the_roads(place: Place, tmp_path: Path) -> None:
    again = netconverted(place.files["openscenario"][1], tmp_path)
    plan = plan_of(place.scene.road)
    assert len(again.getEdges()) == sum(len(edge.lanes) for edge in plan.edges)
    assert sum(len(edge.getOutgoing()) for edge in again.getEdges()) == len(plan.connections)


def test_the_record_is_a_log_and_a_map(place: Place) -> None:
    path, scene = place.files["scenarionet"][0], place.scene
    log = ScenarioNetReader(place.folder).read(path.stem)
    assert log.tracks.ids[log.ego] == "target"
    source = read_record_map(load_plain(path), path)
    kept = {lane.id for lane in scene.lanes if lane_kind(lane) not in (LaneKind.FOOT, LaneKind.OTHER)}
    assert len(source.lanes) == len(kept)
    assert len(source.links) == len(scene.joints(kept))


def test_sumo_plays_the_configuration(place: Place) -> None:
    """Drivers are where and when the data have them from their second instant on (docs/exports.md on the rest)."""
    data, _, config, _ = place.files["fcd"]
    written, there = states_of(data), played(config)
    first = dict(reversed(written))
    walker = f"agent_{place.scene.tracks.index['on foot']}"
    driven = [(name, time) for name, time in written if name != walker and time > first[name]]
    for key in driven:
        assert np.hypot(*np.subtract(there[key][:2], written[key][:2])) <= POSITION_M, key
        assert abs(wrap_angle(np.deg2rad(there[key][2] - written[key][2]))) <= HEADING_RAD, key
    assert len(driven) == place.scene.tracks.valid.sum() - STEPS - len(first) + 1 > 5 * STEPS
