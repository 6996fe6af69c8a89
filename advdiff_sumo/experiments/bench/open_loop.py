"""Rows of ``bench traffic``: models that continue a window, and counts over their samples."""

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
from advdiff_sumo.diffusion.sample_refinement import Decode, fixed_neighbours_decode, refine_samples
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
from advdiff_sumo.training.displacement import driving_mask, logged_rollout
from advdiff_sumo.training.open_loop import Draw, by_diffusion, from_prior, judge

Continue = Callable[[SceneBatch, int, torch.Generator], tuple[Rollout, int]]
"""Windows and number of samples → joint futures, those of a window in succession, and samples per window."""
LATENT_STEPS, TRAJECTORY_STEPS = 5, 10
"""Steps of DDIM: as in closed loop; ``traj2traj`` needs more, as five make its trajectories rougher by half."""


@dataclass(frozen=True)
class ComparedModel:
    """A row of the table.

    Attributes:
        title: printed name.
        weights: file among the shipped weights; "" for the log itself.
        load: path of the weights → function that samples futures.
        view: how much of the map the networks see.
    """

    title: str
    weights: str
    load: Callable[[Path], Continue]
    view: MapView = "near"

    @property
    def path(self) -> Path:
        """Path of its weights."""
        return shipped_weights().parent / self.weights

    @property
    def is_installed(self) -> bool:
        """Whether its weights are installed."""
        return not self.weights or self.path.is_file()


@dataclass(frozen=True)
class WindowCounts:
    """Counts over W windows, each (W,) or (W, bins).

    Attributes:
        sfde_m: mean final error over a sample's vehicles, of the sample in which it is least.
        fdd_m: sum over vehicles of the mean distance of final positions between samples.
        vehicles: number of driving vehicles.
        trials: vehicles times samples.
        hit: trials in which the vehicle's box comes to overlap another one.
        off_road: trials in which the vehicle's centre leaves the road.
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
    return lambda batch, _samples, _generator: (logged_rollout(batch), 1)


def _simnet(path: Path) -> Continue:
    simnet = load_simnet(path).eval().requires_grad_(False)
    return lambda batch, _samples, _generator: (simnet(batch), 1)


def _prior(path: Path) -> Continue:
    bundle = _bundle(path)
    return _encoding(bundle, from_prior(bundle))


def _diffusion(path: Path, refines: bool = False, steps: int = LATENT_STEPS) -> Continue:
    """Return a function that samples with *steps* of DDIM; *refines*: overlaps of the samples are reduced."""
    bundle = _bundle(path)
    refine = partial(_refined, _refinement_decoder(bundle)) if refines else None
    return _encoding(bundle, by_diffusion(bundle, steps, refine))


def _encoding(bundle: Bundle, draw: Draw) -> Continue:
    """Return *draw* preceded by the encoder of *bundle*."""
    return lambda batch, samples, generator: draw(batch, bundle.traffic.encoder(batch), samples, generator)


def _refinement_decoder(bundle: Bundle) -> Decode:
    """Return the decoder with which samples are refined."""
    assert isinstance(bundle.codec, LatentCodec)  # noqa: S101 - the row names latent weights
    return fixed_neighbours_decode(bundle.codec, FastDecoder(bundle.traffic.decoder))


def _refined(decode: Decode, sample: Tensor, context: Context, repeated: SceneBatch, samples: int) -> Tensor:
    """Return *sample* with fewer overlaps; windows are refined one by one, to save the time for padding."""
    refined = sample.clone()
    for begin in range(0, repeated.scenes, samples):
        window = slice(begin, begin + samples)
        agents = int(repeated.present[begin].nonzero().max()) + 1
        batch = repeated.rows(window).rows_of(torch.arange(agents))
        window_context = context.rows(window).first(agents)
        refined[window, :agents] = refine_samples(sample[window, :agents], decode, window_context, batch)
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
        "… made to fit together", "traffic.safetensors", partial(_diffusion, refines=True)
    ),
}


@torch.no_grad()
def count(name: str, batch: SceneBatch, samples: int, seed: int) -> WindowCounts:
    """Return the counts of the futures that model *name* samples for the windows of *batch*.

    Args:
        name: of ``MODELS``.
        batch: W windows with their recorded futures.
        samples: joint samples of each.
        seed: of the random numbers.
    """
    seeds = SeedTree(seed, ("bench", "traffic", name))
    generator = torch.Generator().manual_seed(seeds.integer(62))
    rollout, samples_per_window = _continuation(name)(batch, samples, generator)
    repeated = batch.repeat(samples_per_window)
    evaluated = judge(rollout, repeated, samples_per_window, repeated.future_valid if name == "log" else None)
    vehicles = evaluated.driving.sum(1)
    return WindowCounts(
        sfde_m=_to_numpy(evaluated.sfde_m),
        fdd_m=_to_numpy(torch.where(evaluated.driving, evaluated.spread_m, 0.0).sum(1)),
        vehicles=_to_numpy(vehicles),
        trials=_to_numpy(vehicles * samples_per_window),
        hit=_to_numpy(evaluated.hit.sum((1, 2))),
        off_road=_to_numpy(evaluated.off_road.sum((1, 2))),
        speed=evaluated.speed,
        accel=evaluated.accel,
        ttc=_ttc_histograms(rollout, repeated, samples_per_window),
    )


def _ttc_histograms(rollout: Rollout, batch: SceneBatch, samples_per_window: int) -> FloatArray:
    """Return histograms (W, bins) of times to collision of driving vehicles at the known instants."""
    is_known = (driving_mask(batch)[..., None] & realism.known_steps(batch)).numpy()
    windows = len(is_known) // samples_per_window
    rows = (part.reshape(windows, -1) for part in (ttc_of(rollout, batch), is_known))
    return np.stack([ttc_counts(ttc_s[mask]) for ttc_s, mask in zip(*rows, strict=True)])


def ttc_of(rollout: Rollout, batch: SceneBatch) -> FloatArray:
    """Return the least times to collision (B, A, T) of the agents of *batch* along *rollout*.

    Velocities are differences of positions, so that log and models are measured alike.
    """
    previous_xy = torch.cat((batch.pose[:, :, None, :2], rollout.xy[:, :, :-1]), dim=2)
    velocity = _to_numpy((rollout.xy - previous_xy) / MODEL_STEP_S).swapaxes(1, 2)
    is_present = (realism.known_steps(batch) & batch.present[..., None]).numpy().swapaxes(1, 2)
    ttc_s = least_ttc(
        _to_numpy(rollout.xy).swapaxes(1, 2),
        _to_numpy(rollout.yaw).swapaxes(1, 2),
        velocity,
        _to_numpy(batch.size)[:, None],
        is_present,
    )
    return np.asarray(ttc_s.swapaxes(1, 2))


@lru_cache(maxsize=len(MODELS))
def _continuation(name: str) -> Continue:
    return MODELS[name].load(MODELS[name].path)


@lru_cache(maxsize=2)
def _bundle(path: Path) -> Bundle:
    return load_bundle(path).frozen()


def _to_numpy(value: Tensor) -> FloatArray:
    return value.double().cpu().numpy()
