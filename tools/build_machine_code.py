"""Compile the networks to the machine code that is part of the package.

    python tools/build_machine_code.py [NAME ...]

AOTInductor compiles, for the shipped weights NAME (default: all):

1. the prediction of a denoiser,
2. the step of a decoder, the value of a reward model and the costs of attacks, each with its gradient ("slope"), which
   is traced through autograd,
3. the gradients of whole attacks.

The code fits the sizes of these weights, this version of PyTorch, and any x86-64 machine with AVX2. The script needs
g++ and some minutes. Run it after a change of these networks (``tests/diffusion`` says when), of the sizes of the
shipped weights, or of PyTorch. The files state the sizes that the code is for. They contain no weights, sources,
symbols or folder names of the machine. A second build has the same instructions, but other file names and build
numbers. The shipped denoisers come from an earlier version of this script, with other instructions and the same
results.
"""

from __future__ import annotations

import os

os.environ["TORCHINDUCTOR_CPP_MARCH"] = "x86-64-v3"  # read when PyTorch is imported

import argparse
import json
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import torch
import torch._inductor.config
from torch import Tensor, nn
from torch._inductor.runtime.cache_dir_utils import cache_dir
from torch.export import Dim, export
from torch.func import functional_call
from torch.fx.experimental.proxy_tensor import make_fx
from torch.utils._pytree import tree_leaves

from advdiff_sumo.core.map_view import MAP_PIECES
from advdiff_sumo.diffusion.attack import CostsOnTensors, costs_package
from advdiff_sumo.diffusion.attack_costs import COSTS
from advdiff_sumo.diffusion.attack_slope import AttackOnTensors, attack_package
from advdiff_sumo.diffusion.exported_step import StepOnTensors, least_agents, step_package
from advdiff_sumo.diffusion.fast_networks import (
    PredictionOnTensors,
    RewardOnTensors,
    denoiser_package,
    reward_package,
)
from advdiff_sumo.diffusion.machine_code import FITTING, Fitting, slope_of
from advdiff_sumo.models.bundle import Bundle, load_bundle
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.denoiser import STEP_WIDTH, Denoiser
from advdiff_sumo.models.model_options import PIECE_FEATURES, PIECE_POINTS, ModelOptions
from advdiff_sumo.models.shipped_weights import find_weights
from advdiff_sumo.traffic.diffusion.guidance import HORIZON_STEPS, NEAR_STEPS

_INDUCTOR = {
    "cpp.threads": 1,
    "cpp.simdlen": 256,
    "always_keep_tensor_constants": True,
    "joint_graph_constant_folding": False,  # it would write a bias of a single number into the code
}
_Network = TypeVar("_Network", bound=nn.Module)
WEIGHTS = ("closed-loop", "traffic", "traj2traj")

#: Dynamic sizes (scenes, rows, agents, segments of the road's edge, instants): size in the example, and largest size.
#: In the example, all differ from each other and from all widths; otherwise the compiler would treat them as equal.
SIZES = {"B": (17, 4096), "R": (11, 1024), "A": (19, 1024), "S": (23, 4096), "T": (29, 1024)}
_NAMES = {size: name for name, (size, _) in SIZES.items()}

#: Arguments that are constant during a rollout: their shapes, and the types of those that are not real numbers.
_AROUND = (("R",), ("B", "R", 4), ("B", "R", 2), ("B", "R"), ("B", "R"), ("B", "A", 2), ("B", "A"))
_AROUND_KINDS = {0: torch.long, 3: torch.bool, 4: torch.bool, 6: torch.bool}


@dataclass(frozen=True)
class Example:
    """Example arguments of a function (free, held) of tensors.

    Attributes:
        free: shapes of the arguments with gradients; each size is a number or a name of ``SIZES``.
        held: shapes of the arguments without gradients.
        least_agents: least number of agents that the code must support.
        kinds: index in *held* → type, for arguments that are not real numbers.
    """

    free: Sequence[tuple[int | str, ...]]
    held: Sequence[tuple[int | str, ...]]
    least_agents: int = 1
    kinds: dict[int, torch.dtype] = field(default_factory=dict)

    def tensors(self) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
        """Return the tensors (free, held)."""
        free = tuple(_tensor(shape, torch.float32) for shape in self.free)
        held = (_tensor(shape, self.kinds.get(k, torch.float32)) for k, shape in enumerate(self.held))
        return free, tuple(held)

    def fitting(self, given: Any) -> Fitting:
        """Return the types and sizes that code compiled for the tensors in *given* supports."""
        leaves = tree_leaves(given)
        arguments = [(str(value.dtype), [_NAMES.get(size, size) for size in value.shape]) for value in leaves]
        return Fitting(arguments, {name: (self._least(name), most) for name, (_, most) in SIZES.items()})

    def any_size(self, given: Any) -> Any:
        """Return the dynamic dimensions of the tensors in *given*, in the same nesting."""
        if not isinstance(given, Tensor):
            return tuple(self.any_size(part) for part in given)
        named = {k: _NAMES[size] for k, size in enumerate(given.shape) if size in _NAMES}
        return {k: Dim(name, min=self._least(name), max=SIZES[name][1]) for k, name in named.items()}

    def _least(self, name: str) -> int:
        return self.least_agents if name == "A" else 1


def _tensor(shape: Sequence[int | str], kind: torch.dtype) -> Tensor:
    sizes = [SIZES[n][0] if isinstance(n, str) else n for n in shape]
    return torch.arange(sizes[0]) if shape == ("R",) and kind == torch.long else torch.ones(sizes, dtype=kind)


def step_example(options: ModelOptions) -> Example:
    """Return arguments of :class:`StepOnTensors`."""
    lanes = MAP_PIECES[options.map_view][0]
    motion, everybody = ([("B", name, 2), ("B", name), ("B", name)] for name in ("R", "A"))
    held: list[tuple[int | str, ...]] = [(options.decoder_layers, "B", "A", options.message), *_AROUND]
    kinds = {1 + k: kind for k, kind in _AROUND_KINDS.items()}
    if options.decoder == "closed-loop":
        held += [("B", "R", lanes, PIECE_POINTS, 2), ("B", "R", lanes, PIECE_FEATURES), ("B", "R", lanes)]
        held += [("B", "R", "S"), ("B", "R", "S", 7), ("B", "R", 3, "S"), ("B", "R", 3, "S")]
        kinds |= {10: torch.bool, 11: torch.bool}
    free = [("B", "R", options.hidden), ("B", "R", options.latent), *motion, *everybody]
    return Example(free, held, least_agents(options), kinds)


def prediction_example(options: ModelOptions, shape: tuple[int, int]) -> Example:
    """Return arguments of :class:`PredictionOnTensors`."""
    given = [("B", "A", *size) for size in (shape, (options.hidden,), (shape[1],), (options.message,))]
    edges = (options.denoiser_layers, "B", "A", "A", options.message)
    held = [*given[1:], edges, ("B", "A")]
    return Example([given[0], ("B", STEP_WIDTH)], held, kinds={4: torch.bool})


def reward_example(options: ModelOptions) -> Example:
    """Return arguments of :class:`RewardOnTensors`."""
    edges = [("B", "A", "A", options.message)] * options.interaction_layers
    held = [("B", "A", options.reward_hidden), ("B", "A"), ("B",), *edges]
    return Example([("B", "A", options.latent)], held, kinds={1: torch.bool, 2: torch.long})


def costs_example() -> Example:
    """Return arguments of :class:`CostsOnTensors`."""
    free = [("B", "R", "T", 2), ("B", "R", "T"), ("B", "R", "T")]
    held = [(len(COSTS),), *_placed("T")]
    return Example(free, held, kinds=dict.fromkeys((2, 8, 9), torch.bool))


def attack_example(options: ModelOptions, steps: int) -> Example:
    """Return arguments of :class:`AttackOnTensors`."""
    codec, prior = [(options.latent,)] * 2, [("R", options.latent)] * 2
    said = (steps, options.decoder_layers, "A", options.message)
    seen = [("R",), ("A",), ("R",), (*said[:2], "R", *said[2:]), said]
    held = [(len(COSTS),), *codec, *prior, ("R", options.hidden), *seen, *_placed(steps)]
    kinds = {6: torch.long} | dict.fromkeys((7, 8, 12, 18, 19), torch.bool)
    return Example([("B", "R", options.latent)], held, kinds=kinds)


def _placed(steps: int | str) -> list[tuple[int | str, ...]]:
    """Return the shapes of the tensors of an ``AttackStates``."""
    everybody = [("A", 2), ("A",), ("A", steps, 2), ("A", steps), ("A", steps)]
    edges = [(1, "R", "S"), (1, "R", "S", 7), (1, "R", 3, "S"), (1, "R", 3, "S")]
    return [*everybody, ("R", 2), ("R", 4), ("R",), *edges]


class Slope(nn.Module):
    """The traced vector-Jacobian product of *network*.

    Args:
        network: a function (free, held) → results of tensors.
        free: example of the arguments with gradients.
        held: example of the other arguments.
        by: example of the gradients with respect to the results.
    """

    def __init__(self, network: nn.Module, free: Any, held: Any, by: Any) -> None:
        super().__init__()
        for name, part in network.named_children():  # so that weights have the same names as in the network
            self.add_module(name, part)
        self._weights = [name for name, _ in network.named_parameters()]

        def slope(weights: Any, free: Any, held: Any, by: Any) -> list[Tensor]:
            leaves = [value.detach().requires_grad_() for value in free]
            with torch.enable_grad():
                results = functional_call(network, weights, (leaves, held))
                gradients = torch.autograd.grad(results, leaves, by, materialize_grads=True)
            return [gradient.contiguous() for gradient in gradients]

        weights = dict(network.named_parameters())
        self.traced = make_fx(slope, tracing_mode="symbolic", _allow_non_fake_inputs=True)(
            weights, free, held, by
        )

    def forward(self, free: Any, held: Any, by: Any) -> list[Tensor]:
        """Return the gradients with respect to *free*, given those with respect to the results, *by*."""
        weights = {name: self.get_parameter(name) for name in self._weights}
        gradients: list[Tensor] = self.traced(weights, free, held, by)
        return gradients


@contextmanager
def anonymous_compiler() -> Iterator[None]:
    """Let g++ omit symbols and folder names of this machine; a wrapper script, since PyTorch accepts no flags."""
    folders = {
        Path(torch.__file__).parent: "torch",
        cache_dir(): "step",
    }
    maps = " ".join(f"-ffile-prefix-map={folder}={name}" for folder, name in folders.items())
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "g++"
        script.write_text(f'#!/bin/sh\nexec /usr/bin/env g++ {maps} -s "$@"\n')
        script.chmod(0o755)
        with torch._inductor.config.patch({"cpp.cxx": (None, str(script))}):
            yield


def slim(package: Path, fitting: Fitting) -> None:
    """Rewrite *package* compressed, without sources, with a fixed date, and with *fitting* in its metadata."""
    with zipfile.ZipFile(package) as archive:
        sources = (".cpp", ".kernel_metadata.json")
        contents = {name: archive.read(name) for name in archive.namelist() if not name.endswith(sources)}
    (metadata,) = (name for name in contents if name.endswith("metadata.json"))
    fields = {**json.loads(contents[metadata]), FITTING: json.dumps(asdict(fitting))}
    contents[metadata] = json.dumps(fields).encode()
    with zipfile.ZipFile(package, "w") as archive:
        for name, content in contents.items():
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED, compresslevel=9)


def build(network: nn.Module, example: Example, package: Path, slope: bool = True) -> None:
    """Compile *network*, a function (free, held) → results of tensors, and with *slope* its gradient, too."""
    numbered(network)
    _compile(network, example, example.tensors(), package)
    if slope:
        build_slope(network, example, slope_of(package))


def build_slope(network: nn.Module, example: Example, package: Path) -> None:
    """Compile the gradient of *network*."""
    numbered(network)
    with torch.no_grad():
        given = example.tensors()
        by = tuple(torch.ones_like(result) for result in network(*given))
        _compile(Slope(network, *given, by), example, (*given, by), package)


def numbered(network: _Network) -> _Network:
    """Return *network* in evaluation mode with a different value in each weight.

    The real weights are set when the code is loaded. Equal ones would be merged by the compiler.
    """
    network.eval().requires_grad_(False)
    for number, weight in enumerate(network.parameters()):
        weight.fill_(number)
    return network


def _compile(network: nn.Module, example: Example, given: Any, package: Path) -> None:
    with torch.no_grad(), anonymous_compiler():
        program = export(network, given, dynamic_shapes=example.any_size(given), strict=False)
        torch._inductor.aoti_compile_and_package(
            program, package_path=str(package), inductor_configs=_INDUCTOR
        )
    slim(package, example.fitting(given))
    print(package)


def build_all(bundle: Bundle) -> None:
    """Compile all functions of the networks of *bundle*."""
    options, denoiser, decoder = bundle.options.model, bundle.denoiser, bundle.traffic.decoder
    prediction = PredictionOnTensors(Denoiser(options, denoiser.shape))
    example = prediction_example(options, denoiser.shape)
    build(prediction, example, denoiser_package(options, denoiser.shape), slope=False)
    build(StepOnTensors(decoder), step_example(options), step_package(options))
    if not isinstance(bundle.codec, LatentCodec):
        return  # these networks are not guided
    build(RewardOnTensors(bundle.reward), reward_example(options), reward_package(options))
    if options.decoder == "open":
        for steps in (NEAR_STEPS, HORIZON_STEPS):
            build_slope(
                AttackOnTensors(decoder, steps),
                attack_example(options, steps),
                attack_package(options, steps),
            )


def main() -> None:
    """Compile, and print the path of each file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("weights", nargs="*", default=WEIGHTS, metavar="NAME")
    for name in parser.parse_args().weights:
        build_all(load_bundle(find_weights(name)))
    build(CostsOnTensors(), costs_example(), costs_package())


if __name__ == "__main__":
    main()
