"""Array types, so that signatures say what they hold, and what they share: a division, and arrays nobody changes."""

from __future__ import annotations

from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]
IntArray: TypeAlias = NDArray[np.int64]
_Array = TypeVar("_Array", bound=NDArray[np.generic])


def quotient(value: FloatArray, rate: FloatArray) -> FloatArray:
    """Return *value* / *rate* where the rate is above 0 and inf elsewhere; too large for a number is inf, too."""
    some = rate > 0.0
    with np.errstate(over="ignore"):
        return np.asarray(np.where(some, value / np.where(some, rate, 1.0), np.inf))


def stretches(mask: BoolArray) -> list[tuple[int, int]]:
    """Return (start, stop) of each unbroken run of True in *mask* (T,), *stop* exclusive."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return [(start, stop) for start, stop in edges.reshape(-1, 2).tolist()]


def read_only(array: _Array) -> _Array:
    """Return *array* itself, which nobody can write into from now on: many share it."""
    array.setflags(write=False)
    return array
