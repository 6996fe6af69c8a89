"""PPO of stable-baselines3, begun at the behaviour model, and the actor in it."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor, nn

from advdiff_sumo.rl.rl_options import PpoOptions
from advdiff_sumo.traffic.rl.actor import ActorNet


def new_ppo(env: VecEnv, options: PpoOptions, seed: int) -> PPO:
    """Return PPO whose actor is the behaviour model exactly: its mean deviation is zero everywhere."""
    sizes = list(options.hidden)
    model = PPO(
        "MlpPolicy",
        env,
        learning_rate=options.learning_rate,
        n_steps=options.n_steps,
        batch_size=options.batch_size,
        n_epochs=options.n_epochs,
        gamma=options.gamma,
        gae_lambda=options.gae_lambda,
        clip_range=options.clip_range,
        ent_coef=options.ent_coef,
        target_kl=options.target_kl,
        policy_kwargs={
            "net_arch": {"pi": sizes, "vf": sizes},
            "activation_fn": nn.Tanh,
            "log_std_init": options.log_std,
        },
        seed=seed,
        device="cpu",
    )
    model.set_logger(Logger(folder=None, output_formats=[]))  # its own leaves a folder of temporary files
    head = model.policy.action_net
    with torch.no_grad():
        for weight in head.parameters():
            weight.zero_()
    return model


def actor_net(model: PPO, options: PpoOptions) -> ActorNet:
    """Return the mean of the policy as a network of our own, which needs PyTorch alone."""
    net = ActorNet(options.hidden)
    state = model.policy.state_dict()
    theirs = _part(state, "mlp_extractor.policy_net.")
    net.body.load_state_dict(theirs)
    net.head.load_state_dict(_part(state, "action_net."))
    return net.eval().requires_grad_(False)


def _part(state: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): t.clone() for name, t in state.items() if name.startswith(prefix)}
