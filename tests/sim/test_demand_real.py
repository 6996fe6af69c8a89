"""Traffic on nets from elsewhere: with their own demand, and with generated demand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.demand_files import read_demand
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.warmup_scenes import NaturalTraffic

pytestmark = pytest.mark.data

BOLOGNA, BOSTON, ONENORTH = (
    "bologna-acosta/acosta_buslanes.net.xml",
    "drivearena-boston-seaport/osm.net.xml",
    "drivearena-singapore-onenorth/osm.net.xml",
)


@pytest.mark.parametrize(
    ("net", "demand"),
    [
        (BOLOGNA, "run.sumocfg"),
        (BOSTON, "osm.rou.xml"),
        (ONENORTH, "osm.rou.xml"),
        (BOLOGNA, ""),
        (ONENORTH, ""),
    ],
)
def test_a_scene_comes_out_of_it(adv_data: Path, net: str, demand: str) -> None:
    path = adv_data / "sumo" / net
    before = sorted(path.parent.iterdir())
    road = RoadMap.read(path)
    files = read_demand(path.parent / demand, road) if demand else None
    options = SceneOptions(warmup_s=30.0, scenes_per_warmup=1, min_neighbours=1, density_per_km=3.0)
    source = NaturalTraffic(road, files, options, SimOptions(), 2.0, SeedTree(0))
    (scene,) = source.batch(0)
    history, row = scene.history, scene.history.index[scene.target]
    assert history.classes[row] == AgentClass.CAR
    assert history.valid[row].all()
    assert history.agents >= 2
    gap = np.linalg.norm(history.xy_m[:, -1] - history.xy_m[row, -1], axis=-1)
    assert np.sort(gap)[1] < 50.0
    lane = road.locate(history.xy_m[row, -1], float(history.yaw_rad[row, -1]))
    assert lane is not None
    assert scene.routes[scene.target]
    assert (
        sorted(path.parent.iterdir()) == before
    )  # SUMO's detectors and outputs write nothing beside the net
