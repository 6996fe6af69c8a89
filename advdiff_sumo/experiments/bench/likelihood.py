"""Measures how natural recorded traffic is for the unguided model: a bound on its log-likelihood, in nats.

The bound is the ELBO of the traffic model (Sec. III-B, L_ELBO, without training's weights)::

    log p(τ | h) ≥ E_q[log p(τ | z)] − KL(q(z | τ, h) ‖ p(z | h))

for every background vehicle of windows of 2 s past and up to 6 s future at 2 Hz. The target is an input, but does not
count. z is one sample of the posterior, with the same noise for every row of a table. p(τ | z) is a normal density with
standard deviation ``SIGMA_M`` around the decoded positions, x and y, at the known instants. The table divides the bound
by the known seconds of the vehicles' futures. Signals are not recorded and count as unknown in every row.

The bound holds for any q. The posterior was trained on whole futures, so incomplete ones (the record ends or a vehicle
leaves) are completed: by a rollout at the prior's mean in which the known instants are given.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch

from advdiff_sumo.core.arrays import BoolArray
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data.window_arrays import WindowFileBuilder, crop, window_arrays
from advdiff_sumo.data.window_files import DT_S, PAST
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle, load_bundle
from advdiff_sumo.models.collate import collate
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Forced
from advdiff_sumo.models.shipped_weights import shipped_weights
from advdiff_sumo.models.traffic import TrafficModel

SIGMA_M = 0.5
_WINDOW_STRIDE = 4
"""Instants between two windows: 2 s."""
_MIN_FUTURE_STEPS = 2


def natural_nats(road: RoadMap, tracks: Tracks, target: int, counted: BoolArray) -> tuple[float, float]:
    """Return the sum of the bounds in nats and the number of vehicle-seconds.

    Args:
        road: the map.
        tracks: (A, L) the episode at 2 Hz.
        target: row of the tested vehicle.
        counted: (A,) mask of the background vehicles that count.
    """
    table = road.pieces(_bundle().options.model.map_view)
    windows = WindowFileBuilder(table, road.name, "episode")
    window_rows: list[tuple[int, ...]] = []
    for step in range(PAST - 1, tracks.steps - _MIN_FUTURE_STEPS, _WINDOW_STRIDE):
        if tracks.valid[target, step]:
            rows = crop(tracks.xy_m[:, step], target)
            parked = np.zeros(tracks.agents, dtype=np.bool_)
            window = window_arrays(tracks, step, rows, parked, table, {}, "episode")
            windows.windows.append(window)
            window_rows.append(tuple(rows.tolist()))
    if not window_rows:
        return 0.0, 0.0
    batch = collate(windows.build(), np.arange(len(window_rows), dtype=np.int64))
    mask = np.zeros(tuple(batch.present.shape), dtype=np.bool_)
    for w, agents in enumerate(window_rows):
        mask[w, : len(agents)] = counted[list(agents)]
    return _bound(batch, torch.from_numpy(mask))


@torch.no_grad()
def _bound(batch: SceneBatch, mask: torch.Tensor) -> tuple[float, float]:
    traffic = _bundle().traffic
    context = traffic.encoder(batch)
    posterior = traffic.posterior(_completed(batch, traffic, context), context.h)
    z = posterior.sample(torch.Generator().manual_seed(0))
    rollout = traffic.decoder(z, context.h, batch)
    is_known = batch.future_valid & (batch.moved & mask)[..., None]
    squared_distance = (rollout.xy - batch.future[..., :2]).square().sum(-1)
    log_density = -0.5 * squared_distance / SIGMA_M**2 - math.log(2.0 * math.pi * SIGMA_M**2)
    nats = torch.where(is_known, log_density, 0.0).sum(-1) - posterior.kl(context.prior).sum(-1)
    nats = torch.where(is_known.any(-1), nats, 0.0)
    return float(nats.double().sum()), DT_S * float(is_known.sum())


def _completed(batch: SceneBatch, traffic: TrafficModel, context: Context) -> SceneBatch:
    """Return *batch* with complete futures: unknown instants continue the known ones, at the mean of the prior."""
    forced = Forced(batch.future, batch.future_valid)
    rollout = traffic.decoder(context.prior.mean, context.h, batch, forced=forced)
    is_present = batch.present[..., None].expand_as(batch.future_valid)
    return replace(batch, future=rollout.states(), future_valid=is_present)


@lru_cache(maxsize=1)
def _bundle() -> Bundle:
    return load_bundle(shipped_weights()).frozen()
