"""Stage "simnet": behaviour cloning of actions, unrolled in closed loop so that errors do not accumulate.

Bergamini et al. 2021 (doi:10.1109/ICRA48506.2021.9561666) clone one step and perturb the past against drift. Here the
loss is of a closed-loop rollout: each step starts from the predicted states, errors of all instants count, and
gradients flow through the rollout. The number of steps grows during training.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor, nn

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.losses import reconstruction
from advdiff_sumo.models.model_options import FUTURE_STEPS
from advdiff_sumo.models.simnet import SimNet
from advdiff_sumo.training import realism
from advdiff_sumo.training.cvae import known_mean
from advdiff_sumo.training.displacement import displacement
from advdiff_sumo.training.presets import SimnetOptions
from advdiff_sumo.training.stage import Moment, Stage, Tally


class SimnetStage(Stage):
    """Trains SimNet.

    Args:
        simnet: trained in place.
        options: of the unrolling.
    """

    name = "simnet"
    monitor = "loss"

    def __init__(self, simnet: SimNet, options: SimnetOptions) -> None:
        self.simnet, self.options = simnet, options
        self.module: nn.Module = simnet
        self.beside: nn.Module = nn.Module()

    def loss(self, batch: SceneBatch, moment: Moment) -> dict[str, Tensor]:
        """Return the error of a rollout with the present number of steps."""
        short = first_steps(batch, unrolled_steps(moment.progress, self.options))
        rollout = self.simnet(short, short.future.shape[2])
        return {"loss": known_mean(reconstruction(rollout, short), short)}

    def evaluate(self, batch: SceneBatch, generator: torch.Generator) -> Tally:  # noqa: ARG002 - nothing is drawn
        """Return the error over the whole future, displacement errors, collisions and road departures."""
        rollout: Rollout = self.simnet(batch)
        loss, scenes = float(known_mean(reconstruction(rollout, batch), batch)), float(batch.scenes)
        tally = displacement(rollout, batch)
        is_present = batch.present[..., None].expand(rollout.yaw.shape)
        return {
            "loss": (loss * scenes, scenes),
            "ade_m": tally.ade_sum(),
            "fde_m": tally.fde_sum(),
            **realism.faults(rollout, batch, is_present),
        }


def unrolled_steps(progress: float, options: SimnetOptions) -> int:
    """Return the number of steps of a rollout at *progress* (0 … 1) of the training."""
    share = 1.0 if options.growth_share == 0.0 else min(progress / options.growth_share, 1.0)
    return round(options.first_steps + share * (options.steps - options.first_steps))


def first_steps(batch: SceneBatch, steps: int) -> SceneBatch:
    """Return the scenes with only the first *steps* instants of their future."""
    cut = slice(0, min(steps, FUTURE_STEPS))
    return replace(batch, future=batch.future[:, :, cut], future_valid=batch.future_valid[:, :, cut])
