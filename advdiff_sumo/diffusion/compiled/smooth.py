"""Exponentials and what is made of them, written so that the compiler takes many numbers at once.

In single precision they are polynomials, exact to about one unit in the last place (of 1, for tanh); in other
precisions they are the library's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

_HOW: Any = {"error_model": "numpy"}
_LOG2_E = np.float32(1.4426950408889634)
_LN2_BEGIN, _LN2_REST = np.float32(0.693359375), np.float32(-2.12194440e-4)  # the first has few digits
_MOST = np.float32(87.0)
_ROUNDS = np.float32(12582912.0)  # 1.5 · 2²³: what is added to it and taken off again is a whole number
_BIAS, _MANTISSA = np.int32(127), np.int32(23)
_ONE, _TWO, _HALF = np.float32(1.0), np.float32(2.0), np.float32(0.5)
_THIRD, _FOURTH, _FIFTH = np.float32(1.0 / 6.0), np.float32(1.0 / 24.0), np.float32(1.0 / 120.0)
_SIXTH, _SEVENTH = np.float32(1.0 / 720.0), np.float32(1.0 / 5040.0)


def exponential(x: float) -> float:
    """Return eˣ; in single precision of x within ±87."""
    return math.exp(x)


def logistic(x: float) -> float:
    """Return 1 / (1 + e⁻ˣ)."""
    return 1.0 / (1.0 + math.exp(-x))


def tangent(x: float) -> float:
    """Return tanh x."""
    return math.tanh(x)


def _single(x: Any) -> Any:
    """Return eˣ = 2ⁿ eʳ with |r| ≤ ½ ln 2, by the series of eʳ."""
    x = x if x > -_MOST else -_MOST
    x = x if x < _MOST else _MOST
    whole = (x * _LOG2_E + _ROUNDS) - _ROUNDS
    r = (x - whole * _LN2_BEGIN) - whole * _LN2_REST
    series = ((_SEVENTH * r + _SIXTH) * r + _FIFTH) * r + _FOURTH
    series = (((series * r + _THIRD) * r + _HALF) * r + _ONE) * r + _ONE
    power = np.int32((np.int32(whole) + _BIAS) << _MANTISSA)  # the bits of 2ⁿ
    return series * power.view(np.float32)


def _single_logistic(x: Any) -> Any:
    return _ONE / (_ONE + exponential(-x))


def _single_tangent(x: Any) -> Any:
    return _ONE - _TWO / (_ONE + exponential(_TWO * x))


def _by_precision(single: Callable[[Any], Any], other: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return which of both numba shall take for a type of number."""

    def chosen(x: Any) -> Callable[[Any], Any]:
        return single if x == types.float32 else other

    return chosen


# numba does not take a function as its own implementation, so the three above stand here once more
def _double(x: Any) -> Any:
    return math.exp(x)


def _double_logistic(x: Any) -> Any:
    return 1.0 / (1.0 + math.exp(-x))


def _double_tangent(x: Any) -> Any:
    return math.tanh(x)


overload(exponential, jit_options=_HOW)(_by_precision(_single, _double))
overload(logistic, jit_options=_HOW)(_by_precision(_single_logistic, _double_logistic))
overload(tangent, jit_options=_HOW)(_by_precision(_single_tangent, _double_tangent))
