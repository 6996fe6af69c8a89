"""The step of the closed-loop decoder as machine code, which AOTInductor makes of ``ClosedLoopDecoder.step`` itself.

``tools/build_decoder_step.py`` makes it for the sizes of the shipped weights, PyTorch of one version and x86-64 with
AVX2. It holds no weights: it is given those of the decoder at hand. Without it, and for other sizes, versions and
machines, the network's own step is used, which takes three times as long.
"""

from __future__ import annotations

import hashlib
import json
import logging
import platform
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.closed_loop_decoder import ClosedLoopDecoder, LanesAndEdges
from advdiff_sumo.models.decoder import Motion, State, Surroundings
from advdiff_sumo.models.lane_attention import LanePieces
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.road_edges import RoadEdges

_LOG = logging.getLogger(__name__)
_FOLDER = Path(__file__).resolve().parent.parent / "weights"
_CAPABLE = ("AVX2", "AVX512")
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
        decoder: on the CPU.
        package: of :func:`package_for`.
    """

    def __init__(self, decoder: ClosedLoopDecoder, package: Path) -> None:
        self._loader = torch._C._aoti.AOTIModelPackageLoader(str(package), "model", True, 1, -1)
        needed = set(self._loader.get_constant_fqns())
        own = {f"decoder.{name}": value for name, value in decoder.state_dict().items()}
        weights = {name: value for name, value in own.items() if name in needed}
        self._loader.load_constants(weights, False, False, False, False)
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
        *state, memory, senders = self._loader.boxed_run([v.contiguous() for v in given] + self._around[1])
        xy, yaw, speed, accel, curvature = state
        return (xy, yaw, speed, accel, curvature), memory, senders[:, :, :agents]


def exported_step(decoder: ClosedLoopDecoder) -> ExportedStep | None:
    """Return the compiled step of *decoder*, or None where there is none for it."""
    package = package_for(decoder.options)
    here = decoder.start.weight.device.type == "cpu" and torch.backends.cpu.get_cpu_capability() in _CAPABLE
    if not (here and package.exists()):
        return None
    try:
        return ExportedStep(decoder, package)
    except (
        RuntimeError
    ) as error:  # it is unpacked to the folder of temporary files, which may refuse to hold code
        _LOG.warning("the decoder's machine code cannot be loaded, planning takes twice as long: %s", error)
        return None


def package_for(options: ModelOptions) -> Path:
    """Return where the machine code for networks of these *options* and this PyTorch ships, if it does."""
    version = torch.__version__.split("+")[0]
    content = json.dumps([version, options.model_dump(mode="json", exclude=_NOT_OF_THE_STEP)], sort_keys=True)
    digest = hashlib.sha256(content.encode()).hexdigest()[:8]
    system = f"{platform.system()}-{platform.machine()}".lower()
    return _FOLDER / f"decoder-step-{digest}-{system}.pt2"


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
