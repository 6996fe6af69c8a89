"""Array types, so that signatures say what they hold, and a division that they share."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]
IntArray: TypeAlias = NDArray[np.int64]


def quotient(value: FloatArray, rate: FloatArray) -> FloatArray:
    """Return *value* / *rate* where the rate is above 0 and inf elsewhere; too large for a number is inf, too."""
    some = rate > 0.0
    with np.errstate(over="ignore"):
        return np.asarray(np.where(some, value / np.where(some, rate, 1.0), np.inf))
