"""Closed-loop decoder: at each step of its rollout every vehicle observes lanes, road edges and neighbours anew.

The decoder of the paper (Sec. III-B) knows the map only through the context embedding, computed at the vehicle's first
position. Here lane pieces, the clearance to the road edge and gaps to other vehicles are computed from the position
reached in the rollout, as in TrafficSim (Suo et al. 2021, doi:10.1109/CVPR46437.2021.01026) and SimNet. The outputs of
all added parts are initialised to zero: with the open decoder's weights it gives the open decoder's futures.

Training and planning use the same network, on every device.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Decoder, Motion, State, Surroundings, motion_features
from advdiff_sumo.models.geometry import RELATIVE_FEATURES, into_frame
from advdiff_sumo.models.lane_attention import LaneAttention, LanePieces
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.neighbours import Neighbours, nearest_agents
from advdiff_sumo.models.perceptron import zero_output_perceptron
from advdiff_sumo.models.proximity import BOX_POINTS, PAIR_FEATURES, box_clearance, pair_features
from advdiff_sumo.models.road_edges import RoadEdges

_MOTION = 6


@dataclass(frozen=True)
class LanesAndEdges(Surroundings):
    """Inputs that are constant during a rollout of R rows that observe the map.

    Attributes:
        lanes: lane pieces around the rows.
        edges: segments of the road edge around the rows.
    """

    lanes: LanePieces
    edges: RoadEdges


class ClosedLoopDecoder(Decoder):
    """:class:`Decoder` with attention over lanes, clearance to the road edge, and gaps between footprints."""

    def __init__(self, options: ModelOptions) -> None:
        super().__init__(options)
        width = options.hidden
        self.lanes = LaneAttention(options, width + _MOTION)
        self.clearance = zero_output_perceptron(BOX_POINTS, options.message, width)
        self.pairs = zero_output_perceptron(RELATIVE_FEATURES + PAIR_FEATURES, options.edge, options.message)

    def surroundings(self, batch: SceneBatch, rows: Tensor | None = None) -> Surroundings:
        """Return the surroundings of the base class, with lane pieces and road edges."""
        plain = super().surroundings(batch, rows)
        return LanesAndEdges(**vars(plain), lanes=LanePieces.of(plain.own), edges=RoadEdges.of(plain.own))

    def _among(self, traced: Tensor, rows: Tensor, motion: Motion) -> Motion:
        """Return the motion of all agents that *rows* observe: their own now, the others' from the trace (B, A, 4)."""
        own_motion = torch.cat((motion[0], motion[1][..., None], motion[2][..., None]), dim=-1)
        advanced = traced.to(own_motion.dtype).index_copy(1, rows, own_motion)
        return advanced[..., :2], advanced[..., 2], advanced[..., 3]

    def compile_step(self) -> None:
        """Compile the training step of all agents with ``torch.compile``, which takes a minute; for GPUs."""
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
        """Return the rows' state after a step, their new memory, and all agents' messages (layers, B, A, M)."""
        assert isinstance(around, LanesAndEdges)  # noqa: S101 - tells the type checker what surroundings gives
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
        columns = torch.stack((*near.relative_features(), *pair_features(near)), dim=-1)
        relative = self.interaction.prepare(columns[..., :RELATIVE_FEATURES])
        closer = self.pairs(columns)
        edges = [edge + closer for edge in relative]
        mixed, senders = self._mix(torch.relu(node), edges, around, others, near.among)
        done, memory = self._drive(mixed, memory, motion, own)
        return done, memory, senders
