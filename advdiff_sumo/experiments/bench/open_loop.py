"""Rows of ``bench traffic``: ways to continue a window, and what is counted of their samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.map_view import MapView
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.sample_refinement import Decode, held_decode, together
from advdiff_sumo.metrics.pairwise import TTC_BINS_S, least_ttc, ttc_counts
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle, load_bundle
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.model_options import MODEL_STEP_S
from advdiff_sumo.models.shipped_weights import shipped_weights
from advdiff_sumo.models.simnet import load_simnet
from advdiff_sumo.training import realism
from advdiff_sumo.training.denoiser_stage import diffused
from advdiff_sumo.training.displacement import displacement, driving, logged

LATENT_STEPS, TRAJECTORY_STEPS = 5, 10
"""As many as in closed loop; with five, trajectories are rougher by half."""
Draw = Callable[[SceneBatch, int, torch.Generator], tuple[Rollout, int]]
"""Windows, how many samples → joint futures of each window that many times in a row, and how many times."""


@dataclass(frozen=True)
class ComparedModel:
    """A row of the table.

    Attributes:
        title: what is printed.
        weights: file among the shipped weights; "" for the log itself.
        load: path of the weights → what draws futures.
        view: how much of the map they see.
    """

    title: str
    weights: str
    load: Callable[[Path], Draw]
    view: MapView = "near"

    @property
    def path(self) -> Path:
        """Where its weights are."""
        return shipped_weights().parent / self.weights

    @property
    def there(self) -> bool:
        """Whether its weights ship with this installation."""
        return not self.weights or self.path.is_file()


@dataclass(frozen=True)
class Counted:
    """What is counted of W windows, each (W,) or (W, bins).

    Attributes:
        sfde_m: least final error of a sample, mean over its vehicles.
        fdd_m: sum over vehicles of the mean distance of final positions between samples.
        vehicles: driving vehicles.
        trials: the same, once a sample.
        hit: of these, those whose box meets another one.
        off_road: of these, those whose centre leaves the road.
        speed: counts of speeds.
        accel: counts of accelerations.
        ttc: counts of times to collision.
    """

    sfde_m: FloatArray
    fdd_m: FloatArray
    vehicles: FloatArray
    trials: FloatArray
    hit: FloatArray
    off_road: FloatArray
    speed: FloatArray
    accel: FloatArray
    ttc: FloatArray


def _log(_: Path) -> Draw:
    return lambda batch, _samples, _generator: (logged(batch), 1)


def _simnet(path: Path) -> Draw:
    simnet = load_simnet(path).eval().requires_grad_(False)
    return lambda batch, _samples, _generator: (simnet(batch), 1)


def _prior(path: Path) -> Draw:
    bundle = _bundle(path)

    def draw(batch: SceneBatch, samples: int, generator: torch.Generator) -> tuple[Rollout, int]:
        encoded: Context = bundle.traffic.encoder(batch)
        context = encoded.repeat(samples)
        z = context.prior.sample(generator)
        return bundle.traffic.decoder(z, context.h, batch.repeat(samples)), samples

    return draw


def _diffusion(path: Path, fitted: bool = False, steps: int = LATENT_STEPS) -> Draw:
    """Return what draws samples by *steps* of DDIM; *fitted*: made to fit together."""
    bundle = _bundle(path)
    decode = _held(bundle) if fitted else None

    def draw(batch: SceneBatch, samples: int, generator: torch.Generator) -> tuple[Rollout, int]:
        encoded: Context = bundle.traffic.encoder(batch)
        context = encoded.repeat(samples)
        several = batch.repeat(samples)
        drawn = diffused(bundle, context, steps, generator)
        if decode is not None:
            drawn = _fitted(decode, drawn, context, several, samples)
        return bundle.codec.decode(drawn, context, several), samples

    return draw


def _held(bundle: Bundle) -> Decode:
    """Return the decoder that samples are made to fit by."""
    assert isinstance(bundle.codec, LatentCodec)  # noqa: S101 - the row names latent weights
    return held_decode(bundle.codec, FastDecoder(bundle.traffic.decoder))


def _fitted(decode: Decode, drawn: Tensor, context: Context, several: SceneBatch, samples: int) -> Tensor:
    """Return *drawn* made to fit together, one window at a time, so that padding costs nothing."""
    refined = drawn.clone()
    for begin in range(0, several.scenes, samples):
        window = slice(begin, begin + samples)
        agents = int(several.present[begin].nonzero().max()) + 1
        batch = several.rows(window).rows_of(torch.arange(agents))
        known = context.rows(window).first(agents)
        refined[window, :agents] = together(drawn[window, :agents], decode, known, batch)
    return refined


MODELS: Mapping[str, ComparedModel] = {
    "log": ComparedModel("the log itself", "", _log),
    "simnet": ComparedModel("SimNet", "simnet.safetensors", _simnet),
    "trafficsim": ComparedModel("TrafficSim (prior)", "traffic.safetensors", _prior),
    "traj2traj": ComparedModel(
        "traj2traj", "traj2traj.safetensors", partial(_diffusion, steps=TRAJECTORY_STEPS)
    ),
    "diffusion": ComparedModel("latent diffusion (ours)", "traffic.safetensors", _diffusion),
    "closed-loop": ComparedModel(
        "… with the closed-loop decoder", "closed-loop.safetensors", _diffusion, "far"
    ),
    "together": ComparedModel(
        "… made to fit together", "traffic.safetensors", partial(_diffusion, fitted=True)
    ),
}


@torch.no_grad()
def count(name: str, batch: SceneBatch, samples: int, seed: int) -> Counted:
    """Return what is counted of the futures that model *name* gives the windows of *batch*.

    Args:
        name: of ``MODELS``.
        batch: W windows with what happened.
        samples: joint samples of each.
        seed: of the random numbers.
    """
    node = SeedTree(seed, ("bench", "traffic", name))
    generator = torch.Generator().manual_seed(node.integer(62))
    rollout, times = _draw_of(name)(batch, samples, generator)
    several = batch.repeat(times)
    known = several.future_valid if name == "log" else several.present[..., None].expand(rollout.yaw.shape)
    shape, who = (batch.scenes, times, batch.agents), driving(batch)
    vehicles = who.sum(1)
    fde = torch.where(who[:, None], displacement(rollout, several).fde_m.reshape(shape), 0.0)
    hit = realism.colliding(rollout, several, known).reshape(batch.scenes, -1).sum(1)
    off = realism.leaving_road(rollout, several, known).reshape(batch.scenes, -1).sum(1)
    speed, accel, ttc = _histograms(rollout, several, times)
    return Counted(
        sfde_m=_array((fde.sum(2) / vehicles.clamp(min=1)[:, None]).amin(1)),
        fdd_m=_array(_spread(rollout, several, times, who)),
        vehicles=_array(vehicles),
        trials=_array(vehicles * times),
        hit=_array(hit),
        off_road=_array(off),
        speed=speed,
        accel=accel,
        ttc=ttc,
    )


def _spread(rollout: Rollout, several: SceneBatch, times: int, who: Tensor) -> Tensor:
    """Return (W,) sums over vehicles of the mean distance of final positions over pairs of samples (FDD)."""
    steps = torch.arange(rollout.xy.shape[2])
    last = torch.where(several.future_valid, steps, 0).amax(-1)
    at = last[..., None, None].expand(*last.shape, 1, 2)
    final = rollout.xy.gather(2, at).squeeze(2).reshape(-1, times, who.shape[1], 2)
    if times < 2:
        return torch.zeros(len(final))
    apart = (final[:, :, None] - final[:, None]).norm(dim=-1).sum((1, 2)) / (times * (times - 1))
    return torch.where(who, apart, 0.0).sum(1)


def _histograms(rollout: Rollout, batch: SceneBatch, times: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (W, bins) counts of speeds, accelerations and times to collision at the known instants."""
    driven, known = driving(batch)[..., None], realism.known_steps(batch)
    before = torch.cat((batch.pose[..., 3:4], rollout.speed[..., :-1]), dim=-1)
    accel = (rollout.speed - before) / MODEL_STEP_S
    seconds = ttc_of(rollout, batch)
    rows = len(known) // times
    mask, changes = ((driven & one).numpy().reshape(rows, -1) for one in (batch.future_valid, known))
    parts = [_array(values).reshape(rows, -1) for values in (rollout.speed, accel)]
    parts.append(seconds.reshape(rows, -1))
    bins = (realism.SPEED_BINS, realism.ACCEL_BINS)
    counts = [
        np.stack([np.histogram(np.clip(v[m], b[0], b[-1]), b)[0] for v, m in zip(part, which, strict=True)])
        for part, which, b in zip(parts, (mask, changes), bins, strict=False)
    ]
    ttc = np.stack([ttc_counts(v[m]) for v, m in zip(parts[2], changes, strict=True)])
    assert ttc.shape[1] == len(TTC_BINS_S)  # noqa: S101 - one more bin than edges less one
    return counts[0].astype(np.float64), counts[1].astype(np.float64), ttc


def ttc_of(rollout: Rollout, batch: SceneBatch) -> FloatArray:
    """Return (B, A, T) least times to collision of the agents of *batch* on their way along *rollout*.

    Velocities are the steps between instants, so that log and models are measured alike.
    """
    before = torch.cat((batch.pose[:, :, None, :2], rollout.xy[:, :, :-1]), dim=2)
    velocity = _array((rollout.xy - before) / MODEL_STEP_S).swapaxes(1, 2)
    there = (realism.known_steps(batch) & batch.present[..., None]).numpy().swapaxes(1, 2)
    seconds = least_ttc(
        _array(rollout.xy).swapaxes(1, 2),
        _array(rollout.yaw).swapaxes(1, 2),
        velocity,
        _array(batch.size)[:, None],
        there,
    )
    return np.asarray(seconds.swapaxes(1, 2))


@lru_cache(maxsize=len(MODELS))
def _draw_of(name: str) -> Draw:
    return MODELS[name].load(MODELS[name].path)


@lru_cache(maxsize=2)
def _bundle(path: Path) -> Bundle:
    return load_bundle(path).frozen()


def _array(value: Tensor) -> FloatArray:
    return value.double().cpu().numpy()
