"""Array types for signatures, and small helpers for arrays: division, stretches of a mask, read-only arrays."""

from __future__ import annotations

from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]
IntArray: TypeAlias = NDArray[np.int64]
_Array = TypeVar("_Array", bound=NDArray[np.generic])


def quotient(value: FloatArray, rate: FloatArray) -> FloatArray:
    """Return *value* / *rate* where the rate is above 0, and inf elsewhere; an overflow also gives inf."""
    positive = rate > 0.0
    with np.errstate(over="ignore"):
        return np.asarray(np.where(positive, value / np.where(positive, rate, 1.0), np.inf))


def stretches(mask: BoolArray) -> list[tuple[int, int]]:
    """Return (start, stop) of each unbroken run of True in *mask* (T,), *stop* exclusive."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return [(start, stop) for start, stop in edges.reshape(-1, 2).tolist()]


def read_only(array: _Array) -> _Array:
    """Return *array* itself, made read-only because it is shared."""
    array.setflags(write=False)
    return array
