"""Input of the networks: scenes, padded to the same number of agents."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor
from torch.nn.functional import pad

from advdiff_sumo.models.geometry import into_frame


@dataclass(frozen=True)
class SceneBatch:
    """B scenes of A agents, H instants of past, T of future, K map pieces of N points; padding is 0 and masked.

    Positions are metres from the scene's origin (x east, y north), yaw radians counter-clockwise from east.

    Attributes:
        past: (B, A, H, 4) x, y, yaw, speed; the last instant is now.
        past_valid: (B, A, H) whether the state is known.
        size: (B, A, 2) length and width.
        classes: (B, A) values of ``AgentClass``.
        present: (B, A) whether the agent is real, not padding, and in the scene now.
        moved: (B, A) whether it is a vehicle; only futures of vehicles are modelled.
        parked: (B, A) whether it never moves in its log; for statistics only, no network reads it.
        map_xy: (B, A, K, N, 2) pieces in the agent's present frame (x forward, y left), lanes first, then road edges.
        map_features: (B, A, K, F) features of the pieces, as in ``maps.vector_map``, with the signal's state.
        map_valid: (B, A, K) whether the piece is real.
        future: (B, A, T, 4) recorded states, 0 where unknown; all 0 at run time.
        future_valid: (B, A, T) whether they are known.
    """

    past: Tensor
    past_valid: Tensor
    size: Tensor
    classes: Tensor
    present: Tensor
    moved: Tensor
    parked: Tensor
    map_xy: Tensor
    map_features: Tensor
    map_valid: Tensor
    future: Tensor
    future_valid: Tensor

    @property
    def pose(self) -> Tensor:
        """(B, A, 4) x, y, yaw and speed now."""
        return self.past[:, :, -1]

    @property
    def scenes(self) -> int:
        """Number of scenes B."""
        return int(self.past.shape[0])

    @property
    def agents(self) -> int:
        """Number of agents A, padding included."""
        return int(self.past.shape[1])

    def to(self, device: torch.device | str) -> SceneBatch:
        """Return the batch on *device*."""
        return self.mapped(lambda part: part.to(device))

    def repeat(self, times: int) -> SceneBatch:
        """Return each scene repeated *times* times: scene b becomes rows b·times … b·times + times − 1."""
        return self.mapped(lambda part: part.repeat_interleave(times, dim=0))

    def rows(self, rows: Tensor | slice) -> SceneBatch:
        """Return the scenes at *rows*."""
        return self.mapped(lambda part: part[rows])

    def rows_of(self, rows: Tensor | slice) -> SceneBatch:
        """Return all scenes, with only the agents *rows*."""
        return self.mapped(lambda part: part[:, rows])

    def advanced(self, states: Tensor) -> SceneBatch:
        """Return the scenes after their agents have driven *states* (B, A, S, 4), which become their past.

        The map pieces are those around the old positions, transformed into the new frames; signals keep their state.
        """
        history, steps, old, new = self.past.shape[2], states.shape[2], self.pose, states[:, :, -1]
        valid = self.present[..., None].expand(states.shape[:3])
        shift, turn = into_frame(new[..., :2], old[..., :2], old[..., 2]), new[..., 2] - old[..., 2]
        around = turn[:, :, None, None].expand(self.map_xy.shape[:-1])
        return replace(
            self,
            past=torch.cat((self.past, states), dim=2)[:, :, -history:],
            past_valid=torch.cat((self.past_valid, valid), dim=2)[:, :, -history:],
            future=pad(self.future[:, :, steps:], (0, 0, 0, steps)),
            future_valid=pad(self.future_valid[:, :, steps:], (0, steps)),
            map_xy=into_frame(self.map_xy, shift[:, :, None, None], around),
        )

    def mapped(self, change: Callable[[Tensor], Tensor]) -> SceneBatch:
        """Return the batch with *change* applied to each of its tensors."""
        return SceneBatch(**{f.name: change(getattr(self, f.name)) for f in fields(self)})
