"""Machine code of networks' methods and of their gradients, compiled by AOTInductor without weights.

``tools/build_machine_code.py`` compiles it for the sizes of the shipped weights, one PyTorch version, and x86-64 with
AVX2. Otherwise the networks themselves run, in two to three times the time. The code does not check the shapes of its
arguments: each package states which it supports, and all others are passed to the network.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import platform
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

_LOG = logging.getLogger(__name__)
_FOLDER = Path(__file__).resolve().parent.parent / "weights"
_CAPABLE = ("AVX2", "AVX512")
FITTING = "ADVDIFF_FITTING"
"""Key of a package's metadata that states which arguments it supports."""


def package_for(name: str, sizes: Any) -> Path:
    """Return the path of machine code *name* for networks of *sizes* and this PyTorch, which may not exist."""
    version = torch.__version__.split("+")[0]
    digest = hashlib.sha256(json.dumps([version, sizes], sort_keys=True).encode()).hexdigest()[:8]
    system = f"{platform.system()}-{platform.machine()}".lower()
    return _FOLDER / f"{name}-{digest}-{system}.pt2"


def slope_of(package: Path) -> Path:
    """Return the path of the gradient of the function in *package*, which may not exist."""
    return package.with_suffix(".slope.pt2")


def runs_here(package: Path) -> bool:
    """Return whether *package* exists and this processor can run it."""
    return package.exists() and torch.backends.cpu.get_cpu_capability() in _CAPABLE


class MachineCode:
    """A compiled function (free, held) → results of tensors, with the weights of one network.

    If its gradient is compiled, too, gradients flow to *free*, as vector-Jacobian products, which compute the function
    anew.

    Args:
        package: of :func:`package_for`.
        network: the same function in PyTorch, with the weights; called for arguments that the code does not support.

    Attributes:
        package, network: the arguments.
        fitting: which arguments are supported.

    Raises:
        RuntimeError: it cannot be loaded.
    """

    def __init__(self, package: Path, network: nn.Module) -> None:
        weights, slope = network.state_dict(), slope_of(package)
        self.package, self.network, self._value = package, network, _loaded(package, weights)
        self._slope = _loaded(slope, weights) if slope.exists() else None
        self.fitting = Fitting(**json.loads(self._value.get_metadata()[FITTING]))

    def __call__(
        self, free: Sequence[Tensor], held: Sequence[Tensor], fits: bool | None = None
    ) -> Sequence[Tensor]:
        """Return the results for the arguments *free*, which gradients flow to, and *held*.

        *fits*: whether they are supported; None: :attr:`fitting` is asked.
        """
        sloped = torch.is_grad_enabled() and any(value.requires_grad for value in free)
        fits = self.fitting.holds([*free, *held]) if fits is None else fits
        if not fits or (sloped and self._slope is None):
            plain: Sequence[Tensor] = self.network(free, held)
            return plain
        if sloped:
            results: tuple[Tensor, ...] = _Function.apply(self, len(free), *free, *held)  # type: ignore[no-untyped-call] # PyTorch's
            return results
        return self.value([*free, *held])

    def value(self, inputs: Sequence[Tensor]) -> list[Tensor]:
        """Return the results for supported arguments *inputs*, without gradients."""
        results: list[Tensor] = self._value.boxed_run([value.contiguous() for value in inputs])
        return results

    def slope(self, inputs: Sequence[Tensor]) -> list[Tensor]:
        """Return the gradients of the free arguments; *inputs* are all arguments, then gradients of the results."""
        assert self._slope is not None  # noqa: S101 - __call__ asks for none where there is none
        results: list[Tensor] = self._slope.boxed_run([value.contiguous() for value in inputs])
        return results


@dataclass(frozen=True)
class Fitting:
    """The arguments that machine code supports.

    Attributes:
        arguments: dtype of each, as PyTorch writes it, and its shape: numbers, or names of sizes.
        sizes: name of a size → its least and greatest value.
    """

    arguments: Sequence[tuple[str, Sequence[int | str]]]
    sizes: Mapping[str, tuple[int, int]]

    def holds(self, inputs: Sequence[Tensor]) -> bool:
        """Return whether the arguments *inputs* are supported."""
        named_sizes: dict[str, int] = {}
        for (kind, sizes), value in zip(self.arguments, inputs, strict=True):
            if str(value.dtype) != kind or value.device.type != "cpu" or value.dim() != len(sizes):
                return False
            for size, number in zip(sizes, value.shape, strict=True):
                if number != (size if isinstance(size, int) else named_sizes.setdefault(size, number)):
                    return False
        return all(self.sizes[name][0] <= size <= self.sizes[name][1] for name, size in named_sizes.items())


class _Function(torch.autograd.Function):
    """Machine code as a function of autograd."""

    @staticmethod
    def forward(ctx: Any, code: MachineCode, count: int, *inputs: Tensor) -> tuple[Tensor, ...]:
        ctx.code, ctx.held = code, len(inputs) - count
        ctx.save_for_backward(*inputs)
        return tuple(code.value(inputs))

    @staticmethod
    def backward(ctx: Any, *by: Tensor) -> tuple[Tensor | None, ...]:
        return (None, None, *ctx.code.slope([*ctx.saved_tensors, *by]), *(None,) * ctx.held)


def machine_code(package: Path, network: nn.Module) -> MachineCode | None:
    """Return the code of *package*, compiled from *network*, with its weights; None if it cannot run here."""
    weights = network.state_dict().values()
    fits = all(weight.device.type == "cpu" and weight.dtype == torch.float32 for weight in weights)
    if not (fits and runs_here(package)):
        return None
    try:
        return MachineCode(package, network)
    # packages are unpacked into the folder of temporary files, which may forbid execution
    except RuntimeError as error:
        _LOG.warning("machine code cannot be loaded, planning takes twice as long: %s", error)
        return None


def _loaded(package: Path, weights: Mapping[str, Tensor]) -> Any:
    with _own_folder():
        loader = torch._C._aoti.AOTIModelPackageLoader(str(package), "model", True, 1, -1)
    needed = set(loader.get_constant_fqns())
    own = {name: value for name, value in weights.items() if name in needed}
    if own:
        loader.load_constants(own, False, False, False, False)
    return loader


@contextmanager
def _own_folder() -> Iterator[None]:
    """Unpack packages into a temporary folder that is removed once they are loaded.

    PyTorch removes its own only at a normal end of the process: killed processes and workers would leave 9 MB behind.
    """
    before = os.environ.get("TMPDIR")
    with tempfile.TemporaryDirectory(prefix="advdiff-", ignore_cleanup_errors=True) as folder:
        os.environ["TMPDIR"] = folder
        try:
            yield
        finally:
            if before is None:
                del os.environ["TMPDIR"]
            else:
                os.environ["TMPDIR"] = before
