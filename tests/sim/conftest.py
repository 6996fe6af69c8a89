"""Fixtures: the tiny nets, and a scene on the shipped downtown, each made once."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.warmup_scenes import NaturalTraffic
from tests.sim import nets


@pytest.fixture(scope="session")
def road(networks: Path) -> RoadMap:
    """The shipped downtown."""
    return RoadMap.read(networks / "downtown.net.xml")


@pytest.fixture(scope="session")
def scene(road: RoadMap) -> SeedScene:
    """SUMO traffic on the downtown, for episodes of up to 8 s."""
    options = SceneOptions.parse({"warmup_s": 15.0, "scenes_per_warmup": 1})
    return NaturalTraffic(road, None, options, SimOptions.parse({}), 8.0, SeedTree(3)).batch(0)[0]


@pytest.fixture(scope="session")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The net of :func:`nets.street`."""
    return nets.street(tmp_path_factory.mktemp("street"))


@pytest.fixture(scope="session")
def crossing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The net of :func:`nets.crossing` with a priority road."""
    return nets.crossing(tmp_path_factory.mktemp("crossing"))


@pytest.fixture(scope="session")
def unregulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The net of :func:`nets.crossing` without any right of way."""
    return nets.crossing(tmp_path_factory.mktemp("unregulated"), "unregulated")


@pytest.fixture(scope="session")
def bend(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The net of :func:`nets.bend`."""
    return nets.bend(tmp_path_factory.mktemp("bend"))
