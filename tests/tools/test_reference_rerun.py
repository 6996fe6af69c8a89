"""An episode in which a second planner takes over from the first one."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from advdiff_sumo.planners.planner_protocol import Served
from advdiff_sumo.planners.reference import CarefulPlanner
from advdiff_sumo.sim.run_episodes import Run, RunOptions
from tests.experiments.test_target_trial import Told

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from reference_src.reference_rerun import handed_over


def test_an_external_planner_is_informed_of_the_end_after_the_takeover() -> None:
    scene = {"warmup_s": 8.0, "scenes_per_warmup": 1, "min_neighbours": 0}
    run = Run.prepare(RunOptions.parse({"net": "motorway", "horizon_s": 1.0, "seed": 3, "scene": scene}))
    Told.ends.clear()
    target = handed_over(Told(), CarefulPlanner(), 0.5)
    record, _ = replace(run.episode(0, next(iter(run.seed_scenes()))), target=target).run()
    assert (record.failure, Told.ends) == (None, [("horizon", 1.0)])
    assert not isinstance(handed_over(CarefulPlanner(), CarefulPlanner(), 0.5), Served)
