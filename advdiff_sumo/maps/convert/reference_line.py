"""Turn a polyline into straight lines and arcs without kinks, as the reference line of an OpenDRIVE road.

The segments of a polyline meet at angles, so the borders of consecutive lanes would not meet. Here each corner becomes
an arc tangent to both segments, and the line gets a given yaw at both ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import stations_m
from advdiff_sumo.maps.convert import polyline

OFF_M = 0.01  # largest distance between a corner and its arc
BEND_OFF_M = 0.02  # largest shift of the line by bending an end to a given yaw
BEND_M = (1.0, 0.5, 0.25, 0.1, 0.05, 0.02, 0.01, 0.005)  # lengths of a bent end, tried in this order
STRAIGHT_RAD = 1e-6  # smaller changes of heading are ignored
SHORTEST_M = 1e-6  # shorter straight lines are left out
STUB_M = 0.1  # corners nearer to an end are removed: they would turn the border of the whole lane
SAGITTA_M = 0.004  # segments that would deviate less from an arc are taken for parts of an arc
SAME_PER_M = 1e-6  # curvatures that differ by less are equal


@dataclass(frozen=True)
class Stretch:
    """A straight line or arc that begins at a pose (m, rad); *curvature* in 1/m, left positive."""

    x: float
    y: float
    yaw_rad: float
    length_m: float
    curvature: float


def end_yaw(line: FloatArray) -> float:
    """Return the yaw in rad at the end of *line* (N, 2), see :func:`start_yaw`."""
    return _wrapped(start_yaw(line[::-1]) + math.pi)


def start_yaw(line: FloatArray) -> float:
    """Return the yaw in rad at the beginning of *line* (N, 2).

    It is that of the circle through the first three points if they lie on an arc, else that of the first segment.
    """
    step = np.diff(_without_stubs(line)[:3], axis=0)
    yaw = np.arctan2(step[:, 1], step[:, 0])
    if len(step) < 2:
        return float(yaw[0])
    length = np.hypot(step[:, 0], step[:, 1])
    turn = _wrapped(float(yaw[1] - yaw[0]))
    if abs(turn) * float(length.max()) / 8.0 > SAGITTA_M:
        return float(yaw[0])
    return _wrapped(float(yaw[0]) - turn * float(length[0] / length.sum()))


def smooth(line: FloatArray, from_yaw: float, to_yaw: float) -> list[Stretch]:
    """Return stretches without kinks that follow *line* (N, 2) within ``BEND_OFF_M``.

    They begin and end where *line* does, with the yaws *from_yaw* and *to_yaw* in rad.
    """
    bent = _bent(_bent(_without_stubs(line), from_yaw)[::-1], _wrapped(to_yaw + math.pi))[::-1]
    return _merged(_filleted(_without_straight_corners(bent)))


def _without_stubs(line: FloatArray) -> FloatArray:
    """Return *line* without inner points nearer than ``STUB_M`` to an end."""
    s = stations_m(line)
    kept = (s > STUB_M) & (s < s[-1] - STUB_M)
    kept[[0, -1]] = True
    return np.asarray(line[kept])


def _bent(line: FloatArray, yaw: float) -> FloatArray:
    """Return *line* with a beginning bent to *yaw* in rad, as long as the shift stays within ``BEND_OFF_M``."""
    along = np.array([math.cos(yaw), math.sin(yaw)])
    step = line[1] - line[0]
    if abs(_wrapped(math.atan2(step[1], step[0]) - yaw)) < STRAIGHT_RAD:
        return line
    s, bent = stations_m(line), line
    for reach in BEND_M:
        rejoin_m = 3.0 * reach  # so that the arc at the corner can begin at the end of the line
        if 2.0 * rejoin_m > s[-1]:
            continue
        corner = line[0] + reach * along
        after = np.vstack((polyline.at(line, rejoin_m), line[s > rejoin_m + 1e-3]))
        bent = np.vstack((line[0], corner, after))
        points = polyline.at(line, np.linspace(0.0, rejoin_m, 9))
        if np.abs(polyline.project(bent[:3], points)[1]).max() <= BEND_OFF_M:
            break
    return bent


def _without_straight_corners(line: FloatArray) -> FloatArray:
    turn = polyline.turns(line)
    return line[np.concatenate(([True], np.abs(turn) > STRAIGHT_RAD, [True]))]


def _filleted(line: FloatArray) -> list[Stretch]:
    """Return the segments of *line*, with an arc tangent to both segments at each corner."""
    step = np.diff(line, axis=0)
    length = np.hypot(step[:, 0], step[:, 1])
    unit, turn = step / length[:, None], polyline.turns(line)
    share = 0.5 * length
    share[[0, -1]] = length[[0, -1]]  # an end lies at one corner only
    cut = np.minimum(share[:-1], share[1:])
    cut = np.minimum(cut, OFF_M / np.tan(np.maximum(np.abs(turn), STRAIGHT_RAD) / 4.0))
    before, after = np.concatenate(([0.0], cut)), np.concatenate((cut, [0.0]))
    stretches: list[Stretch] = []
    for i in range(len(length)):
        yaw = math.atan2(unit[i, 1], unit[i, 0])
        x, y = line[i] + before[i] * unit[i]
        straight_m = float(length[i] - before[i] - after[i])
        if straight_m > SHORTEST_M:
            stretches.append(Stretch(float(x), float(y), yaw, straight_m, 0.0))
        if i < len(turn):
            x, y = line[i + 1] - after[i] * unit[i]
            curvature = math.tan(0.5 * turn[i]) / float(after[i])
            stretches.append(Stretch(float(x), float(y), yaw, float(turn[i]) / curvature, curvature))
    return stretches


def _merged(stretches: list[Stretch]) -> list[Stretch]:
    """Return *stretches* with consecutive ones of equal curvature joined."""
    kept = stretches[:1]
    for stretch in stretches[1:]:
        last = kept[-1]
        if abs(stretch.curvature - last.curvature) < SAME_PER_M:
            kept[-1] = Stretch(last.x, last.y, last.yaw_rad, last.length_m + stretch.length_m, last.curvature)
        else:
            kept.append(stretch)
    return kept


def _wrapped(angle: float) -> float:
    """Return *angle* in rad within [−π, π)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
