"""Dubins paths of the nuScenes map expansion → polylines, by exact integration."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray

TURN = {"L": 1.0, "S": 0.0, "R": -1.0}
SAGITTA_M = 0.002  # how far a chord may lie off its arc
POINT_GAP_M = 0.001  # nearer points are one


def sample_path(pieces: Sequence[Mapping[str, Any]], sagitta_m: float = SAGITTA_M) -> FloatArray:
    """Return the polyline (N, 2) of a chain of Dubins pieces; every point lies exactly on the path.

    Args:
        pieces: records with ``start_pose`` [x, y, yaw], ``shape`` (three of L, S, R), ``radius`` in m and
            ``segment_length`` (three arc lengths in m).
        sagitta_m: largest distance between a chord and its arc.

    Raises:
        ValueError: no pieces, a field missing or malformed, or a number that is not finite.
    """
    if not pieces:
        raise ValueError("the path has no pieces")
    points: list[tuple[float, float]] = []
    for piece in pieces:
        points += _piece(piece, sagitta_m)
    last = pieces[-1].get("end_pose")
    if last is not None:
        try:
            points.append((float(last[0]), float(last[1])))
        except (TypeError, LookupError, ValueError):
            raise ValueError("malformed end_pose of an arc-line piece") from None
    line = np.array(points, dtype=np.float64)
    if not np.isfinite(line).all():
        raise ValueError("a coordinate is not finite")
    return drop_repeats(line)


def _piece(piece: Mapping[str, Any], sagitta_m: float) -> list[tuple[float, float]]:
    try:
        x, y, yaw = (float(v) for v in piece["start_pose"])
        radius = float(piece["radius"])
        lengths = [float(v) for v in piece["segment_length"]]
        turns = [TURN[letter] for letter in piece["shape"]]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"malformed arc-line piece ({error})") from None
    if not all(map(math.isfinite, (x, y, yaw, *lengths))):
        raise ValueError("a number of an arc-line piece is not finite")
    if len(turns) != 3 or len(lengths) != 3 or min(lengths) < 0 or (any(turns) and not radius > 0):
        raise ValueError("malformed arc-line piece (three segments and a positive radius are needed)")
    points = [(x, y)]
    for turn, length in zip(turns, lengths, strict=True):
        if length > 0:
            arc = _segment(points[-1], yaw, turn / radius if turn else 0.0, length, sagitta_m)
            points += arc
            yaw += turn * length / radius
    return points


def _segment(
    start: tuple[float, float], yaw: float, curvature: float, length: float, sagitta_m: float
) -> list[tuple[float, float]]:
    """Return the points after *start* along a straight line or an arc of constant curvature."""
    x, y = start
    if curvature == 0.0:
        return [(x + length * math.cos(yaw), y + length * math.sin(yaw))]
    radius = 1.0 / abs(curvature)
    chord_angle = 2.0 * math.acos(max(1.0 - sagitta_m / radius, 0.0))
    count = max(1, math.ceil(length * abs(curvature) / chord_angle))
    angles = yaw + curvature * length * np.arange(1, count + 1) / count
    xs = x + (np.sin(angles) - math.sin(yaw)) / curvature
    ys = y - (np.cos(angles) - math.cos(yaw)) / curvature
    return list(zip(xs.tolist(), ys.tolist(), strict=True))


def drop_repeats(line: FloatArray, gap_m: float = POINT_GAP_M) -> FloatArray:
    """Return *line* (N, 2) without points nearer than *gap_m* to the one kept before; both ends stay."""
    kept = [0]
    for index in range(1, len(line)):
        if math.dist(line[index], line[kept[-1]]) >= gap_m:
            kept.append(index)
    if kept[-1] != len(line) - 1 and len(kept) > 1:
        kept[-1] = len(line) - 1
    return line[kept]
