"""Which of SUMO's own reports a record contains."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from advdiff_sumo.core.record import EndReason
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.data.log_reader import LogScene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.background_metrics import compare_with_sumo
from advdiff_sumo.sim.logs import LoggedTraffic
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from tests.sim.scenes import episode, running
from tests.sim.test_log_starts import STEP_S, STEPS, OneDrive


class TwoThatOverlap(OneDrive):
    """The ego reaches the street's end; far behind it, two vehicles 4.5 m long creep along its lane 3 m apart."""

    def __init__(self) -> None:
        super().__init__(0.0)
        t = STEP_S * np.arange(STEPS)
        x = np.stack((np.minimum(340.0 + 10.0 * t, 396.0), 300.0 + t, 303.0 + t))
        self.tracks = Tracks(
            ids=("ego", "a", "b"),
            classes=np.repeat(np.array([AgentClass.CAR]), 3),
            size_m=np.tile((4.5, 1.8), (3, 1)),
            xy_m=np.stack((x, np.full_like(x, -4.8)), -1),
            yaw_rad=np.zeros((3, STEPS)),
            speed_mps=np.gradient(x, STEP_S, axis=1),
            valid=np.ones((3, STEPS), dtype=np.bool_),
            t0_s=0.0,
            dt_s=STEP_S,
        )

    def read(self, name: str) -> LogScene:
        return LogScene(name, "street", self.tracks, 0, np.zeros(3, dtype=np.bool_), Path("street"))


def test_the_step_in_which_the_target_leaves_the_net_adds_no_collision(street: Path, tmp_path: Path) -> None:
    """That step has no states, so that no boxes could confirm a collision."""
    road = RoadMap.read(street)
    logged = LoggedTraffic(road, TwoThatOverlap(), SceneOptions(), SimOptions(), SeedTree(0))
    with running(episode(next(iter(logged.scenes())), road, background="replay"), tmp_path) as loop:
        assert loop.run(100) is EndReason.ARRIVED
        assert loop.recorder.collisions[-1].step == len(loop.recorder.frames), "SUMO told of that step, too"
        record = loop.record(EndReason.ARRIVED, None)
    steps = [hit.step for hit in record.sumo_collisions]
    assert steps
    assert max(steps) == record.tracks.steps - 1
    compared = compare_with_sumo(record)
    assert (compared.listed, compared.sumo_only) == (len(steps), 0)
