"""The reward model for run time: ``RewardModel.value_of``, on a CPU by machine code that is made of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from torch import Tensor, nn

from advdiff_sumo.diffusion.machine_code import machine_code, package_for
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
        self._code = machine_code(reward_package(reward.options), "reward", reward) if compiled else None

    def condition(self, state: RewardState) -> Callable[[Tensor], Tensor]:
        """Return Q (B,) of actions (B, A, Z) in *state*, with gradients to them."""
        code, held = self._code, tensors_of(state)
        if code is None:
            return lambda mu: self._net.value_of(state, mu)
        return lambda mu: code([mu], held)[0]


def tensors_of(state: RewardState) -> tuple[Tensor, ...]:
    """Return the tensors of *state*."""
    return (state.node, state.present, state.target, *state.edges)


def reward_package(options: ModelOptions) -> Path:
    """Return where the machine code for reward models of *options* ships, if it does."""
    return package_for("reward", options.model_dump(mode="json", include=set(_SIZES)))
