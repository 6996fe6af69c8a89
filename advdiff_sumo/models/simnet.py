"""SimNet: predicts every vehicle's next action from the present scene, one step at a time.

After Bergamini et al. 2021, "SimNet: Learning reactive self-driving simulations from real-world observations"
(doi:10.1109/ICRA48506.2021.9561666). Theirs encodes a raster around each agent; this one uses the context encoder of
the traffic model, so that both have the same input and differ in what they learn. It is deterministic: it has no
latent, and the same scene gives the same future.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import AGAIN
from advdiff_sumo.models.bundle import FORMAT as BUNDLE_FORMAT
from advdiff_sumo.models.context import ContextEncoder
from advdiff_sumo.models.decoder import Forced, Rollout, State, motion_now, rollout_of
from advdiff_sumo.models.model_options import FUTURE_STEPS, MODEL_STEP_S, ModelOptions
from advdiff_sumo.models.perceptron import perceptron
from advdiff_sumo.models.stored import (
    fill,
    read_stored,
    stored_format,
    stored_options,
    with_prefix,
    write_stored,
)
from advdiff_sumo.models.tensor_bicycle import controls, step

FORMAT = "advdiff-simnet-1"
_AGAIN = f"{AGAIN}: advdiff-sumo train simnet"
_MOTION = 2


class SimNet(nn.Module):
    """Context encoder and a head that predicts each vehicle's acceleration and curvature for half a second.

    Attributes:
        options: sizes of the networks and the limits of the actions.
        encoder: (map, past) → h; its prior over latents is not used.
        head: (h, speed, size) → two unbounded numbers.
    """

    def __init__(self, options: ModelOptions) -> None:
        super().__init__()
        self.options = options
        width = options.hidden
        self.encoder = ContextEncoder(options)
        self.encoder.prior.requires_grad_(False)
        self.head = perceptron(width + _MOTION, width, width, 2)

    def act(self, batch: SceneBatch) -> tuple[Tensor, Tensor]:
        """Return accelerations (m/s²) and curvatures (1/m), (B, A), for the next half second; 0 for pedestrians."""
        speed, length = batch.pose[..., 3].clamp(min=0.0), batch.size[..., 0]
        motion = torch.stack((0.1 * speed, 0.1 * length), dim=-1)
        raw = self.head(torch.cat((self.encoder(batch).h, motion), dim=-1))
        accel, curvature = controls(raw, speed, length, self.options)
        return accel * batch.moved, curvature * batch.moved

    def forward(self, batch: SceneBatch, steps: int = FUTURE_STEPS, forced: Forced | None = None) -> Rollout:
        """Return the joint future of *steps* instants: predict actions, move half a second, encode again, and so on.

        The map pieces stay those around the present positions; signals keep their state. *Forced* agents, such as a
        target, follow their given states, which the others observe.
        """
        states: list[State] = []
        for k in range(steps):
            action = self.act(batch)
            state = (*step(*motion_now(batch), *action, MODEL_STEP_S), *action)
            states.append(state if forced is None else forced.put(k, state))
            if k + 1 < steps:
                batch = batch.advanced(rollout_of(states[-1:]).states())
        return rollout_of(states)


def new_simnet(options: ModelOptions, seed: int = 0) -> SimNet:
    """Return an untrained network; the same seed gives the same weights."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return SimNet(options)


def save_simnet(simnet: SimNet, path: Path, extra: Mapping[str, Any] | None = None) -> None:
    """Write *simnet* to *path*, a ".safetensors" file; *extra* is added to its header as JSON."""
    options = simnet.options.model_dump(mode="json")
    write_stored(
        path, simnet.state_dict(), {"format": FORMAT, "options": options, "extra": dict(extra or {})}
    )


def load_simnet(path: Path) -> SimNet:
    """Read what :func:`save_simnet` wrote.

    Raises:
        WeightsError: no such file, another format, or tensors that do not fit the options in its header.
    """
    missing = "make it with advdiff-sumo train simnet, and name it by the option weights"
    header, tensors = read_stored(path, FORMAT, missing, _AGAIN)
    simnet = new_simnet(ModelOptions.parse(stored_options(header, path, _AGAIN), f"{path}: its options"))
    fill(simnet, tensors, path, "its own options")
    return simnet


def begin_simnet(init: Path | None, options: ModelOptions, seed: int = 0) -> SimNet:
    """Return the initial network of a training.

    Args:
        init: a file of :func:`save_simnet`, or a traffic bundle, whose context encoder is used; None: new weights.
        options: sizes if there is no *init*.
        seed: of new weights.

    Raises:
        WeightsError: *init* cannot be used: no such file, another format, or an encoder that does not fit its options.
    """
    if init is None:
        return new_simnet(options, seed)
    if stored_format(init) == FORMAT:
        return load_simnet(init)
    header, tensors = read_stored(init, BUNDLE_FORMAT, "name weights of the stage traffic with --init", AGAIN)
    model = stored_options({"options": stored_options(header, init, _AGAIN).get("model")}, init, _AGAIN)
    simnet = new_simnet(ModelOptions.parse(model, f"{init}: its options"), seed)
    encoder = {f"encoder.{name}": value for name, value in with_prefix(tensors, "traffic.encoder.").items()}
    head = {f"head.{name}": value for name, value in simnet.head.state_dict().items()}
    fill(simnet, {**encoder, **head}, init, "its own options")
    return simnet
