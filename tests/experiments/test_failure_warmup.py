"""Warm-up under a licence on a shipped net: what it asks, what it refuses, and that it learns from failures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from advdiff_sumo.core.errors import ConfigError, EpisodeFailure
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.experiments.failure_warmup import (
    EPISODE_S,
    SCENE,
    MetEncounters,
    failure_probabilities,
    header,
    meet,
    warm_up_failures,
    with_room,
)
from advdiff_sumo.models.failure_predictor import FailurePredictor, load_failures
from advdiff_sumo.models.shipped_weights import shipped_weights
from advdiff_sumo.planners.reference import CarefulPlanner
from advdiff_sumo.sim.run_episodes import RunOptions
from advdiff_sumo.sim.seed_scene import PlacedTraffic, SeedScene
from advdiff_sumo.traffic.manoeuvres.encounter_features import FEATURES
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS


def prior() -> FailurePredictor:
    return load_failures(shipped_weights("failures"), len(FEATURES))


def options(**values: Any) -> RunOptions:
    usual: dict[str, Any] = {
        "net": "motorway",
        "target": "lane_graph",
        "background": "scripted",
        "seed": 7901,
    }
    return RunOptions.parse(usual | values)


def nothing(_: int) -> None:
    pass


class Refuses:
    """A planner that fails at once."""

    def start(self, *_: object) -> None:
        raise RuntimeError("no map")

    def plan(self, *_: object) -> None:
        raise AssertionError


class RefusesLater(CarefulPlanner):
    """A planner that drives one episode and fails at once in all that follow, as a server that has crashed does."""

    def __init__(self) -> None:
        super().__init__()
        self.episodes = 0

    def start(self, *given: Any) -> Any:
        self.episodes += 1
        if self.episodes > 1:
            raise RuntimeError("no server")
        return super().start(*given)


@pytest.mark.slow
def test_who_brakes_weakly_is_told_from_who_brakes_well() -> None:
    told: list[int] = []
    weak = warm_up_failures(options(target_options={"defects": ["weak-brakes:strong"]}), 28, told.append)
    assert weak.plans == told[-1] == 28
    assert told == sorted(told)
    assert weak.features.shape == (len(weak.outcomes), len(FEATURES))
    assert weak.failures >= 1
    assert header(options(), weak)["failures"] == weak.failures
    sound = meet(options(horizon_s=EPISODE_S, scene=SCENE.model_dump()), prior(), 28, nothing)
    assert sound.failures == 0
    assert failure_probabilities(sound.predictor)["hard-stop"] < failure_probabilities(prior())["hard-stop"]
    assert (
        failure_probabilities(sound.predictor)["hard-stop"]
        < failure_probabilities(weak.predictor)["hard-stop"]
    )


@pytest.mark.slow
def test_without_learning_the_belief_stays() -> None:
    done = meet(options(horizon_s=4.0, scene=SCENE.model_dump()), prior(), 6, nothing, learns=False)
    assert np.array_equal(done.predictor.mean, prior().mean)


def test_failures_are_whole_ones() -> None:
    met = MetEncounters(prior(), np.zeros((3, len(FEATURES))), np.array([0.0, 0.5, 1.0]), 9, 1)
    assert met.failures == 1


def test_the_shipped_prior_expects_little_of_what_it_has_not_met() -> None:
    promised = failure_probabilities(prior())
    assert set(promised) == set(KINDS)
    assert list(promised.values()) == sorted(promised.values(), reverse=True)
    assert all(0.005 < share < 0.5 for share in promised.values())


@pytest.mark.parametrize(
    ("background", "policy"), [("sumo", {}), ("scripted", {"licence": "reckless"}), ("replay", {})]
)
def test_traffic_without_encounters(background: str, policy: dict[str, str]) -> None:
    with pytest.raises(ConfigError, match="for background 'scripted' or 'diffusion' under a licence"):
        meet(options(background=background, background_options=policy), prior(), 4, nothing)


def test_a_planner_that_never_plans_ends_it() -> None:
    target = f"{__name__}:Refuses"
    scene = {"warmup_s": 8.0, "scenes_per_warmup": 3, "min_neighbours": 0, "density_per_km": 2.0}
    with pytest.raises(EpisodeFailure, match=r"3 episodes without a plan; the last one: .*no map"):
        meet(options(target=target, horizon_s=1.0, scene=scene), prior(), 4, nothing)


def test_plans_of_an_episode_count_once() -> None:
    """An episode of 2 s has four plans; those after it begin without the planner and have none."""
    target = f"{__name__}:RefusesLater"
    scene = {"warmup_s": 8.0, "scenes_per_warmup": 4, "min_neighbours": 0, "density_per_km": 2.0}
    told: list[int] = []
    with pytest.raises(EpisodeFailure, match=r"3 episodes without a plan; the last one: .*no server"):
        meet(options(target=target, horizon_s=2.0, scene=scene), prior(), 20, told.append)
    assert told == [4, 4, 4]


def test_scenes_with_somebody_ahead_are_passed_over() -> None:
    """One car 40 m ahead, one 40 m behind; where nothing else comes, the one after twenty is taken all the same."""
    blocked, free = seed_scene(40.0), seed_scene(-40.0)
    assert list(with_room([blocked, free, blocked, free])) == [free, free]
    assert len(list(with_room([blocked] * 42))) == 2


def seed_scene(ahead_m: float) -> SeedScene:
    """Return a scene of a target that heads north, and of somebody *ahead_m* ahead of it, two metres to the left."""
    history = Tracks(
        ids=("other", "target"),
        classes=np.zeros(2, dtype=np.int64),
        size_m=np.tile([4.5, 1.8], (2, 1)),
        xy_m=np.array([[[8.0, 5.0 + ahead_m]], [[10.0, 5.0]]]),
        yaw_rad=np.full((2, 1), 0.5 * np.pi),
        speed_mps=np.full((2, 1), 8.0),
        valid=np.ones((2, 1), dtype=np.bool_),
        t0_s=0.0,
        dt_s=0.5,
    )
    start = PlacedTraffic(np.ones(2, dtype=np.bool_))
    return SeedScene("made", Path("none"), 0, history, "target", {}, history, start, 10.0)
