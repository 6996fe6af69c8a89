"""Checks all that machine code does against the network on the same arguments, as it happens."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest
import torch
from torch import Tensor

from advdiff_sumo.diffusion.machine_code import MachineCode, package_for

FOLDER = package_for("any", {}).parent
TOLERANCE, OF_STEPS = 1e-5, (3e-5, 1e-4)
"""How far a result may be from the network's, as a share of the largest number in it; and of a step and its slope.

Of a step more: places are far from the origin, and slopes are differences of large numbers. In single precision the
network's own are as far (4e-5) from those in double precision.
"""
_FREE = {"decoder-step": 8, "attack-costs": 3, "attack-slope": 1, "reward": 1, "denoiser": 2}
_EVERYBODY = (5, 6, 7)
_Runs = Callable[[MachineCode, Sequence[Tensor]], list[Tensor]]


def _its_machine() -> bool:
    pinned = re.search(r"^torch==([\d.]+)", Path("constraints.txt").read_text(), re.MULTILINE)
    here = torch.__version__.split("+")[0], torch.backends.cpu.get_cpu_capability() in {"AVX2", "AVX512"}
    return pinned is not None and here == (pinned[1], True)


needs_code = pytest.mark.skipif(
    not _its_machine(), reason="the machine code is for the PyTorch of constraints.txt and x86-64 with AVX2"
)


@contextmanager
def checked_against_networks() -> Iterator[dict[str, list[float]]]:
    """Compare each result of machine code with the network's, and say how far each package was from it each time.

    The distance is a share of the largest number in a result; for slopes by where everybody is, which are added to the
    others and cancel for whoever sees nobody but itself, of the largest in all.
    """
    errors: dict[str, list[float]] = {}

    def checked(run: _Runs, sloped: bool) -> _Runs:
        def both(code: MachineCode, given: Sequence[Tensor]) -> list[Tensor]:
            made, (name, tells) = run(code, given), _package(code, sloped)
            count = _FREE[re.sub(r"-\w{8}-.*", "", name)]
            wanted = (_slope if tells else _value)(code, count, [value.detach() for value in given])
            most = max(float(theirs.abs().max()) for theirs in wanted)
            for number, (mine, theirs) in enumerate(zip(made, wanted, strict=True)):
                scale = most if tells and number in _EVERYBODY else max(float(theirs.abs().max()), 1e-6)
                errors.setdefault(name, []).append(float((mine - theirs).abs().max()) / scale)
            return made

        return both

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MachineCode, "value", checked(MachineCode.value, False))
        patch.setattr(MachineCode, "slope", checked(MachineCode.slope, True))
        yield errors


def _package(code: MachineCode, sloped: bool) -> tuple[str, bool]:
    """Return the name of a package, and whether it tells slopes."""
    stem = code.package.stem
    return stem + ".slope" * sloped, sloped or stem.startswith("attack-slope")


@torch.no_grad()
def _value(code: MachineCode, count: int, given: list[Tensor]) -> list[Tensor]:
    return [*code.network(given[:count], given[count:])]


@torch.enable_grad()
def _slope(code: MachineCode, count: int, given: list[Tensor]) -> list[Tensor]:
    free, held = [value.clone().requires_grad_() for value in given[:count]], given[count:]
    results = code.network(free, held[: -_results(code)])
    return [*torch.autograd.grad(results, free, held[-_results(code) :], materialize_grads=True)]


def _results(code: MachineCode) -> int:
    """Return how many results its function has."""
    return 7 if code.package.stem.startswith("decoder-step") else 1


def names() -> set[str]:
    """Return the names of all packages that ship."""
    return {package.stem for package in FOLDER.glob("*.pt2")}


def assert_close(errors: dict[str, list[float]], *names: str) -> None:
    """Check that packages of *names* were used, and none was farther from its network than rounding takes it."""
    assert {name for name in names if not any(used.startswith(name) for used in errors)} == set()
    for name, found in errors.items():
        allowed = OF_STEPS[name.endswith(".slope")] if name.startswith("decoder-step") else TOLERANCE
        assert all(error <= allowed for error in found), (name, max(found))
