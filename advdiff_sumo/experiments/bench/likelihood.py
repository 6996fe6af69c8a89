"""How natural recorded traffic is to the unguided model: a bound on its log-likelihood, in nats.

The bound is the ELBO of the traffic model (Sec. III-B, L_ELBO, without training's weights)::

    log p(τ | h) ≥ E_q[log p(τ | z)] − KL(q(z | τ, h) ‖ p(z | h))

for every background vehicle of windows of 2 s past and up to 6 s future at 2 Hz, the target seen but not counted. z is
one draw from the posterior, the same noise for every row of a table; p(τ | z) is a normal density of deviation
``SIGMA_M`` around the decoded positions, x and y, of the instants that are known. Divided by the seconds that are known
of the vehicles' futures. Signals are not part of the record and count as unknown, for every row alike.

The bound holds for any q. The posterior was trained on whole futures, so it gets one where the record ends or somebody
leaves earlier: unknown instants are those of a rollout at the prior's mean in which the known ones are given.
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
_EVERY = 4
"""Instants between two windows: 2 s."""
_LEAST_FUTURE = 2


def natural_nats(road: RoadMap, tracks: Tracks, target: int, counted: BoolArray) -> tuple[float, float]:
    """Return the sum of the bounds in nats and the vehicle-seconds that they are of.

    Args:
        road: the map.
        tracks: (A, L) the episode at 2 Hz.
        target: row of the tested vehicle.
        counted: (A,) background vehicles that count.
    """
    table = road.pieces(_bundle().options.model.map_view)
    windows = WindowFileBuilder(table, road.name, "episode")
    names: list[tuple[int, ...]] = []
    for now in range(PAST - 1, tracks.steps - _LEAST_FUTURE, _EVERY):
        if tracks.valid[target, now]:
            rows = crop(tracks.xy_m[:, now], target)
            parked = np.zeros(tracks.agents, dtype=np.bool_)
            window = window_arrays(tracks, now, rows, parked, table, {}, "episode")
            windows.windows.append(window)
            names.append(tuple(rows.tolist()))
    if not names:
        return 0.0, 0.0
    batch = collate(windows.build(), np.arange(len(names), dtype=np.int64))
    mask = np.zeros(tuple(batch.present.shape), dtype=np.bool_)
    for w, agents in enumerate(names):
        mask[w, : len(agents)] = counted[list(agents)]
    return _bound(batch, torch.from_numpy(mask))


@torch.no_grad()
def _bound(batch: SceneBatch, mask: torch.Tensor) -> tuple[float, float]:
    traffic = _bundle().traffic
    context = traffic.encoder(batch)
    posterior = traffic.posterior(_whole(batch, traffic, context), context.h)
    z = posterior.sample(torch.Generator().manual_seed(0))
    rollout = traffic.decoder(z, context.h, batch)
    known = batch.future_valid & (batch.moved & mask)[..., None]
    squared = (rollout.xy - batch.future[..., :2]).square().sum(-1)
    density = -0.5 * squared / SIGMA_M**2 - math.log(2.0 * math.pi * SIGMA_M**2)
    nats = torch.where(known, density, 0.0).sum(-1) - posterior.kl(context.prior).sum(-1)
    nats = torch.where(known.any(-1), nats, 0.0)
    return float(nats.double().sum()), DT_S * float(known.sum())


def _whole(batch: SceneBatch, traffic: TrafficModel, context: Context) -> SceneBatch:
    """Return *batch* with whole futures: what is unknown goes on from what is known, at the mean of the prior."""
    forced = Forced(batch.future, batch.future_valid)
    rollout = traffic.decoder(context.prior.mean, context.h, batch, forced=forced)
    there = batch.present[..., None].expand_as(batch.future_valid)
    return replace(batch, future=rollout.states(), future_valid=there)


@lru_cache(maxsize=1)
def _bundle() -> Bundle:
    return load_bundle(shipped_weights()).frozen()
