"""Decoder that closes the loop: at each half second every vehicle looks again at lanes, road edge and bodies.

The decoder of the paper (Sec. III-B) knows the map from the context embedding alone, which was made at the place
where the vehicle began. Here lane pieces, the clearance of the box and gaps to others are seen from where the rollout
has led, as TrafficSim (Suo et al. 2021, doi:10.1109/CVPR46437.2021.01026) and SimNet see theirs. Every new part begins
as nothing: with the weights of the open decoder it gives the open decoder's futures.

The same network serves training and planning, on every device.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Tensor, nn

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import (
    Decoder,
    Forced,
    Motion,
    Rollout,
    State,
    motion_features,
    motion_now,
    rollout_of,
)
from advdiff_sumo.models.geometry import RELATIVE_FEATURES, into_frame
from advdiff_sumo.models.lane_attention import LaneAttention, LanePieces
from advdiff_sumo.models.model_options import FUTURE_STEPS, ModelOptions
from advdiff_sumo.models.neighbours import Neighbours, nearest_agents
from advdiff_sumo.models.proximity import BOX_POINTS, PAIR_FEATURES, box_clearance, pair_features
from advdiff_sumo.models.road_edges import RoadEdges
from advdiff_sumo.models.trace import Trace

Step: TypeAlias = Callable[
    [Tensor, Tensor, "Surroundings", Motion, Motion, Tensor | None], tuple[State, Tensor, Tensor]
]
"""What :meth:`ClosedLoopDecoder.step` does, or the same in compiled form."""
_MOTION = 6


@dataclass(frozen=True)
class Surroundings:
    """What stays the same through a rollout of R rows.

    Attributes:
        batch: the scenes with all A agents.
        own: the same with the rows alone.
        rows: (R,) agents that are rolled out.
        lanes: lane pieces around them.
        edges: segments of the road's edge around them.
    """

    batch: SceneBatch
    own: SceneBatch
    rows: Tensor
    lanes: LanePieces
    edges: RoadEdges


class ClosedLoopDecoder(Decoder):
    """:class:`Decoder` with eyes: attention over lanes, clearance to the road's edge, gaps between bodies."""

    def __init__(self, options: ModelOptions) -> None:
        super().__init__(options)
        width = options.hidden
        self.lanes = LaneAttention(options, width + _MOTION)
        self.clearance = _from_nothing(BOX_POINTS, options.message, width)
        self.pairs = _from_nothing(RELATIVE_FEATURES + PAIR_FEATURES, options.edge, options.message)
        self._compiled: Step | None = None

    def forward(
        self,
        z: Tensor,
        h: Tensor,
        batch: SceneBatch,
        steps: int = FUTURE_STEPS,
        forced: Forced | None = None,
    ) -> Rollout:
        """Return the futures that latents lead to; arguments as :meth:`Decoder.forward`."""
        everybody = torch.arange(batch.agents, device=z.device)
        return self._roll(z, h, batch, everybody, steps, forced)[0]

    @torch.no_grad()
    def whole(
        self, z: Tensor, h: Tensor, batch: SceneBatch, steps: int = FUTURE_STEPS, by: Step | None = None
    ) -> tuple[Rollout, Trace]:
        """Return the futures of all agents, without gradients, and what :meth:`some` needs of them.

        *by* takes the place of :meth:`step`.
        """
        return self._roll(z, h, batch, torch.arange(batch.agents, device=z.device), steps, by=by)

    def some(
        self,
        z: Tensor,
        h: Tensor,
        batch: SceneBatch,
        rows: Tensor,
        steps: int,
        trace: Trace,
        by: Step | None = None,
    ) -> Rollout:
        """Return the futures (B, R, …) of agents *rows* alone, with gradients to *z* (B, R, Z).

        Those that are made *by* something in the place of :meth:`step` have none.

        All others move and say what they did in *trace*; the rows see them, and each other, from where they are.
        """
        return self._roll(z, h, batch, rows, steps, None, trace, by)[0]

    def _roll(
        self,
        z: Tensor,
        h: Tensor,
        batch: SceneBatch,
        rows: Tensor,
        steps: int,
        forced: Forced | None = None,
        trace: Trace | None = None,
        by: Step | None = None,
    ) -> tuple[Rollout, Trace]:
        own = batch if trace is None else batch.rows_of(rows)
        around = Surroundings(batch, own, rows, LanePieces.of(own), RoadEdges.of(own))
        memory = torch.tanh(self.start(torch.cat((h[:, rows], z), dim=-1)))
        motion = motion_now(own)
        states, begun, said = [], [], []
        advance = by or self.step
        if by is None and self._compiled is not None and trace is None and torch.is_grad_enabled():
            advance = self._compiled
        for k in range(steps):
            everybody = motion if trace is None else _among(trace.motion[k], rows, motion)
            others = None if trace is None else trace.senders[k]
            state, memory, senders = advance(memory, z, around, motion, everybody, others)
            begun.append(torch.cat((everybody[0], everybody[1][..., None], everybody[2][..., None]), dim=-1))
            said.append(senders)
            states.append(state if forced is None else forced.put(k, state))
            motion = states[-1][:3]
        return rollout_of(states), Trace(torch.stack(begun), torch.stack(said))

    def compile_step(self) -> None:
        """Let ``torch.compile`` fuse what all agents do at a step of training; worth its minute on a GPU."""
        self._compiled = torch.compile(self.step, dynamic=False)

    def step(
        self,
        memory: Tensor,
        z: Tensor,
        around: Surroundings,
        motion: Motion,
        everybody: Motion,
        others: Tensor | None,
    ) -> tuple[State, Tensor, Tensor]:
        """Return where the rows get to in a step, their memory of it, and what all agents send (layers, B, A, M)."""
        own, batch, rows = around.own, around.batch, around.rows
        place = into_frame(motion[0], own.pose[..., :2], own.pose[..., 2])
        turn = motion[1] - own.pose[..., 2]
        moved = motion_features(*motion, own)
        state = torch.cat((memory, moved), dim=-1)
        node = self.node(torch.cat((memory, z, moved), dim=-1))
        node = node + self.lanes(state, around.lanes.seen_from(place, turn))
        node = node + self.clearance(box_clearance(place, turn, own.size, around.edges))
        which = nearest_agents(everybody[0], batch.present, rows, self.options.neighbours)
        near = Neighbours.of(*everybody, batch.size, rows, which)
        mixed, senders = self._mix(torch.relu(node), near, around, others)
        done, memory = self._drive(mixed, memory, motion, own)
        return done, memory, senders

    def _edges(self, near: Neighbours) -> list[Tensor]:
        """Return for each graph layer what it adds to the messages (B, R, K, M) how neighbours lie."""
        relative = near.relative_features()
        columns = torch.stack((*relative, *pair_features(near)), dim=-1)
        edges = self.interaction.prepare(columns[..., : len(relative)])
        closer = self.pairs(columns)
        return [edge + closer for edge in edges]

    def _mix(
        self, h: Tensor, near: Neighbours, around: Surroundings, others: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        said, edges = [], self._edges(near)
        mask = near.among(around.batch.present)
        for number, (layer, edge) in enumerate(zip(self.interaction.in_order(), edges, strict=True)):
            sent = layer.sender(h)
            if others is not None:
                sent = others[number].to(sent.dtype).index_copy(1, around.rows, sent)
            said.append(sent)
            h = layer.receive(h, edge, near.among(sent), mask) * around.own.present[..., None]
        return h, torch.stack(said)


def _from_nothing(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    """Return a perceptron of one hidden layer whose output begins as 0."""
    last = nn.Linear(hidden, outputs)
    nn.init.zeros_(last.weight)
    nn.init.constant_(last.bias, 0.0)
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), last)


def _among(state: Tensor, rows: Tensor, motion: Motion) -> Motion:
    """Return the motion of all agents: that of *state* (B, A, 4), with the *rows*' own in its place."""
    mine = torch.cat((motion[0], motion[1][..., None], motion[2][..., None]), dim=-1)
    advanced = state.to(mine.dtype).index_copy(1, rows, mine)
    return advanced[..., :2], advanced[..., 2], advanced[..., 3]
