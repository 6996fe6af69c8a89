"""The attacker's environment: the checkers of Gymnasium and stable-baselines3, and equality with real episodes."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_for_training

from advdiff_sumo.core.errors import AdvdiffError, ConfigError, NetError, UnknownNameError
from advdiff_sumo.core.record import EndReason
from advdiff_sumo.rl import ENVIRONMENT
from advdiff_sumo.rl.adversary_env import AdversaryEnv
from advdiff_sumo.rl.adversary_reward import DecisionInterval, reward_terms
from advdiff_sumo.traffic.rl.actor import save_actor
from advdiff_sumo.traffic.rl.adv_rl_policy import AdvRl
from tests.traffic.rl.conftest import actor

IDLE = np.zeros(2, dtype=np.float32)


@pytest.fixture(scope="module")
def env(settings: dict[str, Any]) -> Iterator[AdversaryEnv]:
    made = gymnasium.make(ENVIRONMENT, **settings).unwrapped
    assert isinstance(made, AdversaryEnv)
    yield made
    made.close()


def test_it_passes_the_checkers(env: AdversaryEnv) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # what they only warn of counts too
        check_env(env)
        check_for_training(env)


def test_its_name_can_be_used_without_an_import(settings: dict[str, Any]) -> None:
    """Gymnasium imports the module before the colon; importing ``advdiff_sumo`` itself registers nothing."""
    made = gymnasium.make(f"advdiff_sumo.rl:{ENVIRONMENT}", **settings)
    assert isinstance(made.unwrapped, AdversaryEnv)
    made.close()


def walk(env: AdversaryEnv, seed: int, action: np.ndarray) -> list[tuple[bytes, float]]:
    seen, _ = env.reset(seed=seed)
    out, over = [(seen.tobytes(), 0.0)], False
    while not over:
        seen, reward, terminated, truncated, _ = env.step(action)
        assert seen in env.observation_space
        out.append((seen.tobytes(), reward))
        over = terminated or truncated
    return out


def test_the_same_seed_gives_the_same_episode(env: AdversaryEnv) -> None:
    push = np.array([0.5, -0.3], dtype=np.float32)
    first = walk(env, 7, push)
    assert first == walk(env, 7, push)
    assert first != walk(env, 7, IDLE)


def test_an_attacker_without_actions_equals_the_untrained_policy(
    env: AdversaryEnv, settings: dict[str, Any], tmp_path: Path
) -> None:
    """An episode with action zero throughout equals, byte by byte, one of background adv-rl at strength 0."""
    env.reset(seed=3)
    loop = env.loop
    for number in range(6):
        _, _, terminated, truncated, info = env.step(IDLE)
        assert not terminated
        assert truncated == (number == 5), "3 s are six steps"
    assert info["episode_summary"]["steps"] == 6
    stepped = loop.record(EndReason.HORIZON, None)
    save_actor(actor(0.7), tmp_path / "a.safetensors")
    policy = AdvRl(
        weights=str(tmp_path / "a.safetensors"),
        prior_weights=settings["prior_weights"],
        licence="reckless",
        strength=0.0,
        attackers=1,  # as in the environment
    )
    record, timing = replace(loop.episode, policy=policy).run()
    assert record.failure is None
    assert record.tracks.ids == stepped.tracks.ids
    assert record.tracks.xy_m.tobytes() == stepped.tracks.xy_m.tobytes()
    assert (record.controller == stepped.controller).all()
    assert len(timing.background_plans_s) == 6


def test_the_reward_of_a_step_is_for_its_own_instants(env: AdversaryEnv) -> None:
    """An episode that ends 0.2 s into its fifth step: three instants, from that of the decision on."""
    env.reset(seed=3)
    loop = env.loop
    loop.episode = replace(loop.episode, horizon_s=2.2)
    for _ in range(4):
        assert not env.step(IDLE)[3]
    now = env._seat.now
    assert now is not None
    assert now.attackers
    row = loop.world.row_of(now.attackers[0])
    earlier, decided = loop.recorder.frames[-6].speed_mps[row], loop.recorder.frames[-1].speed_mps[row]
    before = float(decided - earlier) / 0.5
    *_, truncated, info = env.step(IDLE)
    assert truncated
    paid, whole = (
        reward_terms(
            DecisionInterval(
                frames=loop.recorder.frames[-instants:],
                size_m=loop.world.size_m[: len(loop.world)],
                attacker=loop.world.row_of(now.attackers[0]),
                target=loop.target,
                collided=False,
                accel_mps2=before,
                residual=np.zeros(2),
                dt_s=0.1,
            ),
            env.options.reward,
            loop.road,
        )
        for instants in (3, 6)
    )
    assert paid != whole
    assert info["reward_terms"] == paid


def test_jerk_is_counted_from_the_first_step_on(env: AdversaryEnv) -> None:
    """In the first step it is relative to the same vehicle's acceleration in the past of the seed scene."""
    env.reset(seed=3)
    loop = env.loop
    for _ in range(4):
        now = env._seat.now
        assert now is not None
        row = loop.world.row_of(now.attackers[0])
        *_, info = env.step(np.array([0.8, 0.0], dtype=np.float32))
        speeds = [frame.speed_mps[row] for frame in loop.recorder.model_frames[-3:]]
        jerk = (speeds[2] - 2.0 * speeds[1] + speeds[0]) / 0.25
        expected = -0.05 * min((jerk / 10.0) ** 2, 4.0)
        assert info["reward_terms"]["jerk"] == pytest.approx(expected)


def test_step_is_refused_without_a_running_episode(env: AdversaryEnv, settings: dict[str, Any]) -> None:
    env.close()
    with pytest.raises(RuntimeError, match="reset the environment"):
        env.step(IDLE)
    env.reset(seed=0)
    second = AdversaryEnv(**settings)
    with pytest.raises(AdvdiffError, match="a second SUMO simulation"):
        second.reset(seed=0)
    env.close()
    env.close()


@pytest.mark.parametrize(
    ("wrong", "error", "problem"),
    [
        ({"net": "downtown"}, ConfigError, "no option 'net'; did you mean 'nets'"),
        ({"horizon_s": 0.3}, ConfigError, "horizon_s = 0.3"),
        ({"nets": "moon"}, NetError, "moon"),
        ({"targets": "IDN"}, UnknownNameError, "did you mean 'IDM'"),
        ({"reward": {"hitt": 1.0}}, ConfigError, "reward.hit"),
    ],
)
def test_bad_options_are_refused(wrong: dict[str, Any], error: type[Exception], problem: str) -> None:
    with pytest.raises(error, match=problem):
        AdversaryEnv(**wrong)
