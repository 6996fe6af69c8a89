"""The reward model for run time: ``RewardModel.value_of``, on a CPU by machine code that is made of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

from advdiff_sumo.diffusion.guides import autograd_slope
from advdiff_sumo.diffusion.machine_code import MachineCode, machine_code, package_for
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.reward import RewardModel, RewardState

_SIZES = ("latent", "message", "heads", "interaction_layers", "reward_hidden")
"""Options that the code of a reward model depends on."""


class RewardOnTensors(nn.Module):
    """``RewardModel.value_of`` with tensors for arguments.

    Args:
        reward: whose value it is.
    """

    def __init__(self, reward: RewardModel) -> None:
        super().__init__()
        self.reward = reward

    def forward(self, free: Sequence[Tensor], held: Sequence[Tensor]) -> tuple[Tensor]:
        """Return Q (B,) of actions in *free*; *held* is of :func:`tensors_of`."""
        node, present, target, *edges = held
        return (self.reward.value_of(RewardState(node, edges, present, target), free[0]),)


class FastReward:
    """Q of one network.

    Args:
        reward: the network; machine code takes its weights as they are now.
        compiled: use machine code where there is any for it.
    """

    def __init__(self, reward: RewardModel, compiled: bool = True) -> None:
        self._net = reward
        package = reward_package(reward.options)
        self._code = machine_code(package, RewardOnTensors(reward)) if compiled else None

    def condition(self, state: RewardState) -> RewardObjective:
        """Return Q (B,) of actions (B, A, Z) in *state*, which knows its own slope."""
        return RewardObjective(self._net, self._code, state)


class RewardObjective:
    """Q in one state.

    Args:
        net: the network.
        code: its machine code, where there is any.
        state: of :meth:`RewardModel.prepare`.
    """

    def __init__(self, net: RewardModel, code: MachineCode | None, state: RewardState) -> None:
        self._net, self._code, self._state = net, code, state
        self._held = tensors_of(state)

    def __call__(self, mu: Tensor) -> Tensor:
        """Return Q (B,) of actions (B, A, Z), with gradients to them."""
        if self._code is None:
            return self._net.value_of(self._state, mu)
        return self._code([mu], self._held)[0]

    @torch.no_grad()
    def slope(self, mu: Tensor) -> Tensor:
        """Return the gradient (B, A, Z) at actions *mu* (B, A, Z)."""
        if self._code is None or not self._code.fits([mu, *self._held]):
            return autograd_slope(self, mu)
        return self._code.slope([mu, *self._held, mu.new_ones(len(mu))])[0]


def tensors_of(state: RewardState) -> tuple[Tensor, ...]:
    """Return the tensors of *state*."""
    return (state.node, state.present, state.target, *state.edges)


def reward_package(options: ModelOptions) -> Path:
    """Return where the machine code for reward models of *options* ships, if it does."""
    return package_for("reward", options.model_dump(mode="json", include=set(_SIZES)))
