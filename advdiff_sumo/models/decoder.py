"""Autoregressive trajectory decoder D(z, h): interaction net → action → bicycle model → GRU (Sec. III-B)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Tensor, nn

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.geometry import into_frame, relative_features
from advdiff_sumo.models.interaction import InteractionNet
from advdiff_sumo.models.model_options import FUTURE_STEPS, MODEL_STEP_S, ModelOptions
from advdiff_sumo.models.perceptron import perceptron
from advdiff_sumo.models.tensor_bicycle import controls
from advdiff_sumo.models.tensor_bicycle import step as bicycle_step

Motion: TypeAlias = tuple[Tensor, Tensor, Tensor]
"""Positions (B, A, 2), headings (B, A) and speeds (B, A)."""
State: TypeAlias = tuple[Tensor, Tensor, Tensor, Tensor, Tensor]
"""A motion, with the accelerations (B, A) and curvatures (B, A) of the step that led to it."""
Step: TypeAlias = Callable[
    [Tensor, Tensor, "Surroundings", Motion, Motion, Tensor | None], tuple[State, Tensor, Tensor]
]
""":meth:`Decoder.step`, or machine code of it."""
_MOTION = 6


@dataclass(frozen=True)
class Rollout:
    """Joint futures in the scene's frame; the first instant is one model step after now.

    Attributes:
        xy: (B, A, T, 2) box centres.
        yaw: (B, A, T) headings.
        speed: (B, A, T) speeds.
        accel: (B, A, T) constant acceleration of the step that ends at each instant.
        curvature: (B, A, T) constant curvature of the same step.
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
class Trace:
    """States and messages of all agents at each step of a rollout, for later rollouts of some of them.

    Attributes:
        motion: (T, B, A, 4) x, y, yaw, speed at the beginning of each step.
        senders: (T, layers, B, A, M) contribution of each sender to the messages.
    """

    motion: Tensor
    senders: Tensor

    def repeat(self, times: int) -> Trace:
        """Return the trace of one scene repeated *times* times."""
        return Trace(self.motion.expand(-1, times, -1, -1), self.senders.expand(-1, -1, times, -1, -1))


@dataclass(frozen=True)
class Forced:
    """Given futures of some agents, such as a target that replays its log; the others react to them.

    Attributes:
        states: (B, A, T, 4) x, y, yaw, speed.
        mask: (B, A, T) where the state is given.
    """

    states: Tensor
    mask: Tensor

    def put(self, k: int, state: State) -> State:
        """Return *state* with the given states of instant *k* in place of the computed ones."""
        states, mask = self.states[:, :, k], self.mask[:, :, k]
        xy, yaw, speed, *action = state
        return (
            torch.where(mask[..., None], states[..., :2], xy),
            torch.where(mask, states[..., 2], yaw),
            torch.where(mask, states[..., 3], speed),
            action[0],
            action[1],
        )


@dataclass(frozen=True)
class Surroundings:
    """Inputs that are constant during a rollout of R rows.

    Attributes:
        batch: the scenes with all A agents.
        own: the same scenes with only the rows.
        rows: (R,) agents that are rolled out.
    """

    batch: SceneBatch
    own: SceneBatch
    rows: Tensor


class Decoder(nn.Module):
    """Twelve steps of half a second, in which every vehicle observes the others' states in the same rollout."""

    def __init__(self, options: ModelOptions) -> None:
        super().__init__()
        self.options = options
        width = options.hidden
        self.start = nn.Linear(width + options.latent, width)
        self.node = nn.Linear(width + options.latent + _MOTION, width)
        self.interaction = InteractionNet(width, options, options.decoder_layers)
        self.action = perceptron(width, width, 2)
        self.memory = nn.GRUCell(width + 2, width)
        self._compiled: Step | None = None

    def forward(
        self,
        z: Tensor,
        h: Tensor,
        batch: SceneBatch,
        steps: int = FUTURE_STEPS,
        forced: Forced | None = None,
        by: Step | None = None,
    ) -> Rollout:
        """Return futures of *steps* instants for latents *z* (B, A, Z) and context embeddings *h* (B, A, D).

        Agents that are no vehicles keep their velocity; *forced* ones follow their given states. *by* replaces
        :meth:`step`.
        """
        return rollout_of(self._roll(z, h, self.surroundings(batch), steps, forced, None, by)[0])

    def roll(
        self,
        z: Tensor,
        h: Tensor,
        around: Surroundings,
        steps: int,
        forced: Forced | None = None,
        trace: Trace | None = None,
        by: Step | None = None,
    ) -> tuple[Rollout, Trace]:
        """Return futures and trace of the rows of *around* for their latents *z* (B, R, Z), embeddings *h* (B, R, D).

        States and messages of all other agents are those of *trace*; None: the rows are all agents.
        """
        states, motions, messages = self._roll(z, h, around, steps, forced, trace, by)
        traced = [torch.cat((xy, yaw[..., None], speed[..., None]), dim=-1) for xy, yaw, speed in motions]
        return rollout_of(states), Trace(torch.stack(traced), torch.stack(messages))

    def _roll(
        self,
        z: Tensor,
        h: Tensor,
        around: Surroundings,
        steps: int,
        forced: Forced | None,
        trace: Trace | None,
        by: Step | None,
    ) -> tuple[list[State], list[Motion], list[Tensor]]:
        """Return, for each step of :meth:`roll`, the state after it, all agents' motion before it, and messages."""
        own = self._compiled if trace is None and torch.is_grad_enabled() else None
        advance, rows = by or own or self.step, around.rows
        memory = self.begin(z, h)
        motion = motion_now(around.own)
        states, motions, messages = list[State](), list[Motion](), list[Tensor]()
        for k in range(steps):
            everybody = motion if trace is None else self._among(trace.motion[k], rows, motion)
            others = None if trace is None else trace.senders[k]
            state, memory, senders = advance(memory, z, around, motion, everybody, others)
            motions.append(everybody)
            messages.append(senders)
            states.append(state if forced is None else forced.put(k, state))
            motion = states[-1][:3]
        return states, motions, messages

    def surroundings(self, batch: SceneBatch, rows: Tensor | None = None) -> Surroundings:
        """Return the constant inputs of a rollout of agents *rows* (R,) of *batch*; None: of all."""
        if rows is None:
            return Surroundings(batch, batch, torch.arange(batch.agents, device=batch.past.device))
        return Surroundings(batch, batch.rows_of(rows), rows)

    def _among(self, traced: Tensor, rows: Tensor, motion: Motion) -> Motion:  # noqa: ARG002 - for decoders that use them
        """Return the motion of all agents that *rows* observe: that of the trace (B, A, 4), for the rows, too."""
        return traced[..., :2], traced[..., 2], traced[..., 3]

    def step(
        self,
        memory: Tensor,
        z: Tensor,
        around: Surroundings,
        motion: Motion,
        everybody: Motion,
        others: Tensor | None,
    ) -> tuple[State, Tensor, Tensor]:
        """Return the rows' state after a step, their new memory, and all agents' messages (layers, B, A, M)."""
        edges = self.edges(everybody, None if others is None else around.rows)
        return self.advance(memory, z, around, motion, edges, others)

    def edges(self, everybody: Motion, rows: Tensor | None) -> list[Tensor]:
        """Return, for each graph layer, embedded poses (B, R, A, M) of all agents relative to *rows*; None: to all."""
        return self.interaction.prepare(relative_features(*everybody, rows))

    def begin(self, z: Tensor, h: Tensor) -> Tensor:
        """Return the initial memory (B, R, D) of a rollout."""
        return torch.tanh(self.start(torch.cat((h, z), dim=-1)))

    def advance(
        self,
        memory: Tensor,
        z: Tensor,
        around: Surroundings,
        motion: Motion,
        edges: list[Tensor],
        others: Tensor | None,
    ) -> tuple[State, Tensor, Tensor]:
        """Return :meth:`step` with relative poses already embedded in *edges*."""
        moved = motion_features(*motion, around.own)
        node = torch.relu(self.node(torch.cat((memory, z, moved), dim=-1)))
        mixed, senders = self._mix(node, edges, around, others, lambda values: values[:, None])
        state, memory = self._drive(mixed, memory, motion, around.own)
        return state, memory, senders

    def _mix(
        self,
        h: Tensor,
        edges: list[Tensor],
        around: Surroundings,
        others: Tensor | None,
        among: Callable[[Tensor], Tensor],
    ) -> tuple[Tensor, Tensor]:
        """Return the rows' embeddings after the interaction net, and the messages sent by all agents.

        Args:
            h: (B, R, D) the rows' embeddings.
            edges: for each layer, what relative poses add to the messages.
            around: the scenes.
            others: (layers, B, A, M) messages of agents that are not rolled out; None: all agents are.
            among: selects, from values of all agents (B, A, …), those of each row's senders, (B, R or 1, K, …).
        """
        messages, mask = [], among(around.batch.present)
        for number, (layer, edge) in enumerate(zip(self.interaction.in_order(), edges, strict=True)):
            sent = layer.sender(h)
            if others is not None:
                sent = others[number].to(sent.dtype).index_copy(1, around.rows, sent)
            messages.append(sent)
            h = layer.receive(h, edge, among(sent), mask) * around.own.present[..., None]
        return h, torch.stack(messages)

    def _drive(
        self, mixed: Tensor, memory: Tensor, motion: Motion, batch: SceneBatch
    ) -> tuple[State, Tensor]:
        """Return state and memory after a step for agents with embeddings *mixed* (B, A, D)."""
        accel, curvature = controls(self.action(mixed), motion[2], batch.size[..., 0], self.options)
        accel, curvature = accel * batch.moved, curvature * batch.moved
        motion = bicycle_step(*motion, accel, curvature, MODEL_STEP_S)
        done = torch.stack((0.25 * accel, 10.0 * curvature), dim=-1)
        inputs = torch.cat((mixed, done), dim=-1)
        new: Tensor = self.memory(inputs.flatten(0, 1), memory.flatten(0, 1))
        return (*motion, accel, curvature), new.reshape(memory.shape)


def motion_now(batch: SceneBatch) -> Motion:
    """Return the present motion of the agents of *batch*."""
    pose = batch.pose
    return pose[..., :2], pose[..., 2], pose[..., 3].clamp(min=0.0)


def rollout_of(states: Sequence[State]) -> Rollout:
    """Return the rollout made of *states*, one for each instant."""
    return Rollout(*(torch.stack(column, dim=2) for column in zip(*states, strict=True)))


def motion_features(xy: Tensor, yaw: Tensor, speed: Tensor, batch: SceneBatch) -> Tensor:
    """Return (B, A, 6) features of each agent's motion since now: positions (B, A, 2), headings and speeds (B, A)."""
    pose = batch.pose
    moved = 0.05 * into_frame(xy, pose[..., :2], pose[..., 2])
    turn = yaw - pose[..., 2]
    columns = (torch.cos(turn), torch.sin(turn), 0.1 * speed, 0.1 * (speed - pose[..., 3]))
    return torch.cat((moved, torch.stack(columns, dim=-1)), dim=-1)
