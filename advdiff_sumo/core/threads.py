"""One thread for everything that plans, so that plans do not depend on how many a machine has.

Sums that several threads share differ in their last digits with the number of threads, and in closed loop everything
after them. One plan is too small to gain from threads; episodes side by side, one a process, use all cores.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController

#: What libraries read when they are loaded: OpenMP (PyTorch), OpenBLAS (numpy, scipy), MKL.
VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
#: Modules that bring libraries with threads of their own.
_THREADED = ("numpy", "scipy.linalg", "torch")


@contextmanager
def one_thread() -> Iterator[None]:
    """Let PyTorch and the linear algebra of numpy and scipy compute on one thread; may be nested, and decorates.

    The numbers of threads of before come back at the end.
    """
    torch = sys.modules.get("torch")  # what is not loaded has no threads, and core does not load it
    before = 1 if torch is None else torch.get_num_threads()
    try:
        with _linear_algebra(tuple(name in sys.modules for name in _THREADED)).limit(limits=1):
            if torch is not None:
                torch.set_num_threads(1)
            yield
    finally:
        if torch is not None:  # last: linear algebra that shares PyTorch's threads takes them along
            torch.set_num_threads(before)


def one_thread_for_good() -> None:
    """Let this process, and those that it starts, compute on one thread from now on.

    For processes that do nothing but plan: what is loaded already is told, what comes later reads it from the
    environment.
    """
    for name in VARIABLES:
        os.environ[name] = "1"
    _linear_algebra(tuple(name in sys.modules for name in _THREADED)).limit(limits=1)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


@cache
def _linear_algebra(loaded: tuple[bool, ...]) -> ThreadpoolController:  # noqa: ARG001 - the key: they bring libraries
    """Return the libraries of linear algebra that are loaded; finding them takes some milliseconds."""
    return ThreadpoolController().select(user_api="blas")
