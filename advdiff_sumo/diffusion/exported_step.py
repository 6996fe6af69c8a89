"""One step of a decoder as machine code, compiled from ``Decoder.step`` and ``ClosedLoopDecoder.step``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from torch import Tensor, nn
from torch.nn.functional import pad

from advdiff_sumo.diffusion.machine_code import MachineCode, machine_code, package_for
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.closed_loop_decoder import LanesAndEdges
from advdiff_sumo.models.decoder import Decoder, Motion, State, Surroundings
from advdiff_sumo.models.lane_attention import LanePieces
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.road_edges import RoadEdges

_NOT_OF_THE_STEP = {
    "denoiser_situation",
    "denoiser_layers",
    "channels",
    "interaction_layers",
    "reward_hidden",
}
"""Options that do not change the step: networks that differ only in them share its machine code."""


class StepOnTensors(nn.Module):
    """The step of *decoder* as a module of tensors, to be compiled."""

    def __init__(self, decoder: Decoder) -> None:
        super().__init__()
        self.decoder = decoder

    def forward(self, free: Sequence[Tensor], held: Sequence[Tensor]) -> tuple[Tensor, ...]:
        """Return the state after the step, the memory and the messages sent.

        *free* are memory, latents, motion of the rows and motion of all agents; *held* the messages of agents that are
        not rolled out, then :func:`tensors_of`.
        """
        memory, z, *motions = free
        others, *around = held
        motion, everybody = (motions[0], motions[1], motions[2]), (motions[3], motions[4], motions[5])
        state, memory, senders = self.decoder.step(memory, z, _around(around), motion, everybody, others)
        return (*state, memory, senders)


class ExportedStep:
    """A ``Step`` by machine code *code*, which was compiled from *decoder*, with the weights of *decoder*."""

    def __init__(self, decoder: Decoder, code: MachineCode) -> None:
        self._decoder, self.code = decoder, code
        self._agents = least_agents(decoder.options)
        self._around: tuple[Surroundings, list[Tensor]] | None = None
        self._fits = False

    def __call__(
        self,
        memory: Tensor,
        z: Tensor,
        around: Surroundings,
        motion: Motion,
        everybody: Motion,
        others: Tensor | None,
    ) -> tuple[State, Tensor, Tensor]:
        """Return the result of the decoder's step, up to rounding."""
        options, agents = self._decoder.options, around.batch.agents
        more = max(self._agents - agents, 0)
        if others is None:
            others = memory.new_zeros(options.decoder_layers, len(memory), agents, options.message)
        free = [memory, z, *motion, *(_padded(value, more, 1) for value in everybody)]
        others = _padded(others, more, 2)
        if self._around is None or self._around[0] is not around:  # sizes stay the same through a rollout
            self._around = around, [value.contiguous() for value in tensors_of(around, more)]
            self._fits = self.code.fitting.holds([*free, others, *self._around[1]])
        *state, memory, senders = self.code(free, [others, *self._around[1]], self._fits)
        xy, yaw, speed, accel, curvature = state
        return (xy, yaw, speed, accel, curvature), memory, senders[:, :, :agents]


def exported_step(decoder: Decoder) -> ExportedStep | None:
    """Return the compiled step of *decoder*; None if there is none."""
    code = machine_code(step_package(decoder.options), StepOnTensors(decoder))
    return ExportedStep(decoder, code) if code is not None else None


def step_package(options: ModelOptions) -> Path:
    """Return the path of the machine code for networks of these *options*, which may not exist."""
    return package_for("decoder-step", step_sizes(options))


def step_sizes(options: ModelOptions) -> dict[str, Any]:
    """Return the options that the machine code of a step depends on."""
    return options.model_dump(mode="json", exclude=_NOT_OF_THE_STEP)


def least_agents(options: ModelOptions) -> int:
    """Return the least number of agents of the machine code; smaller scenes are padded with absent agents."""
    return options.neighbours + 1


def tensors_of(around: Surroundings, more: int = 0) -> tuple[Tensor, ...]:
    """Return the constant inputs of a rollout as tensors, padded by *more* absent agents."""
    own, batch = around.own, around.batch
    everybody = _padded(batch.size, more, 1), _padded(batch.present, more, 1)
    inputs = (around.rows, own.pose, own.size, own.present, own.moved, *everybody)
    if isinstance(around, LanesAndEdges):
        inputs = (*inputs, *vars(around.lanes).values(), *vars(around.edges).values())
    return inputs


def _padded(value: Tensor, more: int, dim: int) -> Tensor:
    return pad(value, (0, 0) * (value.dim() - 1 - dim) + (0, more)) if more else value


def _around(parts: Sequence[Tensor]) -> Surroundings:
    """Return the surroundings with these :func:`tensors_of`, with the parts that a step reads."""
    rows, pose, size, present, moved, all_size, all_present, *rest = parts
    own = scene_of_tensors(pose, size, present, moved)
    batch = scene_of_tensors(pose, all_size, all_present, moved)
    if not rest:
        return Surroundings(batch, own, rows)
    return LanesAndEdges(batch, own, rows, LanePieces(*rest[:3]), RoadEdges(*rest[3:]))


def scene_of_tensors(pose: Tensor, size: Tensor, present: Tensor, moved: Tensor) -> SceneBatch:
    """Return a batch with only the parts that a step reads."""
    nothing = dict.fromkeys((part.name for part in fields(SceneBatch)), pose.new_zeros(0))
    inputs = {"past": pose[:, :, None], "size": size, "present": present, "moved": moved}
    return SceneBatch(**{**nothing, **inputs})
