"""Denoiser and reward model at run time: on CPUs by machine code compiled from their own methods.

The parts that do not depend on noisy sample or action are computed once a plan.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

from advdiff_sumo.diffusion.guides import Sloped, autograd_slope
from advdiff_sumo.diffusion.machine_code import machine_code, package_for
from advdiff_sumo.diffusion.sampler import Noise
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.denoiser import STEP_WIDTH, Denoiser, Prepared, sinusoidal
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.reward import RewardModel, RewardState

_OF_DENOISER = ("hidden", "latent", "edge", "message", "heads", "channels", "denoiser_layers")
_OF_REWARD = ("latent", "message", "heads", "interaction_layers", "reward_hidden")
"""Options that the machine code of each network depends on."""


class PredictionOnTensors(nn.Module):
    """``Denoiser.predict`` of *denoiser* as a module of tensors, to be compiled."""

    def __init__(self, denoiser: Denoiser) -> None:
        super().__init__()
        self.denoiser = denoiser

    def forward(self, free: Sequence[Tensor], held: Sequence[Tensor]) -> tuple[Tensor]:
        """Return the predicted noise (B, A, C, L) for noisy samples and steps in *free*; *held* is a ``Prepared``."""
        x, step = free
        return (self.denoiser.predict(x, step, Prepared(*held)),)


def fast_denoiser(denoiser: Denoiser, compiled: bool = True) -> Callable[[Context], Noise]:
    """Return a function from a context to ε(x, k), without gradients; *compiled*: by machine code, if any."""
    package = denoiser_package(denoiser.options, denoiser.shape)
    code = machine_code(package, PredictionOnTensors(denoiser)) if compiled else None

    @torch.no_grad()
    def condition(context: Context) -> Noise:
        given = denoiser.prepare(context)
        scenes, device = len(context.h), context.h.device

        @torch.no_grad()
        def noise(x: Tensor, k: int) -> Tensor:
            step = sinusoidal(torch.full((scenes,), k, device=device), STEP_WIDTH)
            return denoiser.predict(x, step, given) if code is None else code([x, step], given)[0]

        return noise

    return condition


def denoiser_package(options: ModelOptions, shape: tuple[int, int]) -> Path:
    """Return the path of the machine code for denoisers of *options* and *shape*, which may not exist."""
    sizes = options.model_dump(mode="json", include=set(_OF_DENOISER))
    return package_for("denoiser", {**sizes, "shape": list(shape)})


class RewardOnTensors(nn.Module):
    """``RewardModel.value_of`` of *reward* as a module of tensors, to be compiled."""

    def __init__(self, reward: RewardModel) -> None:
        super().__init__()
        self.reward = reward

    def forward(self, free: Sequence[Tensor], held: Sequence[Tensor]) -> tuple[Tensor]:
        """Return Q (B,) of the actions in *free*; *held* are node, present, target and edges of the state."""
        node, present, target, *edges = held
        return (self.reward.value_of(RewardState(node, edges, present, target), free[0]),)


def fast_reward(reward: RewardModel, compiled: bool = True) -> Callable[[RewardState], Sloped]:
    """Return a function from a state to Q (B,) of actions (B, A, Z), with gradient; *compiled* copies the weights."""
    code = machine_code(reward_package(reward.options), RewardOnTensors(reward)) if compiled else None

    def condition(state: RewardState) -> Sloped:
        held = (state.node, state.present, state.target, *state.edges)

        def value(mu: Tensor) -> Tensor:
            return reward.value_of(state, mu) if code is None else code([mu], held)[0]

        @torch.no_grad()
        def slope(mu: Tensor) -> Tensor:
            if code is None or not code.fitting.holds([mu, *held]):
                return autograd_slope(value, mu)
            return code.slope([mu, *held, mu.new_ones(len(mu))])[0]

        return Sloped(value, slope)

    return condition


def reward_package(options: ModelOptions) -> Path:
    """Return the path of the machine code for reward models of *options*, which may not exist."""
    return package_for("reward", options.model_dump(mode="json", include=set(_OF_REWARD)))
