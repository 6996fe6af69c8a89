"""Train a planner against traffic: PPO of stable-baselines3 on ``advdiff_sumo/Target-v0``, in several processes.

Usage: python examples/train_target.py [--steps 20000] [--workers 2] [--background sumo] [--net downtown]
       [--evaluate 40] [--out runs/train_target]

It writes ``policy.zip``, ``episodes.csv`` (the return of each training episode), ``evaluation.csv`` (the trained policy
and a random one with the same seeds) and ``curve.png`` into its folder. The package needs its extra ``rl``.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import gymnasium
import numpy as np
from matplotlib.figure import Figure
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import SubprocVecEnv, VecNormalize

ENVIRONMENT = "advdiff_sumo.rl:advdiff_sumo/Target-v0"
HORIZON_S, SCENES = 15.0, 16
HELD_OUT_SEED = 1_000_000  # first seed of evaluation; training uses other seeds
ROLLOUT, WINDOW = 512, 50  # steps of all processes between two updates; episodes of the moving mean

Act = Callable[[np.ndarray], np.ndarray]


class EpisodeReturn(NamedTuple):
    """A finished episode: environment steps so far, sum of rewards, length in steps, and reason for its end."""

    step: int
    reward: float
    length: int
    end: str


class Returns(BaseCallback):
    """Stores the return of every training episode, and prints their mean at each update."""

    def __init__(self) -> None:
        super().__init__()
        self.episodes: list[EpisodeReturn] = []

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "episode" in info:
                ended = info["episode"]
                self.episodes.append(EpisodeReturn(self.num_timesteps, ended["r"], ended["l"], info["end"]))
        return True

    def _on_rollout_end(self) -> None:
        latest = self.episodes[-WINDOW:]
        if latest:
            mean = np.mean([episode.reward for episode in latest])
            print(
                f"{self.num_timesteps:7d} steps: mean return of {len(latest)} episodes {mean:6.2f}",
                flush=True,
            )


def make(net: str, background: str) -> Monitor[np.ndarray, np.ndarray]:
    """Return an environment that records the return of each episode."""
    environment = gymnasium.make(
        ENVIRONMENT, net=net, background=background, horizon_s=HORIZON_S, scenes=SCENES
    )
    return Monitor(environment)


def train(
    steps: int, workers: int, net: str, background: str, folder: Path
) -> tuple[PPO, list[EpisodeReturn]]:
    """Train, save the policy, and return it with the training episodes.

    The initial policy keeps its speed and heading, with noise. Only the learner sees scaled rewards.
    """
    raw = SubprocVecEnv([lambda: make(net, background)] * workers, start_method="forkserver")
    envs = VecNormalize(raw, norm_obs=False, norm_reward=True, gamma=0.97)
    model = PPO(
        "MlpPolicy",
        envs,
        n_steps=min(ROLLOUT, steps) // workers,
        batch_size=min(64, steps),
        learning_rate=5e-4,
        gamma=0.97,
        policy_kwargs={"log_std_init": -1.0},
        seed=0,
        device="cpu",
    )
    returns = Returns()
    try:
        model.learn(steps, callback=returns)
    finally:
        envs.close()
    model.save(folder / "policy.zip")
    return model, returns.episodes


def evaluate(act: Act, episodes: int, net: str, background: str) -> list[EpisodeReturn]:
    """Return the results of *act* in episodes with held-out seeds."""
    env, returns = make(net, background), []
    for number in range(episodes):
        observation, _ = env.reset(seed=HELD_OUT_SEED + number)
        has_ended = False
        while not has_ended:
            observation, _, terminated, truncated, info = env.step(act(observation))
            has_ended = terminated or truncated
        returns.append(EpisodeReturn(number, info["episode"]["r"], info["episode"]["l"], info["end"]))
    env.close()
    return returns


def mean_interval(returns: Sequence[EpisodeReturn]) -> tuple[float, float]:
    """Return the mean return and half the width of its 95 % interval (normal)."""
    values = np.array([episode.reward for episode in returns])
    spread = float(values.std(ddof=1)) if len(values) > 1 else float("nan")
    return float(values.mean()), 1.96 * spread / float(np.sqrt(len(values)))


def tenths(episodes: Sequence[EpisodeReturn], steps: int) -> tuple[list[EpisodeReturn], list[EpisodeReturn]]:
    """Return the episodes that ended in the first and in the last tenth of *steps*."""
    first = [episode for episode in episodes if episode.step <= 0.1 * steps]
    return first, [episode for episode in episodes if episode.step > 0.9 * steps]


def draw(
    episodes: Sequence[EpisodeReturn], random: Sequence[EpisodeReturn], trained: Sequence[EpisodeReturn]
) -> Figure:
    """Return a figure with the return of every episode, their moving mean, and both policies on held-out seeds."""
    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    axes = figure.add_subplot()
    step = np.array([episode.step for episode in episodes])
    reward = np.array([episode.reward for episode in episodes])
    axes.plot(step, reward, ".", color="#9db4c0", markersize=3, label="training episode")
    if len(reward) >= WINDOW:
        moving = np.convolve(reward, np.ones(WINDOW) / WINDOW, "valid")
        axes.plot(
            step[WINDOW - 1 :], moving, color="#12355b", linewidth=2, label=f"mean of {WINDOW} episodes"
        )
    for returns, colour, name in (
        (random, "#c1443c", "random policy"),
        (trained, "#2e7d4f", "trained policy"),
    ):
        mean, half = mean_interval(returns)
        axes.axhline(mean, color=colour, linewidth=1.5, label=f"{name}, {len(returns)} held-out seeds")
        axes.axhspan(mean - half, mean + half, color=colour, alpha=0.15, linewidth=0)
    axes.set(xlabel="environment steps (0.5 s each)", ylabel="return of an episode")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", fontsize=8)
    return figure


def write(path: Path, **returns: Sequence[EpisodeReturn]) -> None:
    """Write a table of episodes with the policy's name in the first column."""
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(("policy", *EpisodeReturn._fields))
        table.writerows((name, *episode) for name, episodes in returns.items() for episode in episodes)


def main() -> None:
    """Read the command line, train, evaluate, and print the results."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--net", default="downtown")
    parser.add_argument("--background", default="sumo")
    parser.add_argument("--evaluate", type=int, default=40, help="episodes of each policy on held-out seeds")
    parser.add_argument("--out", type=Path, default=Path("runs/train_target"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    model, episodes = train(options.steps, options.workers, options.net, options.background, options.out)
    write(options.out / "episodes.csv", training=episodes)
    draws = np.random.default_rng(0)
    setting = (options.evaluate, options.net, options.background)
    random = evaluate(lambda _: draws.uniform(-1.0, 1.0, 2).astype(np.float32), *setting)
    trained = evaluate(lambda observation: model.predict(observation, deterministic=True)[0], *setting)
    write(options.out / "evaluation.csv", random=random, trained=trained)
    draw(episodes, random, trained).savefig(options.out / "curve.png", dpi=120)
    first, last = tenths(episodes, options.steps)
    for name, returns in (
        ("first tenth", first),
        ("last tenth", last),
        ("random", random),
        ("trained", trained),
    ):
        if returns:
            mean, half = mean_interval(returns)
            ends = ", ".join(f"{n} {end}" for end, n in _counts(returns))
            print(f"{name}: mean return {mean:.2f} ± {half:.2f} of {len(returns)} episodes ({ends})")
    print(f"see {options.out / 'curve.png'}")


def _counts(returns: Sequence[EpisodeReturn]) -> list[tuple[str, int]]:
    ends = sorted({episode.end for episode in returns})
    return [(end, sum(episode.end == end for episode in returns)) for end in ends]


if __name__ == "__main__":
    main()
