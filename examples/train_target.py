"""Trains a planner against traffic: PPO of stable-baselines3 on ``advdiff_sumo/Target-v0``, in several processes.

Usage: python examples/train_target.py [--steps 20000] [--workers 2] [--background sumo] [--out target_ppo.zip]

Prints the mean reward of an episode after each update; it is to rise. The package needs its extra ``rl``.
"""

from __future__ import annotations

import argparse

import gymnasium
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import SubprocVecEnv

OPTIONS = {"net": "downtown", "horizon_s": 15.0, "scenes": 16}


class Curve(BaseCallback):
    """Prints and keeps the mean reward of the last hundred episodes at each update."""

    def __init__(self) -> None:
        super().__init__()
        self.points: list[tuple[int, float]] = []

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        if self.model.ep_info_buffer:
            mean = float(np.mean([episode["r"] for episode in self.model.ep_info_buffer]))
            self.points.append((self.num_timesteps, mean))
            print(f"{self.num_timesteps:7d} steps: mean reward {mean:6.2f}", flush=True)


def make(background: str) -> Monitor[object, object]:
    """Return one environment, with its rewards watched."""
    return Monitor(gymnasium.make("advdiff_sumo.rl:advdiff_sumo/Target-v0", background=background, **OPTIONS))


def train(steps: int, workers: int, background: str, out: str) -> list[tuple[int, float]]:
    """Train and save a policy; return (steps, mean reward) of every update."""
    envs = SubprocVecEnv([lambda: make(background)] * workers, start_method="forkserver")
    model = PPO("MlpPolicy", envs, n_steps=512 // workers, batch_size=128, gamma=0.95, seed=0, device="cpu")
    curve = Curve()
    model.learn(steps, callback=curve)
    model.save(out)
    envs.close()
    return curve.points


def main() -> None:
    """Read the command line and train."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--background", default="sumo")
    parser.add_argument("--out", default="target_ppo.zip")
    given = parser.parse_args()
    train(given.steps, given.workers, given.background, given.out)


if __name__ == "__main__":
    main()
