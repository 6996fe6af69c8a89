"""``check-policy`` takes what an episode takes, counts what happens in traffic, and says what it found."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from advdiff_sumo.core.contract import Problem
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.experiments.check_results import CheckResult, part_result
from advdiff_sumo.experiments.policy_trial import check_background
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.run_episodes import RunOptions
from advdiff_sumo.traffic.policy_check import PolicyPart
from examples.coast import Coast

BRIEF = {"episodes": 1, "horizon_s": 2.0, "scene": {"scenes_per_warmup": 1, "warmup_s": 20.0}}


class NeverStarts(Coast):
    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> None:
        raise KeyError("lane")


class Jumps(Coast):
    """Half a second ahead, everybody is somewhere else."""

    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> Any:
        plan, memory = super().plan(road, scene, memory, rng)
        plan.tracks.xy_m[:, 4:] += 100.0
        return plan, memory


def verdicts(background: str, **options: Any) -> dict[str, CheckResult]:
    asked = RunOptions.parse({"background": background, "background_options": options, **BRIEF})
    return {verdict.name: verdict for verdict in check_background(asked)}


def own(kind: type) -> str:
    return f"{kind.__module__}:{kind.__name__}"


def test_the_example_keeps_the_contract_and_leaves_the_road() -> None:
    told = verdicts(own(Coast), seconds=2.0)
    assert [one for one in told.values() if one.ok is False] == []
    assert told["motion"].detail == "12 scenes"
    assert "vehicles moved, 0 refused plans, no safeguard" in told["in traffic"].detail
    assert told["in time"].detail.endswith("of 4 plans")


def test_a_log_fits_the_hard_scenes() -> None:
    """In one of them somebody stands elsewhere than in the log."""
    assert {one.ok for one in verdicts("replay").values()} == {True}


def test_who_leaves_all_to_sumo_plans_nothing() -> None:
    told = verdicts("sumo")
    assert {one.ok for one in told.values()} == {True}
    assert told["in time"].detail == "it plans nothing: SUMO drives everybody"


@pytest.mark.parametrize(
    ("kind", "fails", "words", "blind", "counts"),
    [
        (NeverStarts, "raises nothing", "it raised KeyError: 'lane' (test_policy_trial.py,", "form", "0 re"),
        (Jumps, "motion", "jumps 14", None, "1 refused plan,"),
    ],
)
def test_what_is_wrong_is_named_and_counted(
    kind: type, fails: str, words: str, blind: str | None, counts: str
) -> None:
    told = verdicts(own(kind))
    assert words in told[fails].detail
    assert (told[fails].ok, told["drives"].ok) == (False, False)
    assert counts in told["in traffic"].detail
    assert told["in traffic"].ok is None
    assert "names each" not in told["in traffic"].detail  # nobody collided or left the road
    if blind is not None:
        assert (told[blind].ok, told[blind].detail) == (None, "not looked at, see above")


def test_a_part_tells_its_gravest_problem() -> None:
    """The first problem may be harmless, and a later one none."""
    part = PolicyPart.GIVEN
    problems = [
        ("a", Problem(part, "it may", harmless=True)),
        ("b", Problem(part, "it must not", remedy="do so")),
    ]
    told = part_result(part, problems, ("a", "b"), {})
    assert (told.ok, told.detail) == (False, "it must not (b); do so; 1 more")
