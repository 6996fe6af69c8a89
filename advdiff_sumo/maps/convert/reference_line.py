"""Polyline → smooth chain of straight lines and arcs, as the reference line of an OpenDRIVE road.

Chords of a curve meet at angles, which tears the borders of adjoining lanes apart. Here each corner becomes an arc
tangent to both chords, and a road can be made to begin and end with a given yaw.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import stations_m
from advdiff_sumo.maps.convert import polyline

OFF_M = 0.01  # a corner is cut by at most this
BEND_OFF_M = 0.02  # bending an end to a given yaw moves the line by at most this
BEND_M = (1.0, 0.5, 0.25, 0.1, 0.05, 0.02, 0.01, 0.005)  # tried in this order
STRAIGHT_RAD = 1e-6
SHORTEST_M = 1e-6
STUB_M = 0.1  # corners nearer to an end are left out: they would turn the whole lane's border there
SAGITTA_M = 0.004  # chords that lie nearer to their arc are taken for chords of an arc
SAME_PER_M = 1e-6


@dataclass(frozen=True)
class Stretch:
    """A straight line or arc from a pose (m, rad) on; *curvature* in 1/m, left positive."""

    x: float
    y: float
    yaw_rad: float
    length_m: float
    curvature: float


def end_yaw(line: FloatArray) -> float:
    """Return the yaw in rad in which *line* (N, 2) ends: of the circle that it ends on, else of its last chord."""
    return _wrapped(start_yaw(line[::-1]) + math.pi)


def start_yaw(line: FloatArray) -> float:
    """Return the yaw in rad in which *line* (N, 2) begins, likewise."""
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
    """Return stretches without a kink that follow *line* (N, 2) to ``BEND_OFF_M`` and have its ends and these yaws."""
    bent = _bent(_bent(_without_stubs(line), from_yaw)[::-1], _wrapped(to_yaw + math.pi))[::-1]
    return _merged(_filleted(_without_straight_corners(bent)))


def _without_stubs(line: FloatArray) -> FloatArray:
    s = stations_m(line)
    kept = (s > STUB_M) & (s < s[-1] - STUB_M)
    kept[[0, -1]] = True
    return np.asarray(line[kept])


def _bent(line: FloatArray, yaw: float) -> FloatArray:
    """Return *line* beginning in the direction *yaw*, bent over the longest way that keeps it in place."""
    along = np.array([math.cos(yaw), math.sin(yaw)])
    step = line[1] - line[0]
    if abs(_wrapped(math.atan2(step[1], step[0]) - yaw)) < STRAIGHT_RAD:
        return line
    s, best = stations_m(line), line
    for reach in BEND_M:
        joined = 3.0 * reach  # the arc at the corner then takes the whole way from the end to it
        if 2.0 * joined > s[-1]:
            continue
        corner = line[0] + reach * along
        after = np.vstack((polyline.at(line, joined), line[s > joined + 1e-3]))
        best = np.vstack((line[0], corner, after))
        places = polyline.at(line, np.linspace(0.0, joined, 9))
        if np.abs(polyline.project(best[:3], places)[1]).max() <= BEND_OFF_M:
            break
    return best


def _without_straight_corners(line: FloatArray) -> FloatArray:
    turn = polyline.turns(line)
    return line[np.concatenate(([True], np.abs(turn) > STRAIGHT_RAD, [True]))]


def _filleted(line: FloatArray) -> list[Stretch]:
    """Return the chords of *line* with an arc tangent to both at each corner."""
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
        rest = float(length[i] - before[i] - after[i])
        if rest > SHORTEST_M:
            stretches.append(Stretch(float(x), float(y), yaw, rest, 0.0))
        if i < len(turn):
            x, y = line[i + 1] - after[i] * unit[i]
            curvature = math.tan(0.5 * turn[i]) / float(after[i])
            stretches.append(Stretch(float(x), float(y), yaw, float(turn[i]) / curvature, curvature))
    return stretches


def _merged(stretches: list[Stretch]) -> list[Stretch]:
    """Return *stretches* with neighbours of one curvature made one."""
    kept = stretches[:1]
    for stretch in stretches[1:]:
        last = kept[-1]
        if abs(stretch.curvature - last.curvature) < SAME_PER_M:
            kept[-1] = Stretch(last.x, last.y, last.yaw_rad, last.length_m + stretch.length_m, last.curvature)
        else:
            kept.append(stretch)
    return kept


def _wrapped(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
