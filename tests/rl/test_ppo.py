"""PPO: its start, that it learns, that its actor equals its policy, and that a training can be resumed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3.common.vec_env import DummyVecEnv

from advdiff_sumo.core.errors import ConfigError, WeightsError
from advdiff_sumo.rl.rl_options import PpoOptions, adversary_options
from advdiff_sumo.rl.train import ACTOR, PpoTraining, actor_net, new_ppo, train
from advdiff_sumo.traffic.rl.actor import ACTIONS, load_actor
from advdiff_sumo.traffic.rl.features import FEATURES, LIMIT

QUICK = PpoOptions(n_steps=128, batch_size=32, learning_rate=3e-3, hidden=(16,), target_kl=0.1)
WISH = np.array([0.6, -0.4])


class Toy(gymnasium.Env[np.ndarray, np.ndarray]):
    """Eight steps that reward actions near a certain action."""

    def __init__(self) -> None:
        self.observation_space = gymnasium.spaces.Box(-LIMIT, LIMIT, (FEATURES,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (ACTIONS,), np.float32)
        self.left = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        self.left = 8
        return np.ones(FEATURES, dtype=np.float32), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        self.left -= 1
        paid = -float(((action - WISH) ** 2).sum())
        return np.ones(FEATURES, dtype=np.float32), paid, self.left == 0, False, {}


def learnt(steps: int) -> np.ndarray:
    model = new_ppo(DummyVecEnv([Toy]), QUICK, seed=1)
    model.learn(steps, log_interval=None)
    with torch.no_grad():
        return np.asarray(actor_net(model, QUICK)(torch.ones(FEATURES)))


def test_it_starts_at_the_behaviour_model() -> None:
    model = new_ppo(DummyVecEnv([Toy]), QUICK, seed=1)
    seen = np.random.default_rng(0).normal(size=(7, FEATURES)).astype(np.float32)
    assert not model.predict(seen, deterministic=True)[0].any()
    assert model.policy.log_std.tolist() == [-1.0, -1.0]


def test_it_increases_the_reward() -> None:
    """The actor's action ends at most half as far from the best action as at the start."""
    after = learnt(1280)
    assert np.linalg.norm(after - WISH) < 0.5 * np.linalg.norm(WISH)
    assert learnt(256).tobytes() == learnt(256).tobytes()


def test_the_actor_equals_the_policy() -> None:
    model = new_ppo(DummyVecEnv([Toy]), QUICK, seed=2)
    model.learn(128, log_interval=None)
    seen = np.random.default_rng(0).normal(size=(9, FEATURES)).astype(np.float32)
    theirs, _ = model.predict(seen, deterministic=True)
    ours = actor_net(model, QUICK)(torch.from_numpy(seen)).clamp(-1.0, 1.0)
    np.testing.assert_allclose(ours.numpy(), theirs, atol=1e-6)
    assert np.abs(theirs).max() > 0.0


def plan(settings: dict[str, Any], out: Path, steps: int, **ppo: Any) -> PpoTraining:
    values = {"n_steps": 8, "batch_size": 4, "n_epochs": 2, "hidden": (8,), **ppo}
    out.mkdir(exist_ok=True)
    return PpoTraining(out, steps, 5, adversary_options(settings), PpoOptions.parse(values))


def test_a_training_writes_an_actor_and_can_be_resumed(settings: dict[str, Any], tmp_path: Path) -> None:
    told: list[int] = []
    done = train(plan(settings, tmp_path / "a", 8), False, lambda steps, _: told.append(steps))
    assert told == list(range(1, 9))
    assert (done.step, done.epoch, done.done) == (8, 1, True)
    first = load_actor(tmp_path / "a" / ACTOR)
    assert first.prior == "traffic"
    assert first.notes["steps"] == 8
    assert first.net.head.weight.abs().max() > 0.0, "one update has moved it"
    again = train(plan(settings, tmp_path / "b", 8), False, lambda *_: None)
    assert again.history == done.history
    assert (tmp_path / "b" / ACTOR).read_bytes() == (tmp_path / "a" / ACTOR).read_bytes()
    more = train(plan(settings, tmp_path / "a", 16), True, lambda *_: None)
    assert (more.step, more.epoch) == (16, 2)
    records = [json.loads(line) for line in (tmp_path / "a" / "metrics.jsonl").read_text().splitlines()]
    assert [record["step"] for record in records] == [8, 16]
    assert {"policy_loss", "value_loss", "kl", "deviation", "near_per_step"} <= set(records[0]["train"])
    assert sum(record["train"]["episodes"] for record in records) == 2, "six steps each, begun anew"
    assert (tmp_path / "a" / "curves.png").stat().st_size > 1000
    with pytest.raises(WeightsError, match="is of a training with other options"):
        train(plan(settings, tmp_path / "a", 24, gamma=0.5), True, lambda *_: None)


def test_the_batch_size_must_divide_the_steps() -> None:
    with pytest.raises(ConfigError, match="n_steps = 100 is no multiple of batch_size = 64"):
        PpoOptions.parse({"n_steps": 100}, "options of ppo")
