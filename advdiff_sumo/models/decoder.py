"""Autoregressive trajectory decoder D(z, h): interaction net → action → bicycle model → GRU (Sec. III-B)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Tensor, nn

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.geometry import into_frame, relative_features
from advdiff_sumo.models.interaction import InteractionNet
from advdiff_sumo.models.model_options import FUTURE_STEPS, MODEL_STEP_S, ModelOptions
from advdiff_sumo.models.tensor_bicycle import controls, step

Motion: TypeAlias = tuple[Tensor, Tensor, Tensor]
"""xy (B, A, 2), yaw (B, A) and speed (B, A)."""
State: TypeAlias = tuple[Tensor, Tensor, Tensor, Tensor, Tensor]
"""A motion, with the acceleration (B, A) and curvature (B, A) that led there."""
_MOTION = 6


@dataclass(frozen=True)
class Rollout:
    """Joint futures, first instant one model step after now, in the scene's frame.

    Attributes:
        xy: (B, A, T, 2) box centres.
        yaw: (B, A, T) headings.
        speed: (B, A, T) speeds.
        accel: (B, A, T) acceleration held up to each instant.
        curvature: (B, A, T) curvature held up to each instant.
    """

    xy: Tensor
    yaw: Tensor
    speed: Tensor
    accel: Tensor
    curvature: Tensor

    def states(self) -> Tensor:
        """Return (B, A, T, 4) x, y, yaw, speed."""
        return torch.cat((self.xy, self.yaw[..., None], self.speed[..., None]), dim=-1)


@dataclass(frozen=True)
class Forced:
    """Agents whose future is given, such as a target that replays its log; the others react to it.

    Attributes:
        states: (B, A, T, 4) x, y, yaw, speed.
        mask: (B, A, T) where they are given.
    """

    states: Tensor
    mask: Tensor

    def applied(self, k: int, xy: Tensor, yaw: Tensor, speed: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return (B, A, 2), (B, A), (B, A) states at instant *k*, with those that are given in their place."""
        given, mask = self.states[:, :, k], self.mask[:, :, k]
        return (
            torch.where(mask[..., None], given[..., :2], xy),
            torch.where(mask, given[..., 2], yaw),
            torch.where(mask, given[..., 3], speed),
        )

    def put(self, k: int, state: State) -> State:
        """Return *state* with what is given of instant *k* in its place."""
        return (*self.applied(k, *state[:3]), *state[3:])


class Decoder(nn.Module):
    """Twelve steps of half a second; every vehicle sees where the others have got to in the same rollout."""

    def __init__(self, options: ModelOptions) -> None:
        super().__init__()
        self.options = options
        width = options.hidden
        self.start = nn.Linear(width + options.latent, width)
        self.node = nn.Linear(width + options.latent + _MOTION, width)
        self.interaction = InteractionNet(width, options, options.decoder_layers)
        self.action = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 2))
        self.memory = nn.GRUCell(width + 2, width)

    def forward(
        self,
        z: Tensor,
        h: Tensor,
        batch: SceneBatch,
        steps: int = FUTURE_STEPS,
        forced: Forced | None = None,
    ) -> Rollout:
        """Return the futures that latents lead to.

        Agents that are no vehicles keep their velocity.

        Args:
            z: (B, A, Z) latents.
            h: (B, A, D) embeddings of the context.
            batch: the scenes.
            steps: model steps to roll out.
            forced: agents whose future is given.
        """
        memory = torch.tanh(self.start(torch.cat((h, z), dim=-1)))
        motion = motion_now(batch)
        states = []
        for k in range(steps):
            moved = motion_features(*motion, batch)
            node = torch.relu(self.node(torch.cat((memory, z, moved), dim=-1)))
            mixed = self.interaction(node, relative_features(*motion), batch.present)
            state, memory = self._drive(mixed, memory, motion, batch)
            states.append(state if forced is None else forced.put(k, state))
            motion = states[-1][:3]
        return rollout_of(states)

    def _drive(
        self, mixed: Tensor, memory: Tensor, motion: Motion, batch: SceneBatch
    ) -> tuple[State, Tensor]:
        """Return where agents who see *mixed* (B, A, D) get to in a step, and their memory of it."""
        accel, curvature = controls(self.action(mixed), motion[2], batch.size[..., 0], self.options)
        accel, curvature = accel * batch.moved, curvature * batch.moved
        motion = step(*motion, accel, curvature, MODEL_STEP_S)
        return (*motion, accel, curvature), self._remember(mixed, accel, curvature, memory)

    def _remember(self, mixed: Tensor, accel: Tensor, curvature: Tensor, memory: Tensor) -> Tensor:
        done = torch.stack((0.25 * accel, 10.0 * curvature), dim=-1)
        inputs = torch.cat((mixed, done), dim=-1)
        new: Tensor = self.memory(inputs.flatten(0, 1), memory.flatten(0, 1))
        return new.reshape(memory.shape)


def motion_now(batch: SceneBatch) -> Motion:
    """Return where the agents of *batch* begin."""
    pose = batch.pose
    return pose[..., :2], pose[..., 2], pose[..., 3].clamp(min=0.0)


def rollout_of(states: Sequence[State]) -> Rollout:
    """Return the instants *states* as one roll-out."""
    return Rollout(*(torch.stack(column, dim=2) for column in zip(*states, strict=True)))


def motion_features(xy: Tensor, yaw: Tensor, speed: Tensor, batch: SceneBatch) -> Tensor:
    """Return (B, A, 6) how far each agent of *batch* has come: (B, A, 2) places, (B, A) headings and speeds."""
    pose = batch.pose
    moved = 0.05 * into_frame(xy, pose[..., :2], pose[..., 2])
    turn = yaw - pose[..., 2]
    columns = (torch.cos(turn), torch.sin(turn), 0.1 * speed, 0.1 * (speed - pose[..., 3]))
    return torch.cat((moved, torch.stack(columns, dim=-1)), dim=-1)
