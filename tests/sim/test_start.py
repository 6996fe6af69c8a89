"""What is changed in a saved state before an episode starts from it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from defusedxml.ElementTree import fromstring

from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.planner_registry import make_target
from advdiff_sumo.sim.seed_scene import SavedTraffic, SeedScene
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.start import prepare
from advdiff_sumo.sim.warmup_scenes import NaturalTraffic

ADVICES = b'lcStateBase="266.000000000 1.738873068 524288.000000000 1.738873068 524288.000000000"'


@pytest.fixture(scope="module")
def scene(networks: Path) -> SeedScene:
    road = RoadMap.read(networks / "downtown.net.xml")
    options = SceneOptions.parse({"warmup_s": 15.0, "scenes_per_warmup": 1})
    return NaturalTraffic(road, None, options, SimOptions.parse({}), 4.0, SeedTree(3)).batch(0)[0]


def test_speed_advices_are_left_out_and_flags_kept(scene: SeedScene, tmp_path: Path) -> None:
    start = scene.start
    assert isinstance(start, SavedTraffic)
    first = start.state_xml.index(b'lcStateBase="')
    last = start.state_xml.index(b'"', first + len(b'lcStateBase="')) + 1
    advised = replace(start, state_xml=start.state_xml[:first] + ADVICES + start.state_xml[last:])
    made = prepare(replace(scene, start=advised), make_target("IDM", {}), SimOptions.parse({}), tmp_path)
    assert made.options.load_state is not None
    vehicles = fromstring(made.options.load_state.read_bytes()).findall(".//vehicle[@lcStateBase]")
    states = [vehicle.get("lcStateBase", "") for vehicle in vehicles]
    assert "266.000000000" in states
    assert all(len(state.split()) == 1 for state in states)
