"""A scene some steps later: what was planned has become the past."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.geometry import into_frame, rotate


def advance(batch: SceneBatch, rollout: Rollout, steps: int) -> SceneBatch:
    """Return *batch* after *steps* model steps of *rollout*.

    The map pieces stay the ones around the old position, seen from the new one; signals keep their state.

    Args:
        batch: scenes.
        rollout: their joint futures.
        steps: how many instants of it have been executed, at least 1.
    """
    history = batch.past.shape[2]
    done = rollout.states()[:, :, :steps]
    valid = batch.present[..., None].expand(done.shape[:3])
    past = torch.cat((batch.past, done), dim=2)[:, :, -history:]
    past_valid = torch.cat((batch.past_valid, valid), dim=2)[:, :, -history:]
    future = torch.nn.functional.pad(batch.future[:, :, steps:], (0, 0, 0, steps))
    future_valid = torch.nn.functional.pad(batch.future_valid[:, :, steps:], (0, steps))
    map_xy = _seen_from(batch.map_xy, batch.pose, past[:, :, -1])
    return replace(
        batch, past=past, past_valid=past_valid, future=future, future_valid=future_valid, map_xy=map_xy
    )


def _seen_from(map_xy: Tensor, old: Tensor, new: Tensor) -> Tensor:
    """Return pieces (B, A, K, N, 2) given in the frames of *old* poses (B, A, 4) in those of *new* ones."""
    shift = into_frame(new[..., :2], old[..., :2], old[..., 2])
    turn = new[..., 2] - old[..., 2]
    shape = map_xy.shape[:-1]
    return rotate(map_xy - shift[:, :, None, None], -turn[:, :, None, None].expand(shape))
