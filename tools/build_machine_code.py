"""Make the machine code of the networks that ships with the package.

    python tools/build_machine_code.py [NAME ...]

AOTInductor compiles ``Denoiser.predict`` and, for a closed-loop decoder, ``ClosedLoopDecoder.step`` for the sizes of
the shipped weights NAME (all), this version of PyTorch, and any x86-64 machine with AVX2. Needs g++ and two minutes
each. Run it after a change to these networks (``tests/diffusion`` says when), to the sizes of the shipped weights, and
of PyTorch. The files hold what running needs: no weights, sources or symbols, and no folders of the machine that made
them.
"""

from __future__ import annotations

import os

os.environ["TORCHINDUCTOR_CPP_MARCH"] = "x86-64-v3"  # PyTorch reads it when it is imported

import argparse
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import torch
import torch._inductor.config
from torch import Tensor, nn
from torch._inductor.runtime.cache_dir_utils import cache_dir
from torch.export import Dim, export

from advdiff_sumo.core.map_view import MAP_PIECES
from advdiff_sumo.diffusion.exported_step import StepOnTensors, least_agents, step_package
from advdiff_sumo.diffusion.fast_denoiser import PredictionOnTensors, denoiser_package
from advdiff_sumo.models.bundle import load_bundle
from advdiff_sumo.models.closed_loop_decoder import ClosedLoopDecoder
from advdiff_sumo.models.denoiser import STEP_WIDTH, Denoiser
from advdiff_sumo.models.model_options import PIECE_FEATURES, PIECE_POINTS, ModelOptions
from advdiff_sumo.models.shipped_weights import find_weights

_INDUCTOR = {
    "cpp.threads": 1,
    "cpp.simdlen": 256,
    "always_keep_tensor_constants": True,
    "joint_graph_constant_folding": False,  # it writes a bias of one number into the code
}
_Network = TypeVar("_Network", bound=nn.Module)
_MOST = {"B": 4096, "R": 1024, "A": 1024, "S": 4096}


WEIGHTS = ("closed-loop", "traffic", "traj2traj")


def step_arguments(options: ModelOptions) -> tuple[Any, Any]:
    """Return arguments of :class:`StepOnTensors` and which of their dimensions may be of any size.

    B scenes, R rows, A agents, S segments of the road's edge.
    """
    sizes = {"B": 5, "R": 11, "A": least_agents(options) + 6, "S": 23}
    least = {"B": 1, "R": 1, "A": least_agents(options), "S": 1}
    free = {name: Dim(name, min=least[name], max=most) for name, most in _MOST.items()}
    dynamic: list[dict[int, Any]] = []

    def tensor(*shape: str | int, kind: torch.dtype = torch.float32) -> Tensor:
        dynamic.append({k: free[name] for k, name in enumerate(shape) if isinstance(name, str)})
        return torch.ones([sizes[n] if isinstance(n, str) else n for n in shape], dtype=kind)

    lanes = MAP_PIECES[options.map_view][0]
    memory, z = tensor("B", "R", options.hidden), tensor("B", "R", options.latent)
    motion = tensor("B", "R", 2), tensor("B", "R"), tensor("B", "R")
    everybody = tensor("B", "A", 2), tensor("B", "A"), tensor("B", "A")
    others = tensor(options.decoder_layers, "B", "A", options.message)
    rows = torch.arange(sizes["R"])
    dynamic.append({0: free["R"]})
    around = (
        rows,
        *(tensor("B", "R", 4), tensor("B", "R", 2)),
        *(tensor("B", "R", kind=torch.bool) for _ in range(2)),
        *(tensor("B", "A", 2), tensor("B", "A", kind=torch.bool)),
        *(tensor("B", "R", lanes, PIECE_POINTS, 2), tensor("B", "R", lanes, PIECE_FEATURES)),
        *(tensor("B", "R", lanes, kind=torch.bool), tensor("B", "R", "S", kind=torch.bool)),
        *(tensor("B", "R", "S", 7), tensor("B", "R", 3, "S"), tensor("B", "R", 3, "S")),
    )
    return (memory, z, motion, everybody, others, around), dynamic


def prediction_arguments(options: ModelOptions, shape: tuple[int, int]) -> tuple[Any, Any]:
    """Return arguments of :class:`PredictionOnTensors` and which of their dimensions may be of any size."""
    scenes, agents, layers = 3, 7, options.denoiser_layers
    some, many = Dim("B", min=1, max=_MOST["B"]), Dim("A", min=1, max=_MOST["A"])
    by_agent = {0: some, 1: many}
    sizes = (shape, (options.hidden,), (shape[1],), (options.message,))
    x, h, condition, known = (torch.ones(scenes, agents, *size) for size in sizes)
    edges = torch.ones(layers, scenes, agents, agents, options.message)
    drawn = torch.ones(scenes, agents, dtype=torch.bool)
    given = (h, condition, known, edges, drawn)
    free = (by_agent, by_agent, by_agent, {1: some, 2: many, 3: many}, by_agent)
    return (x, torch.ones(scenes, STEP_WIDTH), given), (by_agent, {0: some}, free)


@contextmanager
def anonymous_compiler() -> Iterator[None]:
    """Let g++ leave out symbols and write no folder of this machine into the code (PyTorch takes no flags)."""
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


def slim(package: Path) -> None:
    """Write *package* again: packed, without the sources that nobody reads, with the date of nobody's day."""
    with zipfile.ZipFile(package) as archive:
        sources = (".cpp", ".kernel_metadata.json")
        kept = {name: archive.read(name) for name in archive.namelist() if not name.endswith(sources)}
    with zipfile.ZipFile(package, "w") as archive:
        for name, content in kept.items():
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED, compresslevel=9)


def compile_step(options: ModelOptions) -> Path:
    """Compile the step of a closed-loop decoder of *options* and return where it is."""
    given, dynamic = step_arguments(options)
    free = (*dynamic[:2], tuple(dynamic[2:5]), tuple(dynamic[5:8]), dynamic[8], tuple(dynamic[9:]))
    return _compiled(StepOnTensors(_numbered(ClosedLoopDecoder(options))), given, free, step_package(options))


def compile_prediction(options: ModelOptions, shape: tuple[int, int]) -> Path:
    """Compile the prediction of a denoiser and return where it is."""
    net = PredictionOnTensors(_numbered(Denoiser(options, shape)))
    return _compiled(net, *prediction_arguments(options, shape), denoiser_package(options, shape))


def _numbered(network: _Network) -> _Network:
    """Return *network* with weights that all differ: they are given when it is loaded; equal ones would become one."""
    network.eval().requires_grad_(False)
    for number, weight in enumerate(network.parameters()):
        weight.fill_(number)
    return network


def _compiled(network: nn.Module, given: Any, free: Any, package: Path) -> Path:
    with torch.no_grad(), anonymous_compiler():
        program = export(network, given, dynamic_shapes=free, strict=False)
        path = torch._inductor.aoti_compile_and_package(
            program, package_path=str(package), inductor_configs=_INDUCTOR
        )
    slim(Path(path))
    return Path(path)


def main() -> None:
    """Compile and say what is where."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("weights", nargs="*", default=WEIGHTS, metavar="NAME")
    for name in parser.parse_args().weights:
        bundle = load_bundle(find_weights(name))
        print(compile_prediction(bundle.options.model, bundle.denoiser.shape))
        if isinstance(bundle.traffic.decoder, ClosedLoopDecoder):
            print(compile_step(bundle.options.model))


if __name__ == "__main__":
    main()
