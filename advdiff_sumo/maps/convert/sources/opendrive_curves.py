"""Evaluate reference lines and polynomials of OpenDRIVE (ASAM OpenDRIVE 1.8.1, chapters 8 and 9)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from xml.etree.ElementTree import Element

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.sources.arcline import MOST_TURNS

LONGEST_M = 200_000.0  # longest road
LARGEST = 1e8  # largest valid coordinate, length or coefficient
FINE_M = 0.05  # step of the integration of a cubic's arc length
COEFFICIENTS = ("a", "b", "c", "d")
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True)
class Cubic:
    """A cubic polynomial that is valid from arc length *start_m* on; its argument is the distance from there."""

    start_m: float
    coefficients: tuple[float, ...]


def number(row: Element, name: str, default: float | None = None) -> float:
    """Return attribute *name* of *row* as a number.

    Raises:
        ValueError: it is missing and there is no *default*, or it is no number or too large.
    """
    text = row.get(name)
    if text is None and default is not None:
        return default
    try:
        value = float(text or "")
    except ValueError:
        raise ValueError(f"{name} of <{row.tag}> is {text!r}") from None
    if not abs(value) <= LARGEST:
        raise ValueError(f"{name} of <{row.tag}> is {text!r}")
    return value


def cubics(rows: Sequence[Element], start: str = "sOffset", base_m: float = 0.0) -> list[Cubic]:
    """Return the polynomials of *rows*, ordered by beginning: *base_m* plus attribute *start*."""
    parts = [
        Cubic(base_m + number(row, start), tuple(number(row, key, 0.0) for key in COEFFICIENTS))
        for row in rows
    ]
    return sorted(parts, key=lambda part: part.start_m)


def value_at(parts: Sequence[Cubic], s_m: FloatArray) -> FloatArray:
    """Return the values (N,) of piecewise cubics at arc lengths *s_m* (N,); 0 before the first cubic."""
    values = np.zeros(len(s_m))
    for part in parts:
        inside = s_m >= part.start_m - 1e-9
        values[inside] = np.polynomial.polynomial.polyval(s_m[inside] - part.start_m, part.coefficients)
    return values


class ReferenceLine:
    """The reference line of a road in plan view."""

    def __init__(self, rows: Sequence[Element]) -> None:
        """Read the records ``geometry``.

        Raises:
            ValueError: there are none, one is malformed, or the road has no valid length.
        """
        if not rows:
            raise ValueError("it has no geometry")
        self.pieces = sorted(rows, key=lambda row: number(row, "s"))
        self.starts_m = [number(row, "s") for row in self.pieces]
        self.length_m = self.starts_m[-1] + number(self.pieces[-1], "length")
        if not 0.0 < self.length_m <= LONGEST_M:
            raise ValueError(f"it is {self.length_m:.0f} m long")

    def at(self, s_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return points (N, 2) in m and headings (N,) in rad at ascending arc lengths (N,).

        Raises:
            ValueError: a geometry is malformed or of an unknown kind.
        """
        xy, yaw = np.empty((len(s_m), 2)), np.empty(len(s_m))
        ends = [*self.starts_m[1:], math.inf]
        for row, start, end in zip(self.pieces, self.starts_m, ends, strict=True):
            inside = (s_m < end) & ((s_m >= start) | (start == self.starts_m[0]))
            if inside.any():
                xy[inside], yaw[inside] = _piece(row, s_m[inside] - start)
        return xy, yaw


def _piece(row: Element, ds_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return points (N, 2) and headings (N,) on one geometry record, at distances *ds_m* (N,) from its beginning."""
    hdg, length = number(row, "hdg"), number(row, "length")
    shape = next(iter(row), None)
    kind = "" if shape is None else shape.tag
    if shape is None or kind not in ("line", "arc", "spiral", "poly3", "paramPoly3"):
        raise ValueError(f"a geometry is of the unknown kind {kind!r}")
    if kind in ("poly3", "paramPoly3"):
        local, turn = _poly3(shape, ds_m) if kind == "poly3" else _param_poly3(shape, ds_m, length)
    else:
        local, turn = _curve(*_curvatures(shape), length, ds_m)
    cos, sin = math.cos(hdg), math.sin(hdg)
    origin = np.array([number(row, "x"), number(row, "y")])
    return origin + local @ np.array([[cos, sin], [-sin, cos]]), hdg + turn


def _curvatures(shape: Element) -> tuple[float, float]:
    """Return the curvatures in 1/m at beginning and end of a line, arc or spiral."""
    if shape.tag == "spiral":
        return number(shape, "curvStart"), number(shape, "curvEnd")
    curvature = number(shape, "curvature") if shape.tag == "arc" else 0.0
    return curvature, curvature


def _curve(first: float, last: float, length_m: float, ds_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return points and headings on a line, arc or clothoid, by Gauss-Legendre quadrature from point to point."""
    if max(abs(first), abs(last)) * length_m > 2.0 * math.pi * MOST_TURNS:
        raise ValueError("a geometry turns round many times")
    growth = 0.5 * (last - first) / length_m if length_m else 0.0

    def turn(s: FloatArray) -> FloatArray:
        return np.asarray(first * s + growth * s * s)

    stations = np.concatenate(([0.0], ds_m))
    middle, half = 0.5 * (stations[1:] + stations[:-1]), 0.5 * np.diff(stations)
    yaw = turn(middle[:, None] + half[:, None] * _NODES)
    steps = np.stack([(np.cos(yaw) @ _WEIGHTS) * half, (np.sin(yaw) @ _WEIGHTS) * half], axis=-1)
    return np.cumsum(steps, axis=0), turn(ds_m)


def _poly3(shape: Element, ds_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return points and headings on the curve v(u) at arc lengths *ds_m*."""
    across = [number(shape, key) for key in COEFFICIENTS]
    slope = np.polynomial.polynomial.polyder(across)
    u = np.arange(0.0, float(ds_m[-1]) + 2.0 * FINE_M, FINE_M)
    run = np.hypot(1.0, np.polynomial.polynomial.polyval(u, slope))
    lengths = np.concatenate(([0.0], np.cumsum(0.5 * (run[1:] + run[:-1]) * FINE_M)))
    along = np.interp(ds_m, lengths, u)
    v = np.polynomial.polynomial.polyval(along, across)
    yaw = np.arctan(np.polynomial.polynomial.polyval(along, slope))
    return np.stack((along, v), axis=-1), np.asarray(yaw, dtype=np.float64)


def _param_poly3(shape: Element, ds_m: FloatArray, length_m: float) -> tuple[FloatArray, FloatArray]:
    """Return points and headings on the curve (u(p), v(p)); p runs from 0 to 1, or to the length."""
    p = ds_m if shape.get("pRange") == "arcLength" else ds_m / length_m
    along, across = ([number(shape, f"{key}{axis}") for key in COEFFICIENTS] for axis in "UV")
    evaluate, derive = np.polynomial.polynomial.polyval, np.polynomial.polynomial.polyder
    points = np.asarray(np.stack((evaluate(p, along), evaluate(p, across)), axis=-1), dtype=np.float64)
    yaw = np.arctan2(evaluate(p, derive(across)), evaluate(p, derive(along)))
    return points, np.asarray(yaw, dtype=np.float64)


def stations(line: ReferenceLine, from_m: float, to_m: float, step_m: float) -> FloatArray:
    """Return ascending arc lengths from *from_m* to *to_m*, at most *step_m* apart, including beginnings of pieces."""
    marks = [from_m, *(s for s in line.starts_m if from_m < s < to_m), to_m]
    parts = [np.linspace(a, b, max(1, math.ceil((b - a) / step_m)) + 1)[:-1] for a, b in pairwise(marks)]
    return np.concatenate([*parts, [to_m]])
