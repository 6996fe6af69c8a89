"""Turns through junctions as a straight and one arc, with the speed at which a car takes it calmly.

netconvert draws a turn as a quadratic curve whose control point is where the lanes' directions meet; with legs of
unequal length its tightest radius is a third of what the corner allows, and its speed follows the mean radius.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from networks_src.plain import Link, Plan, Points

LATERAL_MPS2 = 3.5
SHARPEST_RAD, FLATTEST_RAD = math.radians(150.0), math.radians(25.0)
STEP_RAD = math.radians(5.0)


def round_corners(plan: Plan, net: Any) -> Plan:
    """The plan with shapes and speeds for every turn that one arc can make.

    Args:
        plan: the plan from which `net` was made.
        net: sumolib net of the plan without shapes: it tells where lanes end at junctions.
    """
    links = []
    for link in plan.links:
        start = net.getEdge(link.source).getLane(link.from_lane)
        end = net.getEdge(link.target).getLane(link.to_lane)
        links.append(
            _rounded(link, np.array(start.getShape()[-2:]), np.array(end.getShape()[:2]), end.getSpeed())
        )
    return dataclasses.replace(plan, links=links)


def _rounded(link: Link, entry: Points, leave: Points, limit_mps: float) -> Link:
    ahead, onward = _unit(entry[1] - entry[0]), _unit(leave[1] - leave[0])
    turn = math.atan2(ahead[0] * onward[1] - ahead[1] * onward[0], float(ahead @ onward))
    if not FLATTEST_RAD <= abs(turn) <= SHARPEST_RAD:
        return link
    a, b = np.linalg.solve(np.stack([ahead, onward], axis=1), leave[0] - entry[1])
    if min(a, b) <= 0.5:
        return link
    leg = float(min(a, b))
    radius = leg / math.tan(abs(turn) / 2)
    corner = entry[1] + a * ahead
    shape = np.vstack([entry[1], _arc(corner - leg * ahead, ahead, radius, turn), leave[0]])
    distinct = np.hypot(*np.diff(shape, axis=0).T) > 0.02
    shape = np.vstack([shape[0], shape[1:][distinct]])
    shape[-1] = leave[0]
    return dataclasses.replace(
        link, shape_m=shape, speed_mps=min(limit_mps, math.sqrt(LATERAL_MPS2 * radius))
    )


def _arc(start: Points, heading: Points, radius_m: float, turn_rad: float) -> Points:
    """Points on an arc that leaves `start` along `heading` and turns by `turn_rad`."""
    count = max(4, math.ceil(abs(turn_rad) / STEP_RAD)) + 1
    swept = np.linspace(0.0, abs(turn_rad), count)
    left = math.copysign(1.0, turn_rad) * np.array([-heading[1], heading[0]])
    return np.asarray(
        start + radius_m * (np.outer(np.sin(swept), heading) + np.outer(1.0 - np.cos(swept), left))
    )


def _unit(vector: Points) -> Points:
    return np.asarray(vector / np.hypot(*vector))
