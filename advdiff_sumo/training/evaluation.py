"""Judges weights on windows: errors, diversity and realism, beside baselines and the log itself."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from advdiff_sumo.core.errors import FileError, os_reason
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.metrics.statistics import jensen_shannon
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.training import realism
from advdiff_sumo.training.baselines import constant_velocity, lane_following
from advdiff_sumo.training.dataset import WindowSet, batches
from advdiff_sumo.training.displacement import driving_mask, logged_rollout, masked_sum
from advdiff_sumo.training.driving_penalties import travelled_m
from advdiff_sumo.training.open_loop import Draw, JudgedWindows, by_diffusion, from_prior, judge
from advdiff_sumo.training.stage import Tally, add, means

Figures = dict[str, float]
_STANDS_M = 1.0


@dataclass(frozen=True)
class EvaluationSettings:
    """Settings of an evaluation.

    Attributes:
        samples: joint samples of each scene.
        steps: DDIM steps.
        windows: most windows used, evenly spaced; None: all.
        batch_size: scenes in a batch.
        seed: of the samples.
    """

    samples: int = 10
    steps: int = 10
    windows: int | None = 512
    batch_size: int = 8
    seed: int = 0


@dataclass
class _Sums:
    """Sums over windows for one method of prediction."""

    tally: Tally = field(default_factory=dict)
    speed: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(realism.SPEED_BINS) - 1))
    accel: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(realism.ACCEL_BINS) - 1))

    def count(self, judged: JudgedWindows, standing: Tensor) -> None:
        """Add histograms, collisions, road departures and *standing* vehicles (W S, A)."""
        self.speed += judged.speed.sum(0)
        self.accel += judged.accel.sum(0)
        total = float(judged.driving.sum() * judged.hit.shape[1])
        parts = {"collision_rate": judged.hit, "off_road_rate": judged.off_road, "standing_rate": standing}
        add(self.tally, {name: (float(part.sum()), total) for name, part in parts.items()})


def methods(bundle: Bundle, judging: EvaluationSettings) -> dict[str, Draw]:
    """Return the methods of prediction that the bundle's stages allow, and the baselines."""
    draws: dict[str, Draw] = {
        "constant velocity": lambda batch, *_: (constant_velocity(batch), 1),
        "lane following": lambda batch, *_: (lane_following(batch), 1),
    }
    if "traffic" in bundle.stages:
        draws["posterior"] = lambda batch, context, *_: (
            bundle.traffic.decoder(bundle.traffic.posterior(batch, context.h).mean, context.h, batch),
            1,
        )
        draws["prior"] = from_prior(bundle)
    if "denoiser" in bundle.stages:
        name = "latent diffusion" if bundle.options.codec == "latent" else "trajectory diffusion"
        draws[name] = by_diffusion(bundle, judging.steps)
    return draws


@torch.no_grad()
def evaluate_bundle(
    bundle: Bundle,
    windows: WindowSet,
    judging: EvaluationSettings,
    device: torch.device,
    on_progress: Callable[[int, int], None] | None = None,
) -> dict[str, Figures]:
    """Return the figures of each method of prediction, and of the log.

    Errors are of driving vehicles: not parked, with a known future. With several samples, ``min_ade_m`` and
    ``min_fde_m`` take the best one of each vehicle, ``min_sfde_m`` the best one of each scene as a whole.
    ``energy_m`` is the energy score of the final positions, FDE − FDD / 2 (Gneiting and Raftery 2007,
    doi:10.1198/016214506000001437): low if samples are near the recorded future and as diverse as it requires.
    JSD is against the log's histogram, base 2. ``standing_rate`` counts vehicles that drive less than 1 m.

    Args:
        bundle: networks; untrained parts are not judged.
        windows: with recorded futures.
        judging: settings.
        device: of the computation.
        on_progress: called with the numbers of finished and of all windows.

    Raises:
        ConfigError: the windows show another view of the map than the networks see.
    """
    windows.must_show(bundle.options.model.map_view)
    bundle.to(device).frozen()
    ways = methods(bundle, judging)
    sums = {name: _Sums() for name in (*ways, "log")}
    chosen = windows.spread(len(windows) if judging.windows is None else judging.windows)
    few, done = windows.subset(chosen), 0
    for number, rows in enumerate(batches(few, judging.batch_size)):
        batch = few.batch(rows).to(device)
        context = bundle.traffic.encoder(batch)
        log = logged_rollout(batch)
        sums["log"].count(judge(log, batch, 1, batch.future_valid), _standing(log, batch))
        for name, draw in ways.items():
            node = SeedTree(judging.seed, ("evaluation", name, str(number)))
            generator = torch.Generator().manual_seed(node.integer(62))
            rollout, times = draw(batch, context, judging.samples, generator)
            _add(sums[name], rollout, batch.repeat(times), times)
        done += len(rows)
        if on_progress is not None:
            on_progress(done, len(chosen))
    return {name: _figures(method_sums, sums["log"]) for name, method_sums in sums.items()}


def write_figures(
    path: Path, figures: dict[str, Figures], judging: EvaluationSettings, windows: WindowSet
) -> None:
    """Write the figures as JSON, with weights, data and settings.

    Raises:
        FileError: *path* cannot be written.
    """
    text = {"judging": vars(judging), "windows": len(windows), "data": windows.digest, "figures": figures}
    try:
        path.write_text(json.dumps(text, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    except OSError as error:
        raise FileError(path, f"cannot be written ({os_reason(error)})", "choose another --out") from None


def _add(sums: _Sums, rollout: Rollout, several: SceneBatch, times: int) -> None:
    judged = judge(rollout, several, times)
    ade, fde, is_driving = judged.ade_m, judged.fde_m, judged.driving
    parts: dict[str, tuple[float, float]] = {
        "ade_m": masked_sum(ade.mean(1), is_driving),
        "fde_m": masked_sum(fde.mean(1), is_driving),
        "min_ade_m": masked_sum(ade.amin(1), is_driving),
        "min_fde_m": masked_sum(fde.amin(1), is_driving),
        "min_sfde_m": masked_sum(judged.sfde_m, is_driving.any(1)),
    }
    if times > 1:
        parts["fdd_m"] = masked_sum(judged.spread_m, is_driving)
    add(sums.tally, parts)
    sums.count(judged, _standing(rollout, several))


def _standing(rollout: Rollout, batch: SceneBatch) -> Tensor:
    return (travelled_m(rollout, batch) < _STANDS_M) & driving_mask(batch)


def _figures(method_sums: _Sums, log: _Sums) -> Figures:
    figures = means(method_sums.tally)
    if method_sums is not log:
        figures["energy_m"] = figures["fde_m"] - 0.5 * figures.get(
            "fdd_m", 0.0
        )  # one sample has no diversity
        figures["jsd_speed"] = float(jensen_shannon(method_sums.speed, log.speed))
        figures["jsd_accel"] = float(jensen_shannon(method_sums.accel, log.accel))
    return figures


def columns(figures: dict[str, Figures]) -> list[str]:
    """Return the names of all figures, in the order of the table."""
    return [name for name in _ORDER if any(name in row for row in figures.values())]


_ORDER = (
    *("ade_m", "fde_m", "min_ade_m", "min_fde_m", "min_sfde_m", "fdd_m", "energy_m"),
    *("jsd_speed", "jsd_accel", "collision_rate", "off_road_rate", "standing_rate"),
)
