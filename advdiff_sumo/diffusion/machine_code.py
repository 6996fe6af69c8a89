"""Machine code that AOTInductor makes of networks' own methods, and of their gradients, without their weights.

``tools/build_machine_code.py`` makes it for the sizes of the shipped weights, PyTorch of one version and x86-64 with
AVX2. Without it, and for other sizes, versions and machines, the networks do the same by themselves, in two to three
times the time. The code itself looks at no size of what it is given, and would compute something or other: it comes
with what it is for, and everything else is the network's.
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
"""Name under which a package says what it is for."""


def package_for(name: str, sizes: Any) -> Path:
    """Return where the machine code of *name*, for networks of *sizes* and this PyTorch, ships, if it does."""
    version = torch.__version__.split("+")[0]
    digest = hashlib.sha256(json.dumps([version, sizes], sort_keys=True).encode()).hexdigest()[:8]
    system = f"{platform.system()}-{platform.machine()}".lower()
    return _FOLDER / f"{name}-{digest}-{system}.pt2"


def slope_of(package: Path) -> Path:
    """Return where the slope of what *package* computes ships, if it does."""
    return package.with_suffix(".slope.pt2")


def runs_here(package: Path) -> bool:
    """Return whether *package* ships and this processor can run it."""
    return package.exists() and torch.backends.cpu.get_cpu_capability() in _CAPABLE


class MachineCode:
    """A function (free, held) → results of tensors, with the weights of one network.

    Where its slope ships, too, gradients flow to *free*: autograd's product of a vector and the Jacobian, which works
    out the function anew.

    Args:
        package: of :func:`package_for`.
        network: the function itself, with the weights; it serves arguments that the code is not for.

    Attributes:
        package, network: the same.
        fitting: what it is for.

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
        """Return the results for the arguments *free*, which they have gradients to, and *held*.

        *fits* is what :attr:`fitting` says of them, where that is known.
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

    def value(self, given: Sequence[Tensor]) -> list[Tensor]:
        """Return the results for all arguments, which have to fit, without gradients."""
        results: list[Tensor] = self._value.boxed_run([value.contiguous() for value in given])
        return results

    def slope(self, given: Sequence[Tensor]) -> list[Tensor]:
        """Return the gradients of what is free, for all arguments followed by gradients of the results."""
        assert self._slope is not None  # noqa: S101 - __call__ asks for none where there is none
        results: list[Tensor] = self._slope.boxed_run([value.contiguous() for value in given])
        return results


@dataclass(frozen=True)
class Fitting:
    """What machine code is for.

    Attributes:
        arguments: kind of each, as PyTorch writes it, and its sizes: numbers, or names, which mean one number each.
        sizes: the least and the most that each name may mean.
    """

    arguments: Sequence[tuple[str, Sequence[int | str]]]
    sizes: Mapping[str, tuple[int, int]]

    def holds(self, given: Sequence[Tensor]) -> bool:
        """Return whether the arguments *given* are such."""
        found: dict[str, int] = {}
        for (kind, sizes), value in zip(self.arguments, given, strict=True):
            if str(value.dtype) != kind or value.device.type != "cpu" or value.dim() != len(sizes):
                return False
            for size, number in zip(sizes, value.shape, strict=True):
                if number != (size if isinstance(size, int) else found.setdefault(size, number)):
                    return False
        return all(self.sizes[name][0] <= size <= self.sizes[name][1] for name, size in found.items())


class _Function(torch.autograd.Function):
    """Autograd's view of machine code."""

    @staticmethod
    def forward(ctx: Any, code: MachineCode, count: int, *given: Tensor) -> tuple[Tensor, ...]:
        ctx.code, ctx.held = code, len(given) - count
        ctx.save_for_backward(*given)
        return tuple(code.value(given))

    @staticmethod
    def backward(ctx: Any, *by: Tensor) -> tuple[Tensor | None, ...]:
        return (None, None, *ctx.code.slope([*ctx.saved_tensors, *by]), *(None,) * ctx.held)


def machine_code(package: Path, network: nn.Module) -> MachineCode | None:
    """Return the code of *package* with the weights of *network*, which it is made of; None where none runs here."""
    weights = network.state_dict().values()
    fits = all(weight.device.type == "cpu" and weight.dtype == torch.float32 for weight in weights)
    if not (fits and runs_here(package)):
        return None
    try:
        return MachineCode(package, network)
    # the folder of temporary files, where it is unpacked, may refuse to hold code
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
    """Let a package be unpacked where it is removed as soon as it is loaded; PyTorch would only at a process's end.

    A process that is killed, or that ends without taking objects down, as workers do, would leave 9 MB behind.
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
