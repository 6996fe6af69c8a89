"""Turn the Dubins paths of the nuScenes map expansion into polylines, by exact integration."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray

TURN = {"L": 1.0, "S": 0.0, "R": -1.0}  # sign of the curvature
SAGITTA_M = 0.002  # largest distance between an arc and its chords
POINT_GAP_M = 0.001  # points nearer to each other are merged
CHAIN_GAP_M = 1.0  # largest gap between consecutive pieces of a path
END_GAP_M = 0.5  # largest distance between the integrated end and the stated end pose
MOST_TURNS = 50  # a path with more full turns cannot be a lane, and takes long to sample


def sample_path(
    pieces: Sequence[Mapping[str, Any]],
    longest_m: float = math.inf,
    notes: Counter[str] | None = None,
) -> FloatArray:
    """Return the polyline (N, 2) of a chain of Dubins pieces; every point lies exactly on the path.

    Args:
        pieces: records with ``start_pose`` [x, y, yaw], ``shape`` (three of L, S, R), ``radius`` in m and
            ``segment_length`` (three arc lengths in m); an ``end_pose``, where there is one, is checked.
        longest_m: longer paths are refused before they are sampled.
        notes: counts start headings that were wrong by half a turn and were corrected by the end pose.

    Raises:
        ValueError: there are no pieces, a field is missing or malformed, a number is not finite, the path is too long
            or makes too many full turns, or pieces do not follow one another.
    """
    if not pieces:
        raise ValueError("the path has no pieces")
    parsed = [_parse(piece) for piece in pieces]
    total = sum(sum(piece.lengths_m) for piece in parsed)
    if total > longest_m:
        raise ValueError(f"the path is {total:.0f} m long, more than the map's extent of {longest_m:.0f} m")
    points: list[tuple[float, float]] = []
    for piece in parsed:
        part = _points_of(piece, notes)
        if points and math.dist(points[-1], part[0]) > CHAIN_GAP_M:
            raise ValueError(f"a piece begins {math.dist(points[-1], part[0]):.1f} m from the one before")
        points += part
    end = parsed[-1].end
    line = np.array(points if end is None else [*points, end[:2]], dtype=np.float64)
    return drop_repeats(line)


@dataclass(frozen=True)
class _DubinsPiece:
    start: tuple[float, float, float]
    end: tuple[float, float, float] | None
    radius_m: float
    lengths_m: tuple[float, ...]
    turns: tuple[float, ...]


def _parse(piece: Mapping[str, Any]) -> _DubinsPiece:
    """Return a record as a Dubins piece; raise a ValueError if it is malformed."""
    try:
        x, y, yaw = (float(v) for v in piece["start_pose"])
        radius = float(piece["radius"])
        lengths = tuple(float(v) for v in piece["segment_length"])
        turns = tuple(TURN[letter] for letter in piece["shape"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"malformed arc-line piece ({error})") from None
    if not all(map(math.isfinite, (x, y, yaw, *lengths))):
        raise ValueError("a number of an arc-line piece is not finite")
    if len(turns) != 3 or len(lengths) != 3 or min(lengths) < 0 or (any(turns) and not radius > 0):
        raise ValueError("malformed arc-line piece (three segments and a positive radius are needed)")
    if any(turns) and not math.isfinite(radius):
        raise ValueError("the radius of an arc-line piece is not finite")
    arcs = sum(length for turn, length in zip(turns, lengths, strict=True) if turn)
    if arcs > 2.0 * math.pi * radius * MOST_TURNS:
        raise ValueError(f"an arc-line piece turns round many times ({arcs:.0f} m of arcs of {radius:g} m)")
    return _DubinsPiece((x, y, yaw), _end_pose(piece.get("end_pose")), radius, lengths, turns)


def _end_pose(value: Any) -> tuple[float, float, float] | None:
    if value is None:
        return None
    try:
        x, y, yaw = (float(v) for v in value)
    except (TypeError, ValueError):
        raise ValueError("malformed end_pose of an arc-line piece") from None
    if not all(map(math.isfinite, (x, y, yaw))):
        raise ValueError("a coordinate is not finite")
    return x, y, yaw


def _points_of(piece: _DubinsPiece, notes: Counter[str] | None) -> list[tuple[float, float]]:
    """Return the points of *piece*, which must end at its stated end pose; a start heading wrong by π is corrected."""
    yaw = piece.start[2]
    points = _integrate(piece, yaw)
    if piece.end is None or math.dist(points[-1], piece.end[:2]) <= END_GAP_M:
        return points
    turned = _integrate(piece, yaw + math.pi)
    if math.dist(turned[-1], piece.end[:2]) <= END_GAP_M:
        if notes is not None:
            notes["start headings turned by half a turn, put right"] += 1
        return turned
    raise ValueError(f"its arcs end {math.dist(points[-1], piece.end[:2]):.1f} m from the stated end_pose")


def _integrate(piece: _DubinsPiece, yaw: float) -> list[tuple[float, float]]:
    """Return the points of *piece* with start heading *yaw* in rad."""
    points = [piece.start[:2]]
    for turn, length in zip(piece.turns, piece.lengths_m, strict=True):
        if length > 0:
            arc = _segment(points[-1], yaw, turn / piece.radius_m if turn else 0.0, length)
            points += arc
            yaw += turn * length / piece.radius_m if turn else 0.0
    return points


def _segment(
    start: tuple[float, float], yaw: float, curvature: float, length: float
) -> list[tuple[float, float]]:
    """Return the points after *start* along a straight line or an arc of constant curvature."""
    x, y = start
    if curvature == 0.0:
        return [(x + length * math.cos(yaw), y + length * math.sin(yaw))]
    radius = 1.0 / abs(curvature)
    chord_angle = 2.0 * math.acos(max(1.0 - SAGITTA_M / radius, 0.0))
    count = max(1, math.ceil(length * abs(curvature) / chord_angle))
    angles = yaw + curvature * length * np.arange(1, count + 1) / count
    xs = x + (np.sin(angles) - math.sin(yaw)) / curvature
    ys = y - (np.cos(angles) - math.cos(yaw)) / curvature
    return list(zip(xs.tolist(), ys.tolist(), strict=True))


def drop_repeats(line: FloatArray, gap_m: float = POINT_GAP_M) -> FloatArray:
    """Return *line* (N, 2) without points nearer than *gap_m* to the last one kept; both end points are kept."""
    kept = [0]
    for index in range(1, len(line)):
        if math.dist(line[index], line[kept[-1]]) >= gap_m:
            kept.append(index)
    if kept[-1] != len(line) - 1 and len(kept) > 1:
        kept[-1] = len(line) - 1
    return line[kept]
