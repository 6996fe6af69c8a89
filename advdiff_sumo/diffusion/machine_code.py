"""Machine code that AOTInductor makes of networks' own methods, without their weights.

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


class MachineCode:
    """A package with the weights of one network.

    Args:
        package: of :func:`package_for`.
        weights: by the names that the code knows them by; more of them do no harm.

    Raises:
        RuntimeError: it cannot be loaded.
    """

    def __init__(self, package: Path, weights: Mapping[str, Tensor]) -> None:
        self._loader = torch._C._aoti.AOTIModelPackageLoader(str(package), "model", True, 1, -1)
        needed = set(self._loader.get_constant_fqns())
        own = {name: value for name, value in weights.items() if name in needed}
        self._loader.load_constants(own, False, False, False, False)

    def __call__(self, given: Sequence[Tensor]) -> list[Tensor]:
        """Return the results for the arguments *given*, without gradients."""
        results: list[Tensor] = self._loader.boxed_run([value.contiguous() for value in given])
        return results


def machine_code(package: Path, name: str, network: nn.Module) -> MachineCode | None:
    """Return the code of *package* with the weights of *network*, or None where there is none that runs here.

    Args:
        package: of :func:`package_for`.
        name: what the code calls the network.
        network: whose weights it is given.
    """
    weights = {f"{name}.{key}": value for key, value in network.state_dict().items()}
    on_cpu = all(value.device.type == "cpu" for value in weights.values())
    if not (on_cpu and package.exists() and torch.backends.cpu.get_cpu_capability() in _CAPABLE):
        return None
    try:
        return MachineCode(package, weights)
    except (
        RuntimeError
    ) as error:  # it is unpacked to the folder of temporary files, which may refuse to hold code
        _LOG.warning("machine code cannot be loaded, planning takes twice as long: %s", error)
        return None
