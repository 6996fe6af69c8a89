"""``check-planner`` takes what an episode takes, refuses what it refuses, and says what it found."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import pytest

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.plan import Controls, Plan, Trajectory
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.experiments.target_trial import CheckResult, Extent, check_target
from advdiff_sumo.maps import RoadMap

BRIEF = Extent(episodes=1, horizon_s=2.0)


class Brakes:
    """Brakes gently; the classes below differ from it in what their names say."""

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> Any:
        return None

    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> Any:
        return self.brakes(scene), memory

    def brakes(self, scene: Scene) -> Plan:
        return Controls(np.full(20, -1.0), np.zeros(20), 0.1)


class WholeNumbers(Brakes):
    def brakes(self, scene: Scene) -> Plan:
        return Controls(np.full(20, -1), np.zeros(20, np.int8), 0.1)


class Writes(Brakes):
    def brakes(self, scene: Scene) -> Plan:
        history, row = scene.history, scene.target
        speed, yaw = np.full(20, history.speed_mps[row, -1]), np.full(20, history.yaw_rad[row, -1])
        xy = history.xy_m[row, -1] + np.cumsum(0.1 * speed[:, None] * unit(yaw), axis=0)
        history.xy_m[...] = 0.0
        history.valid[...] = False
        return Trajectory(xy, yaw, speed, 0.1)


class NeverStarts(Brakes):
    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> Any:
        raise KeyError("lane")


class SameArrays(Brakes):
    """Brakes harder each time, in an array that it returned before."""

    def __init__(self) -> None:
        self.accel = np.zeros(20)

    def brakes(self, scene: Scene) -> Plan:
        self.accel -= 0.01
        return Controls(self.accel, np.zeros(20), 0.1)


class NoNumbers(Brakes):
    def brakes(self, scene: Scene) -> Plan:
        return Controls(np.full(20, np.nan), np.zeros(20), 0.1)


class Nothing(Brakes):
    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> Any:
        return None


class NeedsAnOption(Brakes):
    def __init__(self, sight_m: float) -> None:
        self.sight_m = sight_m


class Told(Brakes):
    """Has what a planner has that something outside this process stands behind, and notes the ends of episodes."""

    ends: ClassVar[list[tuple[str, float]]] = []

    def check(self) -> None:
        return None

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> str:
        return "an episode"

    def end(self, memory: str, end: str, time_s: float, failure: str) -> None:
        assert (memory, failure) == ("an episode", "")
        self.ends.append((end, time_s))

    def close(self) -> None:
        return None


def verdicts(kind: type[Brakes], **options: Any) -> dict[str, CheckResult]:
    return {verdict.name: verdict for verdict in check_target(f"{__name__}:{kind.__name__}", options, BRIEF)}


@pytest.mark.parametrize("kind", [Brakes, WholeNumbers, Writes])
def test_what_an_episode_takes_keeps_the_contract(kind: type[Brakes]) -> None:
    found = verdicts(kind)
    assert [verdict for verdict in found.values() if not verdict.ok] == []
    assert ("it writes into the scene, which it may" in found["scene left alone"].detail) is (kind is Writes)


def test_a_planner_elsewhere_is_told_of_the_end_of_each_drive() -> None:
    """One drive and the same again, 2 s each."""
    Told.ends.clear()
    assert verdicts(Told)["drives it again"].ok
    assert Told.ends == [("horizon", pytest.approx(2.0))] * 2


@pytest.mark.parametrize("defect", ["late:strong", "weak-brakes:strong", "localisation:strong"])
def test_also_with_a_defect(defect: str) -> None:
    assert [x for x in verdicts(WholeNumbers, defects=[defect]).values() if not x.ok] == []


@pytest.mark.parametrize(
    ("kind", "fails", "words", "blind"),
    [
        (NeverStarts, "raises nothing", "raised KeyError: 'lane' (test_target_trial.py, line", "form"),
        (Nothing, "form", "plan() returned NoneType, not (plan, memory)", "numbers"),
        (NoNumbers, "numbers", "accel_mps2 holds values that are not finite", "motion"),
    ],
)
def test_the_first_fault_is_named_and_what_lies_behind_it_not_looked_at(
    kind: type[Brakes], fails: str, words: str, blind: str
) -> None:
    found = verdicts(kind)
    assert words in found[fails].detail
    assert not found[fails].ok
    assert found["methods"].ok
    assert not found["drives"].ok
    assert found["drives it again"].detail == "the same bytes until the failure"
    assert (found[blind].ok, found[blind].detail) == (None, "not looked at, see above")


def test_a_plan_in_the_arrays_of_the_last_one_is_no_repetition() -> None:
    assert "two different plans" in verdicts(SameArrays)["repeats itself"].detail


def test_what_a_run_refuses_is_refused() -> None:
    with pytest.raises(
        ConfigError, match=r"missing a required argument: 'sight_m'; give it .*--set NAME=VALUE of"
    ):
        verdicts(NeedsAnOption)
    assert verdicts(NeedsAnOption, sight_m=3.0)["drives"].ok
    with pytest.raises(ConfigError, match="no server answered Describe; start it first"):
        check_target("grpc://localhost:1", {}, BRIEF)
