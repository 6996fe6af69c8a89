"""What SUMO's drivers know of a target that leaves its route at a junction, with the real SUMO."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.plan import Controls
from advdiff_sumo.core.scene import AgentClass, Scene
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.data.log_reader import LogScene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.logs import LoggedTraffic
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from tests.export.drives import straight, tracks_of
from tests.sim import nets
from tests.sim.scenes import episode, running


class Onward:
    """Plans *seconds* straight on at constant speed, regardless of its route."""

    def __init__(self, seconds: float) -> None:
        self.steps = round(seconds / 0.1)

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> None:
        """Remember nothing."""

    def plan(
        self, road: RoadMap, scene: Scene, memory: None, rng: np.random.Generator
    ) -> tuple[Controls, None]:
        return Controls(np.zeros(self.steps), np.zeros(self.steps), 0.1), None


@dataclass(frozen=True)
class OneScene:
    """A log of one drive."""

    scene: LogScene

    def names(self) -> list[str]:
        return [self.scene.name]

    def read(self, name: str) -> LogScene:
        return self.scene

    def scenes(self) -> Iterator[LogScene]:
        yield self.scene


@pytest.mark.parametrize(
    ("route", "seconds", "ahead"), [("CS", 6.0, "CE"), ("CS", 1.0, "CS"), ("CE", 6.0, "CE")]
)
def test_drivers_know_where_a_plan_leads(tmp_path: Path, route: str, seconds: float, ahead: str) -> None:
    """It comes from the west at 8 m/s, 30 m before the crossing, where "CS" turns right and "CE" goes straight on."""
    net = nets.crossing(tmp_path)
    tracks = tracks_of(("ego", AgentClass.CAR, (4.5, 1.8), straight(-46.0, -1.6, 0.0, 8.0, steps=101)))
    log = OneScene(LogScene("log", "", tracks, 0, np.zeros(1, dtype=np.bool_), net))
    source = LoggedTraffic(RoadMap.read(net), log, SceneOptions(), SimOptions(), SeedTree(0))
    scene = replace(next(source.scenes()), routes={"ego": ("WC", route)})
    with running(episode(scene, source.road, target=Onward(seconds)), tmp_path) as loop:
        loop.run(2)
        assert loop.api.vehicle.getRoute("ego")[:2] == ("WC", ahead)
