"""The contract checker passes every built-in and finds each breach."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.policy_check import check_policy, plans_from_memory_of_others, policy_problems
from advdiff_sumo.traffic.policy_registry import POLICIES, make_policy
from advdiff_sumo.traffic.replay import Replay
from examples.coast import Coast


@pytest.mark.parametrize(
    "name", sorted({*POLICIES.builtins} - {"diffusion"})
)  # which has its own, with networks
def test_every_built_in_keeps_the_contract(name: str, road: RoadMap, scene: Scene, log: Tracks) -> None:
    assert check_policy(make_policy(name, {}), road, scene, log) == []


class Breaking:
    """Replays the log, with a plan changed by *breach*."""

    def __init__(self, breach: Callable[[Tracks], Any]) -> None:
        self.replay, self.breach = Replay(period_s=1.5), breach

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> Any:
        return self.replay.start(road, scene, log, rng)

    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> Any:
        tracks = self.replay.plan(road, scene, memory, rng)[0].tracks
        spoilt = self.breach(tracks)
        if isinstance(spoilt, Tracks):
            return JointPlan(spoilt, exact=True), memory
        return (JointPlan(tracks, exact=True), memory) if spoilt is None else spoilt


def _write(name: str, value: float) -> Callable[..., None]:
    def breach(tracks: Tracks) -> None:
        getattr(tracks, name)[0, 2] = value

    return breach


def _raise(_: Tracks) -> None:
    raise KeyError("oops")


@pytest.mark.parametrize(
    ("breach", "said"),
    [
        (lambda _: "nonsense", "must return (JointPlan, memory)"),
        (lambda t: (t, None), "must return a JointPlan"),
        (_raise, "it raised KeyError"),
        (_write("yaw_rad", np.nan), "yaw_rad of 'a' is not finite at step 2"),
        (_write("xy_m", np.inf), "xy_m of 'a' is not finite at step 2"),
        (_write("xy_m", 1e5), "'a' jumps"),
        (lambda t: replace(t, xy_m=t.xy_m + 50.0), "'a' jumps 71"),
        (lambda t: replace(t, speed_mps=np.zeros_like(t.speed_mps)), "numbers where valid is False"),
        (lambda t: replace(t, speed_mps=t.speed_mps.astype(np.float32)), "float32; it must be float64"),
        (lambda t: replace(t, valid=t.valid.astype(np.int64)), "valid is int64"),
        (lambda t: replace(t, size_m=-t.size_m), "no positive length"),
        (lambda t: replace(t, size_m=t.size_m + 1.0), "changes the size of 'a'"),
        (lambda t: replace(t, classes=t.classes + 1), "changes the class of 'a'"),
        (lambda t: replace(t, ids=("ego", *t.ids[1:])), "plans for the target 'ego'"),
        (lambda t: replace(t, ids=("d", *t.ids[1:])), "plans for 'd', which is not movable"),
        (lambda t: replace(t, dt_s=0.0), "dt_s is 0.0"),
        (lambda t: t.shifted(-0.1), "starts at t0_s = 0, expected now + dt_s = 0.1"),
        (lambda t: replace(t, t0_s=0.1), "planning 0.5 s later"),
        (lambda t: t.window(0, 2), "lasts 0.2 s, less than one model step"),
        (lambda t: replace(t, dt_s="0.1"), "dt_s is of type str, not a number of seconds"),
        (lambda t: replace(t, t0_s="0.1"), "t0_s is of type str, not a number of seconds"),
        (lambda t: replace(t, xy_m=t.xy_m.astype(object)), "xy_m holds object, not numbers"),
    ],
)
def test_each_breach_is_found(breach: Any, said: str, road: RoadMap, scene: Scene, log: Tracks) -> None:
    problems = check_policy(Breaking(breach), road, scene, log)
    assert any(said in problem for problem in problems), problems


def test_a_changed_scene_or_log_is_found(road: RoadMap, scene: Scene, log: Tracks) -> None:
    class Vandal(Replay):
        def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> Any:
            scene.history.xy_m[0, 0, 0] += 1e-9
            log.speed_mps[0, 0] += 1e-9
            return super().plan(road, scene, memory, rng)

    problems = check_policy(Vandal(), road, scene, log)
    assert problems == ["it changes the scene that it was given", "it changes the log that it was given"]


class Coasting(Coast):
    """Coasts; the classes below differ from it as their names say."""

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> Any:
        return {"plans": 0, "paths": {}}


class Counts(Coasting):
    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> Any:
        memory["plans"] += 1
        return super().plan(road, scene, memory, rng)


class Caches(Coasting):
    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> Any:
        memory["paths"][scene.target_id] = "a lane"
        return super().plan(road, scene, memory, rng)


class StartsByChance(Coasting):
    chance = np.random.default_rng(0)

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> Any:
        return self.chance.random()


class StopsAtOnce(Coasting):
    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> Any:
        plan, memory = super().plan(road, scene, memory, rng)
        return replace(plan, tracks=replace(plan.tracks, speed_mps=0.0 * plan.tracks.speed_mps)), memory


class InItsOwnFrame(Coasting):
    """Plans correctly, but shifts the scene that it was given."""

    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> Any:
        plan = super().plan(road, scene, memory, rng)
        scene.history.xy_m[...] -= 1000.0
        return plan


class NamesByNumber(Coasting):
    """Inserts a vehicle whose id is a number."""

    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> Any:
        plan, memory = super().plan(road, scene, memory, rng)
        return JointPlan(replace(plan.tracks.rows([0]), ids=(7,))), memory  # type: ignore[arg-type] # on purpose


class BringsLogged(Coasting):
    """Inserts a vehicle of the log that is not in the scene."""

    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> Any:
        plan, memory = super().plan(road, scene, memory, rng)
        return JointPlan(replace(plan.tracks.rows([0]), ids=("c",))), memory


@pytest.mark.parametrize(
    ("policy", "part", "said"),
    [
        (Counts(), "inputs left alone", "it changes the memory that it was given"),
        (InItsOwnFrame(), "inputs left alone", "it changes the scene that it was given"),
        (StartsByChance(), "repeats itself", "start returns two different memories"),
        (StopsAtOnce(), "motion", "'a': step 1 moves farther than its speeds allow"),
        (StopsAtOnce(), "motion", "'a': step 0 brakes by more than 9 m/s²"),
        (BringsLogged(), "moves whom it may", "it lets in 'c', whom the scene's log has"),
        (NamesByNumber(), "form", "a run refuses its plan: for a vehicle whose name is no text"),
    ],
)
def test_the_part_of_the_contract_is_named(
    policy: Any, part: str, said: str, road: RoadMap, scene: Scene, log: Tracks
) -> None:
    problems = policy_problems(policy, road, scene, log)
    assert {problem.part for problem in problems} == {part}
    assert any(problem.text.startswith(said) for problem in problems), problems


def test_a_cache_in_the_memory_is_reported_as_harmless(road: RoadMap, scene: Scene, log: Tracks) -> None:
    (told,) = policy_problems(Caches(), road, scene, log)
    assert (told.harmless, told.text) == (True, "it adds to tables in its memory, as a cache may")
    assert check_policy(Caches(), road, scene, log) == []


def test_state_kept_between_episodes_is_found(road: RoadMap, scene: Scene, log: Tracks) -> None:
    class Grows(Coasting):
        """Plans longer after every third plan."""

        plans = 0

        def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> Any:
            Grows.plans += 1
            self.steps = 10 + Grows.plans // 3
            return super().plan(road, scene, memory, rng)

    situations = [(scene, log), (scene.without(np.ones(4, dtype=np.bool_)), log)]
    assert plans_from_memory_of_others(Grows(), road, situations)
    assert not plans_from_memory_of_others(Coasting(), road, situations)


def test_hidden_randomness_is_found(road: RoadMap, scene: Scene, log: Tracks) -> None:
    hidden = np.random.default_rng(0)
    policy = Breaking(lambda t: replace(t, xy_m=t.xy_m + hidden.normal(0.0, 1e-6)))
    assert ["two plans" in problem for problem in check_policy(policy, road, scene, log)] == [True]


def test_an_object_without_methods_is_no_policy(road: RoadMap, scene: Scene, log: Tracks) -> None:
    assert check_policy(object(), road, scene, log) == ["it has no method start"]  # type: ignore[arg-type]


def test_a_policy_may_draw_from_its_generator(road: RoadMap, scene: Scene, log: Tracks) -> None:
    class Wobbly(Replay):
        def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> Any:
            tracks = super().plan(road, scene, memory, rng)[0].tracks
            moved = replace(tracks, xy_m=tracks.xy_m + rng.normal(0.0, 0.01, tracks.xy_m.shape))
            return JointPlan(moved, exact=True), memory

    assert check_policy(Wobbly(), road, scene, log) == []


def test_the_example_keeps_the_contract(road: RoadMap, scene: Scene, log: Tracks) -> None:
    assert check_policy(Coast(seconds=2.0), road, scene, log) == []
