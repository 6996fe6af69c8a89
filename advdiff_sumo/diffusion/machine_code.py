"""Machine code that AOTInductor makes of networks' own methods, and of their gradients, without their weights.

``tools/build_machine_code.py`` makes it for the sizes of the shipped weights, PyTorch of one version and x86-64 with
AVX2. Without it, and for other sizes, versions and machines, the networks do the same by themselves, in two to three
times the time.
"""

from __future__ import annotations

import hashlib
import json
import logging
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

_LOG = logging.getLogger(__name__)
_FOLDER = Path(__file__).resolve().parent.parent / "weights"
_CAPABLE = ("AVX2", "AVX512")


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
        weights: by the names that the code knows them by; more of them do no harm.

    Attributes:
        has_slope: whether its results have gradients.

    Raises:
        RuntimeError: it cannot be loaded.
    """

    def __init__(self, package: Path, weights: Mapping[str, Tensor]) -> None:
        self.has_slope = slope_of(package).exists()
        self._value = _loaded(package, weights)
        self._slope = _loaded(slope_of(package), weights) if self.has_slope else None

    def __call__(self, free: Sequence[Tensor], held: Sequence[Tensor]) -> Sequence[Tensor]:
        """Return the results for the arguments *free*, which they have gradients to, and *held*."""
        if self._slope is not None and torch.is_grad_enabled() and any(value.requires_grad for value in free):
            results: tuple[Tensor, ...] = _Function.apply(self, len(free), *free, *held)  # type: ignore[no-untyped-call] # PyTorch's
            return results
        return self.value([*free, *held])

    def value(self, given: Sequence[Tensor]) -> list[Tensor]:
        """Return the results for all arguments, without gradients."""
        results: list[Tensor] = self._value.boxed_run([value.contiguous() for value in given])
        return results

    def slope(self, given: Sequence[Tensor]) -> list[Tensor]:
        """Return the gradients of what is free, for all arguments followed by gradients of the results."""
        assert self._slope is not None  # noqa: S101 - __call__ asks for none where there is none
        results: list[Tensor] = self._slope.boxed_run([value.contiguous() for value in given])
        return results


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


def machine_code(package: Path, name: str, network: nn.Module) -> MachineCode | None:
    """Return the code of *package* with the weights of *network*, or None where there is none that runs here.

    Args:
        package: of :func:`package_for`.
        name: what the code calls the network.
        network: whose weights it is given.
    """
    weights = {f"{name}.{key}": value for key, value in network.state_dict().items()}
    fits = all(value.device.type == "cpu" and value.dtype == torch.float32 for value in weights.values())
    if not (fits and runs_here(package)):
        return None
    try:
        return MachineCode(package, weights)
    except (
        RuntimeError
    ) as error:  # it is unpacked to the folder of temporary files, which may refuse to hold code
        _LOG.warning("machine code cannot be loaded, planning takes twice as long: %s", error)
        return None


def _loaded(package: Path, weights: Mapping[str, Tensor]) -> Any:
    loader = torch._C._aoti.AOTIModelPackageLoader(str(package), "model", True, 1, -1)
    needed = set(loader.get_constant_fqns())
    own = {name: value for name, value in weights.items() if name in needed}
    if own:
        loader.load_constants(own, False, False, False, False)
    return loader
