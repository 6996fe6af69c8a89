"""How loops are compiled, and the small ones that all others are made of.

A kernel takes C-contiguous arrays of one precision, writes into arrays that it is given, and is kept on disk once it
is compiled. Sums run in the order in which they are written, but for those of a few small kernels, which the compiler
may run in several lanes; in either case results are the same in every process.

Who changes a kernel runs ``python tools/build_kernels.py`` afterwards, which makes the code that ships
(``kernel_cache``).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from advdiff_sumo.diffusion.compiled.kernel_cache import KernelCache, aim_at_level

Array: TypeAlias = NDArray[np.floating[Any]]
_HOW: dict[str, Any] = {"fastmath": False, "nogil": True, "error_model": "numpy"}
_Function = TypeVar("_Function", bound=Callable[..., Any])
aim_at_level()


def kernel(function: _Function) -> _Function:
    """Return *function* compiled when it is first called; kept on disk where there is a place for it."""
    return _compiled(function, _HOW)


def sums(function: _Function) -> _Function:
    """Return *function* compiled as a kernel whose sums may run in several lanes."""
    return _compiled(function, {**_HOW, "fastmath": {"reassoc", "nsz"}})


def extremes(function: _Function) -> _Function:
    """Return *function*, which finds extremes of numbers that are none of them NaN, compiled as a kernel."""
    return _compiled(function, {**_HOW, "fastmath": {"nnan", "nsz"}})


def _compiled(function: _Function, how: dict[str, Any]) -> _Function:
    dispatcher = njit(**how)(function)
    dispatcher._cache = KernelCache(dispatcher.py_func, how)
    return cast("_Function", dispatcher)


def array_of(tensor: Tensor) -> Array:
    """Return *tensor*'s numbers as kernels read them, without a copy where they lie so already."""
    numbers: Array = np.ascontiguousarray(tensor.detach().numpy())
    return numbers


@kernel
def product(a: Array, w: Array, out: Array) -> None:
    """Add *a* (G, K) times *w* (K, N) to *out* (G, N); eight rows of *w* at a time, so that they stay near."""
    rows, depth = a.shape
    wide = w.shape[1]
    even = depth - depth % 8
    for k in range(0, even, 8):
        w0, w1, w2, w3 = w[k], w[k + 1], w[k + 2], w[k + 3]
        w4, w5, w6, w7 = w[k + 4], w[k + 5], w[k + 6], w[k + 7]
        for i in range(rows):
            to = out[i]
            a0, a1, a2, a3 = a[i, k], a[i, k + 1], a[i, k + 2], a[i, k + 3]
            a4, a5, a6, a7 = a[i, k + 4], a[i, k + 5], a[i, k + 6], a[i, k + 7]
            for j in range(wide):
                to[j] += ((a0 * w0[j] + a1 * w1[j]) + (a2 * w2[j] + a3 * w3[j])) + (
                    (a4 * w4[j] + a5 * w5[j]) + (a6 * w6[j] + a7 * w7[j])
                )
    for k in range(even, depth):
        w0 = w[k]
        for i in range(rows):
            to, a0 = out[i], a[i, k]
            for j in range(wide):
                to[j] += a0 * w0[j]


@kernel
def affine(a: Array, w: Array, bias: Array, out: Array) -> None:
    """Set *out* (G, N) to *a* (G, K) times *w* (K, N) plus *bias* (N,)."""
    for i in range(len(out)):
        to = out[i]
        for j in range(len(bias)):
            to[j] = bias[j]
    product(a, w, out)


@kernel
def relu(x: Array) -> None:
    """Set negative numbers of *x* (G, N) to 0."""
    zero = x.dtype.type(0.0)
    for i in range(len(x)):
        row = x[i]
        for j in range(len(row)):
            row[j] = row[j] if row[j] > zero else zero


@kernel
def keep(grad: Array, x: Array) -> None:
    """Set *grad* (G, N) to 0 where *x*, after its ReLU, is."""
    zero = x.dtype.type(0.0)
    for i in range(len(x)):
        to, row = grad[i], x[i]
        for j in range(len(row)):
            to[j] = to[j] if row[j] > zero else zero


@kernel
def clear(out: Array) -> None:
    """Set all of *out* (G, N) to 0."""
    zero = out.dtype.type(0.0)
    for i in range(len(out)):
        to = out[i]
        for j in range(len(to)):
            to[j] = zero


@kernel
def place(x: Array, begin: int, out: Array, at: int, count: int) -> None:
    """Copy *count* columns of *x* (G, N) from *begin* on into *out* (G, N') from *at* on."""
    for i in range(len(x)):
        row, to = x[i], out[i]
        for j in range(count):
            to[at + j] = row[begin + j]


@sums
def dot(a: Array, b: Array) -> Any:
    """Return the product of *a* (N,) and *b* (N,), of their precision."""
    total = a.dtype.type(0.0)
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@sums
def total(x: Array) -> Any:
    """Return the sum of *x* (N,)."""
    out = x.dtype.type(0.0)
    for i in range(len(x)):
        out += x[i]
    return out


@extremes
def largest(x: Array) -> Any:
    """Return the largest of *x* (N,)."""
    out = x[0]
    for i in range(len(x)):
        out = x[i] if x[i] > out else out
    return out
