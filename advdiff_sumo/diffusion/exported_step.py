"""The step of the closed-loop decoder as machine code, made of ``ClosedLoopDecoder.step`` itself."""

from __future__ import annotations

from pathlib import Path

from torch import Tensor, nn
from torch.nn.functional import pad

from advdiff_sumo.diffusion.machine_code import MachineCode, machine_code, package_for
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.closed_loop_decoder import ClosedLoopDecoder, LanesAndEdges
from advdiff_sumo.models.decoder import Motion, State, Surroundings
from advdiff_sumo.models.lane_attention import LanePieces
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.road_edges import RoadEdges

_NOT_OF_THE_STEP = {"denoiser_situation"}  # networks that differ in it alone share the machine code


class StepOnTensors(nn.Module):
    """``ClosedLoopDecoder.step`` with tensors for arguments and results.

    Args:
        decoder: whose step it is.
    """

    def __init__(self, decoder: ClosedLoopDecoder) -> None:
        super().__init__()
        self.decoder = decoder

    def forward(
        self,
        memory: Tensor,
        z: Tensor,
        motion: Motion,
        everybody: Motion,
        others: Tensor,
        around: tuple[Tensor, ...],
    ) -> tuple[Tensor, ...]:
        """Return the state after the step, the memory and the senders; *around* is of :func:`tensors_of`."""
        rows, pose, size, present, moved, all_size, all_present, *rest = around
        own, batch = _scene(pose, size, present, moved), _scene(pose, all_size, all_present, moved)
        surroundings = LanesAndEdges(batch, own, rows, LanePieces(*rest[:3]), RoadEdges(*rest[3:]))
        state, memory, senders = self.decoder.step(memory, z, surroundings, motion, everybody, others)
        return (*state, memory, senders)


class ExportedStep:
    """The machine code with the weights of one decoder; a ``Step`` of the closed-loop decoder, without gradients.

    Args:
        decoder: whose step it is.
        code: made of it, with its weights.
    """

    def __init__(self, decoder: ClosedLoopDecoder, code: MachineCode) -> None:
        self._code = code
        self._agents = least_agents(decoder.options)
        self._layers, self._message = decoder.options.decoder_layers, decoder.options.message
        self._around: tuple[Surroundings, list[Tensor]] | None = None

    def __call__(
        self,
        memory: Tensor,
        z: Tensor,
        around: Surroundings,
        motion: Motion,
        everybody: Motion,
        others: Tensor | None,
    ) -> tuple[State, Tensor, Tensor]:
        """Return what ``ClosedLoopDecoder.step`` does, up to rounding."""
        agents = around.batch.agents
        more = max(self._agents - agents, 0)
        if others is None:
            others = memory.new_zeros(self._layers, len(memory), agents, self._message)
        if self._around is None or self._around[0] is not around:
            self._around = around, [value.contiguous() for value in tensors_of(around, more)]
        seen = [_padded(value, more, 1) for value in everybody]
        given = [memory, z, *motion, *seen, _padded(others, more, 2)]
        *state, memory, senders = self._code([*given, *self._around[1]])
        xy, yaw, speed, accel, curvature = state
        return (xy, yaw, speed, accel, curvature), memory, senders[:, :, :agents]


def exported_step(decoder: ClosedLoopDecoder) -> ExportedStep | None:
    """Return the compiled step of *decoder*, or None where there is none for it."""
    code = machine_code(step_package(decoder.options), "decoder", decoder)
    return ExportedStep(decoder, code) if code is not None else None


def step_package(options: ModelOptions) -> Path:
    """Return where the machine code for networks of these *options* ships, if it does."""
    return package_for("decoder-step", options.model_dump(mode="json", exclude=_NOT_OF_THE_STEP))


def least_agents(options: ModelOptions) -> int:
    """Return how many agents the machine code needs; absent ones make up for those that a scene lacks."""
    return options.neighbours + 1


def tensors_of(around: Surroundings, more: int = 0) -> tuple[Tensor, ...]:
    """Return what stays the same through a rollout, with *more* absent agents."""
    assert isinstance(around, LanesAndEdges)  # noqa: S101 - tells the type checker what a closed-loop decoder gives
    own, batch, lanes, edges = around.own, around.batch, around.lanes, around.edges
    scene = own.pose, own.size, own.present, own.moved
    everybody = _padded(batch.size, more, 1), _padded(batch.present, more, 1)
    pieces = lanes.xy, lanes.features, lanes.valid, edges.usable, edges.lines, edges.along, edges.left
    return (around.rows, *scene, *everybody, *pieces)


def _padded(value: Tensor, more: int, dim: int) -> Tensor:
    return pad(value, (0, 0) * (value.dim() - 1 - dim) + (0, more)) if more else value


def _scene(pose: Tensor, size: Tensor, present: Tensor, moved: Tensor) -> SceneBatch:
    """Return a batch that holds what a step reads, and nothing else."""
    nothing = pose.new_zeros(0)
    return SceneBatch(
        past=pose[:, :, None],
        past_valid=nothing,
        size=size,
        classes=nothing,
        present=present,
        moved=moved,
        parked=nothing,
        map_xy=nothing,
        map_features=nothing,
        map_valid=nothing,
        future=nothing,
        future_valid=nothing,
    )
