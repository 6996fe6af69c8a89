"""The environment of the tested vehicle: the checkers, its reward, and its repeatability."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_for_training
from stable_baselines3.common.env_util import make_vec_env

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.rl import TARGET_ENVIRONMENT
from advdiff_sumo.rl.target_env import TargetEnv
from advdiff_sumo.rl.target_view import controls_of
from tests.rl.conftest import SCENE

OPTIONS: dict[str, Any] = {"net": "motorway", "scenes": 1, "horizon_s": 3.0, "scene": SCENE}


@pytest.fixture(params=["controls", "trajectory"])
def env(request: pytest.FixtureRequest) -> Iterator[TargetEnv]:
    made = gymnasium.make(f"advdiff_sumo.rl:{TARGET_ENVIRONMENT}", action=request.param, **OPTIONS).unwrapped
    assert isinstance(made, TargetEnv)
    yield made
    made.close()


def walk(env: TargetEnv, action: np.ndarray) -> list[tuple[bytes, float]]:
    seen, _ = env.reset(seed=4)
    out, over = [(seen.tobytes(), 0.0)], False
    while not over:
        seen, reward, terminated, truncated, _ = env.step(action)
        out.append((seen.tobytes(), reward))
        over = terminated or truncated
    return out


def test_it_passes_the_checkers(env: TargetEnv) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # what they only warn of counts too
        check_env(env)
        check_for_training(env)


def test_the_same_seed_gives_the_same_episode(env: TargetEnv) -> None:
    action = np.zeros(env.action_space.shape or (), dtype=np.float32)
    assert walk(env, action) == walk(env, action)


@pytest.mark.filterwarnings(
    "ignore:.*not in the possible render_modes"
)  # stable-baselines3 asks for pictures first
def test_stable_baselines_makes_environments_by_name() -> None:
    made = make_vec_env(f"advdiff_sumo.rl:{TARGET_ENVIRONMENT}", env_kwargs=OPTIONS)
    seen = made.reset()
    made.close()
    assert isinstance(seen, np.ndarray)
    assert seen.shape == (1, 99)


def test_controls_by_hand() -> None:
    assert controls_of(np.array([-1.0, 0.5])).accel_mps2.tolist() == [-9.0] * 5
    assert controls_of(np.array([-1.0, 0.5])).steer_rad.tolist() == [0.25] * 5


def test_leaving_the_road_costs_and_ends_the_episode() -> None:
    env = TargetEnv(**{**OPTIONS, "horizon_s": 20.0})
    env.reset(seed=4)
    terms = []
    for _ in range(40):
        _, reward, terminated, truncated, info = env.step(np.array([0.0, 0.3], dtype=np.float32))
        terms.append(info["reward_terms"])
        if terminated or truncated:
            break
    env.close()
    assert terminated
    assert info["end"] == "off_road"
    assert [step["leaving"] for step in terms] == [0.0] * (len(terms) - 1) + [-10.0]
    assert -1.0 <= terms[-1]["off_road"] < -0.5
    assert all(-0.5 <= step["off_road"] <= 0.0 for step in terms[:-1])
    assert reward == pytest.approx(sum(terms[-1].values()))


def test_the_reward_of_progress_is_a_tenth_per_metre() -> None:
    env = TargetEnv(**OPTIONS)
    seen, _ = env.reset(seed=4)
    speed = 15.0 * float(seen[0])
    terms = env.step(np.zeros(2, dtype=np.float32))[4]["reward_terms"]
    env.close()
    assert terms["progress"] == pytest.approx(0.1 * 0.5 * speed, rel=0.02)
    assert (terms["collision"], terms["effort"]) == (0.0, 0.0)


def test_progress_above_the_speed_limit_is_not_rewarded() -> None:
    env = TargetEnv(**{**OPTIONS, "horizon_s": 6.0})
    seen, _ = env.reset(seed=4)
    limit = 15.0 * float(seen[1])
    paid = []
    for _ in range(8):
        seen, _, terminated, truncated, info = env.step(np.array([1.0, 0.0], dtype=np.float32))
        if terminated or truncated:
            break
        paid.append((15.0 * float(seen[0]), info["reward_terms"]["progress"]))
    env.close()
    assert paid[-1][0] > limit + 2.0
    assert paid[-1][1] == pytest.approx(0.1 * 0.5 * limit)


def test_an_unknown_option() -> None:
    with pytest.raises(ConfigError, match="did you mean 'background'"):
        TargetEnv(backgrounds="sumo")
