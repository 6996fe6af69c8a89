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
from advdiff_sumo.metrics.pairwise import least_ttc, ttc_counts
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle, load_bundle
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.model_options import MODEL_STEP_S
from advdiff_sumo.models.shipped_weights import shipped_weights
from advdiff_sumo.models.simnet import load_simnet
from advdiff_sumo.training import realism
from advdiff_sumo.training.displacement import driving, logged
from advdiff_sumo.training.open_loop import Draw, by_diffusion, from_prior, judge

Continue = Callable[[SceneBatch, int, torch.Generator], tuple[Rollout, int]]
"""Windows, how many samples → joint futures of each window that many times in a row, and how many times."""
LATENT_STEPS, TRAJECTORY_STEPS = 5, 10
"""As many as in closed loop; with five, trajectories are rougher by half."""


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
    load: Callable[[Path], Continue]
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


def _log(_: Path) -> Continue:
    return lambda batch, _samples, _generator: (logged(batch), 1)


def _simnet(path: Path) -> Continue:
    simnet = load_simnet(path).eval().requires_grad_(False)
    return lambda batch, _samples, _generator: (simnet(batch), 1)


def _prior(path: Path) -> Continue:
    bundle = _bundle(path)
    return _encoding(bundle, from_prior(bundle))


def _diffusion(path: Path, fitted: bool = False, steps: int = LATENT_STEPS) -> Continue:
    """Return what draws samples by *steps* of DDIM; *fitted*: made to fit together."""
    bundle = _bundle(path)
    return _encoding(bundle, by_diffusion(bundle, steps, partial(_fitted, _held(bundle)) if fitted else None))


def _encoding(bundle: Bundle, draw: Draw) -> Continue:
    """Return *draw* of windows that the encoder of *bundle* has still to see."""
    return lambda batch, samples, generator: draw(batch, bundle.traffic.encoder(batch), samples, generator)


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
    judged = judge(rollout, several, times, several.future_valid if name == "log" else None)
    vehicles = judged.driving.sum(1)
    return Counted(
        sfde_m=_array(judged.sfde_m),
        fdd_m=_array(torch.where(judged.driving, judged.spread_m, 0.0).sum(1)),
        vehicles=_array(vehicles),
        trials=_array(vehicles * times),
        hit=_array(judged.hit.sum((1, 2))),
        off_road=_array(judged.off_road.sum((1, 2))),
        speed=judged.speed,
        accel=judged.accel,
        ttc=_ttc_histograms(rollout, several, times),
    )


def _ttc_histograms(rollout: Rollout, batch: SceneBatch, times: int) -> FloatArray:
    """Return (W, bins) counts of times to collision of driving vehicles at the known instants."""
    known = (driving(batch)[..., None] & realism.known_steps(batch)).numpy()
    windows = len(known) // times
    rows = (part.reshape(windows, -1) for part in (ttc_of(rollout, batch), known))
    return np.stack([ttc_counts(seconds[mask]) for seconds, mask in zip(*rows, strict=True)])


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
def _draw_of(name: str) -> Continue:
    return MODELS[name].load(MODELS[name].path)


@lru_cache(maxsize=2)
def _bundle(path: Path) -> Bundle:
    return load_bundle(path).frozen()


def _array(value: Tensor) -> FloatArray:
    return value.double().cpu().numpy()
