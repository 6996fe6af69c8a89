"""Properties of both baselines as policies that hold for all weights, with small untrained networks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from advdiff_sumo.core.errors import ConfigError, UnknownNameError, WeightsError
from advdiff_sumo.core.plan import AttackState
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.view import look
from advdiff_sumo.traffic.baselines.advsim import AdvSim
from advdiff_sumo.traffic.baselines.baseline_policy import (
    BaselineMemory,
    BaselinePolicy,
    SearchResult,
    SearchTask,
)
from advdiff_sumo.traffic.baselines.strive import Strive
from advdiff_sumo.traffic.policy_check import check_policy
from advdiff_sumo.traffic.policy_registry import make_policy

Street = Callable[..., Scene]
PLACES = [(60.0, 0.0), (78.0, 0.0), (42.0, 0.0), (95.0, 0.0)]
SPEEDS = [8.0, 7.0, 9.0, 6.0]
NAMES = ("strive", "advsim")


@pytest.fixture
def made(weights: str, simnet: str) -> Callable[..., BaselinePolicy]:
    """Return a function (name, options) → the reckless baseline with small networks and a short search."""

    def make(name: str, **options: Any) -> BaselinePolicy:
        more = {"simnet": simnet, "candidates": 8} if name == "advsim" else {}
        usual = {"weights": weights, "rounds": 3, "licence": "reckless"}
        policy = make_policy(name, {**usual, **more, **options})
        assert isinstance(policy, Strive | AdvSim)
        return policy

    return make


def searched(
    policy: BaselinePolicy, road: RoadMap, scene: Scene, memory: BaselineMemory | None = None
) -> SearchResult:
    begun = memory or policy.start(road, scene, None, np.random.default_rng(0))
    return policy.search(SearchTask(road, look(road, scene), begun, 7))


def same(one: Rollout, other: Rollout) -> bool:
    return torch.equal(one.states(), other.states())


@pytest.mark.parametrize("surrogate", ["lane_graph", "model"])
@pytest.mark.parametrize("name", NAMES)
def test_they_keep_the_contract(
    name: str, surrogate: str, made: Callable[..., BaselinePolicy], downtown: RoadMap, street: Street
) -> None:
    policy = made(name, surrogate=surrogate, attackers=2)
    assert check_policy(policy, downtown, street(PLACES, SPEEDS), None) == []


@pytest.mark.parametrize("name", NAMES)
def test_same_memory_and_random_numbers_same_bytes(
    name: str, made: Callable[..., BaselinePolicy], downtown: RoadMap, street: Street
) -> None:
    scene, twice = street(PLACES, SPEEDS), []
    for _ in range(2):
        policy = made(name)
        memory = policy.start(downtown, scene, None, np.random.default_rng(0))
        for _ in range(2):
            plan, memory = policy.plan(downtown, scene, memory, np.random.default_rng(3))
        twice.append(plan.tracks.xy_m.tobytes())
    assert twice[0] == twice[1]


def test_no_rounds_is_the_priors_mean(
    made: Callable[..., BaselinePolicy], downtown: RoadMap, street: Street
) -> None:
    scene = street(PLACES, SPEEDS)
    policy = made("strive", rounds=0)
    assert isinstance(policy, Strive)
    found = searched(policy, downtown, scene)
    traffic, batch = policy.prior.traffic, look(downtown, scene).batch
    with torch.no_grad():
        context = traffic.encoder(batch)
        natural = policy.decoder(context.prior.mean, context.h, batch)
    assert same(found.drawn.rollout, natural)
    assert (found.drawn.attackers, found.losses) == ((), ())
    assert same(searched(policy, downtown, scene, found.memory).drawn.rollout, natural)


@pytest.mark.parametrize("initial", ["simnet", "model"])
def test_no_rounds_is_the_initial_future(
    initial: str, made: Callable[..., BaselinePolicy], downtown: RoadMap, street: Street
) -> None:
    scene = street(PLACES, SPEEDS)
    policy = made("advsim", rounds=0, initial=initial)
    assert isinstance(policy, AdvSim)
    found = searched(policy, downtown, scene)
    with torch.no_grad():
        natural = policy.driver(look(downtown, scene).batch)
    assert same(found.drawn.rollout, natural)
    assert found.drawn.attackers == ()


@pytest.mark.parametrize("name", NAMES)
def test_no_more_vehicles_attack_than_the_option_allows(
    name: str, made: Callable[..., BaselinePolicy], downtown: RoadMap, street: Street
) -> None:
    scene = street(PLACES, SPEEDS)
    movable = np.array([False, True, True, False])
    for most in (1, 2):
        attackers = searched(
            made(name, attackers=most), downtown, replace(scene, movable=movable)
        ).drawn.attackers
        assert len(attackers) == most
        assert set(attackers) <= {"v1", "v2"}


@pytest.mark.parametrize("name", NAMES)
def test_no_vehicle_to_move(
    name: str, made: Callable[..., BaselinePolicy], downtown: RoadMap, street: Street
) -> None:
    scene = replace(street(PLACES, SPEEDS), movable=np.zeros(4, dtype=np.bool_))
    policy = made(name)
    memory = policy.start(downtown, scene, None, np.random.default_rng(0))
    plan = policy.plan(downtown, scene, memory, np.random.default_rng(1))[0]
    assert plan.tracks.agents == 0
    assert plan.attack == AttackState("any")


@pytest.mark.parametrize("name", NAMES)
def test_a_plan_names_its_attackers(
    name: str, made: Callable[..., BaselinePolicy], downtown: RoadMap, street: Street
) -> None:
    scene, policy = street(PLACES, SPEEDS), made(name, attackers=1)
    memory = policy.start(downtown, scene, None, np.random.default_rng(0))
    plan, memory = policy.plan(downtown, scene, memory, np.random.default_rng(1))
    assert plan.attack == AttackState("any", memory.attackers)
    assert len(memory.attackers) == 1


@pytest.mark.parametrize("name", NAMES)
def test_a_plan_is_driven_for_replan_steps(
    name: str, made: Callable[..., BaselinePolicy], downtown: RoadMap, street: Street
) -> None:
    scene = street(PLACES, SPEEDS)
    policy = made(name, replan=2)
    memory = policy.start(downtown, scene, None, np.random.default_rng(0))
    first, memory = policy.plan(downtown, scene, memory, np.random.default_rng(1))
    later = replace(scene, history=scene.history.shifted(0.5))
    second, _ = policy.plan(downtown, later, memory, np.random.default_rng(2))
    np.testing.assert_array_equal(second.tracks.xy_m, first.tracks.xy_m[:, 1:])


@pytest.mark.parametrize("name", NAMES)
def test_model_steps_are_counted_if_plans_are_farther_apart(
    name: str, made: Callable[..., BaselinePolicy], downtown: RoadMap, street: Street
) -> None:
    scene = street(PLACES, SPEEDS)
    policy = made(name, replan=4)
    memory = policy.start(downtown, scene, None, np.random.default_rng(0))
    first, memory = policy.plan(downtown, scene, memory, np.random.default_rng(1))
    later = replace(scene, history=scene.history.shifted(1.0))
    second, _ = policy.plan(downtown, later, memory, np.random.default_rng(2))
    np.testing.assert_array_equal(second.tracks.xy_m, first.tracks.xy_m[:, 2:])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"rounds": -1}, "rounds = -1"),
        ({"device": "abacus"}, r"background '\w+': device = 'abacus' cannot be used"),
        ({"roundz": 3}, "roundz"),
        ({"surrogate": "advdiff_sumo.planners.sumo_models:sumo_driver"}, "cannot stand for the target"),
    ],
)
def test_wrong_options(
    name: str, options: dict[str, Any], said: str, made: Callable[..., BaselinePolicy]
) -> None:
    with pytest.raises(ConfigError, match=said):
        made(name, **options)


def test_unknown_names_and_missing_files(made: Callable[..., BaselinePolicy], tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="lane_graph"):
        made("strive", surrogate="lane_graf")
    with pytest.raises(WeightsError, match="no such file"):
        made("advsim", simnet=str(tmp_path / "none"))
    with pytest.raises(WeightsError, match="no such file"):
        made("strive", weights=str(tmp_path / "none"))
