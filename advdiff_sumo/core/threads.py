"""Limit all planning to one thread, so that plans do not depend on the number of cores.

The last digits of a sum that several threads compute depend on their number, and in closed loop so does everything that
follows. A single plan is too small to gain from threads. Parallel episodes, one per process, use all cores.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController

#: Environment variables that libraries read when loaded: OpenMP (PyTorch), OpenBLAS (numpy, scipy), MKL.
VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
#: Modules that load multi-threaded libraries.
_THREADED_MODULES = ("numpy", "scipy.linalg", "torch")


@contextmanager
def one_thread() -> Iterator[None]:
    """Make PyTorch and the linear algebra of numpy and scipy compute on one thread.

    Usable as a context manager, also nested, and as a decorator. At the end the previous numbers of threads are
    restored.
    """
    torch = sys.modules.get("torch")  # core does not import PyTorch; if not loaded, it has no threads
    previous_count = 1 if torch is None else torch.get_num_threads()
    try:
        with _linear_algebra(tuple(name in sys.modules for name in _THREADED_MODULES)).limit(limits=1):
            if torch is not None:
                torch.set_num_threads(1)
            yield
    finally:
        if torch is not None:  # last, since restoring linear algebra may change PyTorch's threads, if shared
            torch.set_num_threads(previous_count)


def one_thread_for_good() -> None:
    """Make this process, and those that it starts, compute on one thread from now on.

    For processes that only plan. Libraries that are loaded already are limited now; later ones read the environment.
    """
    for name in VARIABLES:
        os.environ[name] = "1"
    _linear_algebra(tuple(name in sys.modules for name in _THREADED_MODULES)).limit(limits=1)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


@cache
def _linear_algebra(loaded: tuple[bool, ...]) -> ThreadpoolController:  # noqa: ARG001 - the key of the cache
    """Return the loaded libraries of linear algebra; *loaded* says which modules are. A search takes milliseconds."""
    return ThreadpoolController().select(user_api="blas")
