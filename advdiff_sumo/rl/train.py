"""Trains an attacker by the PPO of stable-baselines3, starting from the behaviour model.

The training is kept in a folder and can be resumed. The resulting actor requires only PyTorch.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv
from torch import Tensor, nn

from advdiff_sumo.core.errors import WeightsError
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.core.worker_start import ignore_interrupts, worker_context
from advdiff_sumo.rl import ENVIRONMENT
from advdiff_sumo.rl.rl_options import AdversaryOptions, PpoOptions
from advdiff_sumo.rl.watch import ProgressListener, Watch
from advdiff_sumo.traffic.rl.actor import Actor, ActorNet, save_actor
from advdiff_sumo.training import checkpoint, history
from advdiff_sumo.training.interrupt import graceful

STAGE = "adv-rl"
ACTOR = "actor.safetensors"
_NEVER = 2**62
"""Log interval of stable-baselines3 that is never reached."""


@dataclass(frozen=True)
class PpoTraining:
    """A training.

    Attributes:
        out: its folder.
        steps: total steps of all environments.
        seed: seed of all random numbers.
        adversary: options of the environment.
        ppo: hyper-parameters.
        workers: number of environments; several run in one process each.
    """

    out: Path
    steps: int
    seed: int
    adversary: AdversaryOptions
    ppo: PpoOptions
    workers: int = 1

    def options(self) -> dict[str, Any]:
        """Return the options that must not change when the training is resumed."""
        return {"adversary": self.adversary.model_dump(mode="json"), "ppo": self.ppo.model_dump(mode="json")}


def train(plan: PpoTraining, resume: bool, on_progress: ProgressListener) -> checkpoint.TrainingProgress:
    """Start or resume a training; write actor, checkpoint, metrics.jsonl, curves.png and TensorBoard events.

    An interrupt loses what was collected since the last update, and a resumed training begins new episodes. The same
    seed gives the same weights if the training is not interrupted.

    Raises:
        InputError: the options cannot be used, or the folder's checkpoint is another training's.
        KeyboardInterrupt: the user interrupted the training; the last update is saved.
    """
    progress = checkpoint.TrainingProgress(STAGE, plan.options(), data="", seed=plan.seed)
    groups: dict[str, Any] = {}
    if resume:
        progress, groups = checkpoint.load(plan.out)
        if progress.stage != STAGE or progress.options != plan.options():
            raise WeightsError(
                plan.out / checkpoint.NAME,
                "is of a training with other options",
                "resume without changing them",
            )
        if progress.seed not in (None, plan.seed):
            raise WeightsError(
                plan.out / checkpoint.NAME, f"was begun with seed {progress.seed}", "resume with that one"
            )
    seed = SeedTree(plan.seed).child("ppo", progress.step)
    envs = make_envs(plan.adversary, plan.workers)
    try:
        model = new_ppo(envs, plan.ppo, seed.integer())
        if groups:
            model.policy.load_state_dict(groups["policy"])
            checkpoint.restore_optimiser(model.policy.optimizer, groups["optimiser"])
        _learn(model, plan, progress, on_progress)
    finally:
        envs.close()
    return progress


def _learn(
    model: PPO, plan: PpoTraining, progress: checkpoint.TrainingProgress, on_progress: ProgressListener
) -> None:
    events = history.open_events(plan.out / "events", progress.step) or history.NoEvents()

    def save() -> None:
        progress.step, progress.epoch = model.num_timesteps, len(progress.history)
        progress.done = progress.step >= plan.steps
        for name, value in progress.history[-1]["train"].items():
            events.add_scalar(f"train/{name}", value, progress.step)
        write(model, plan, progress)

    model.num_timesteps = progress.step
    with graceful() as stop_request:
        watch = Watch(progress.history, save, on_progress, stop_request)
        steps_left = plan.steps - progress.step
        if steps_left > 0:
            model.learn(steps_left, callback=watch, log_interval=_NEVER, reset_num_timesteps=False)
    events.close()
    if not progress.history:
        write(model, plan, progress)
    if stop_request:
        raise KeyboardInterrupt


def write(model: PPO, plan: PpoTraining, progress: checkpoint.TrainingProgress) -> None:
    """Write the checkpoint, the actor and the curves."""
    policy = model.policy
    groups = {
        "policy": policy.state_dict(),
        "optimiser": checkpoint.optimiser_tensors(policy.optimizer),
    }
    checkpoint.save(plan.out, progress, groups)
    actor = Actor(actor_net(model, plan.ppo), plan.ppo.hidden, plan.adversary.prior, _notes(plan, progress))
    save_actor(actor, plan.out / ACTOR)
    if progress.history:
        history.write_lines(plan.out / "metrics.jsonl", progress.history)
        history.draw_curves(plan.out / "curves.png", STAGE, progress.history)


def _notes(plan: PpoTraining, progress: checkpoint.TrainingProgress) -> dict[str, Any]:
    adversary = plan.adversary
    return {
        "steps": progress.step,
        "seed": plan.seed,
        "nets": list(adversary.nets),
        "targets": list(adversary.targets),
        "scenes": adversary.scenes,
        "horizon_s": adversary.horizon_s,
    }


def make_envs(options: AdversaryOptions, workers: int) -> VecEnv:
    """Return *workers* environments; several run in one process each, as libsumo runs one simulation per process."""
    values = options.model_dump()
    makers = [_maker(values) for _ in range(workers)]
    if workers == 1:
        return DummyVecEnv(makers)
    start_method = worker_context([__name__]).get_start_method()
    return SubprocVecEnv(makers, start_method=start_method)


def _maker(values: dict[str, Any]) -> Callable[[], gymnasium.Env[Any, Any]]:
    def make() -> gymnasium.Env[Any, Any]:
        import advdiff_sumo.rl  # noqa: F401 - registers the environment in a new process

        if multiprocessing.parent_process() is not None:
            ignore_interrupts()
        return gymnasium.make(ENVIRONMENT, disable_env_checker=True, **values)

    return make


def new_ppo(env: VecEnv, options: PpoOptions, seed: int) -> PPO:
    """Return a PPO model whose actor is exactly the behaviour model: its mean deviation is zero everywhere."""
    widths = list(options.hidden)
    model = PPO(
        "MlpPolicy",
        env,
        **options.model_dump(exclude={"log_std", "hidden"}),
        policy_kwargs={
            "net_arch": {"pi": widths, "vf": widths},
            "activation_fn": nn.Tanh,
            "log_std_init": options.log_std,
        },
        seed=seed,
        device="cpu",
    )
    model.set_logger(
        Logger(folder=None, output_formats=[])
    )  # the default one leaves a folder of temporary files
    head = model.policy.action_net
    with torch.no_grad():
        for weight in head.parameters():
            weight.zero_()
    return model


def actor_net(model: PPO, options: PpoOptions) -> ActorNet:
    """Return the mean of the policy as an :class:`ActorNet`, which requires only PyTorch."""
    net = ActorNet(options.hidden)
    state = model.policy.state_dict()
    net.body.load_state_dict(_state_of(state, "mlp_extractor.policy_net."))
    net.head.load_state_dict(_state_of(state, "action_net."))
    return net.eval().requires_grad_(False)


def _state_of(state: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): t.clone() for name, t in state.items() if name.startswith(prefix)}
