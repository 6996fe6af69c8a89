"""Shape turns through junctions as a straight line and an arc, with a comfortable speed.

netconvert draws a turn as a quadratic curve whose control point is the intersection of the lanes' directions. If its
legs have unequal lengths, its tightest radius is a third of what the corner allows, and its speed is that of the mean
radius.
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
    """Return the plan with shapes and speeds for every turn that consists of one arc.

    Args:
        plan: the plan from which `net` was made.
        net: sumolib net of the plan without shapes; it has the positions at which lanes end at junctions.
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
    """Return `link` with a straight line and an arc as its shape; unchanged if one arc cannot make the turn.

    Args:
        link: the link.
        entry: (2, 2) last two points of the lane that it leaves.
        leave: (2, 2) first two points of the lane that it enters.
        limit_mps: speed limit.
    """
    heading_in, heading_out = _unit(entry[1] - entry[0]), _unit(leave[1] - leave[0])
    cross = heading_in[0] * heading_out[1] - heading_in[1] * heading_out[0]
    turn = math.atan2(cross, float(heading_in @ heading_out))
    if not FLATTEST_RAD <= abs(turn) <= SHARPEST_RAD:
        return link
    a, b = np.linalg.solve(
        np.stack([heading_in, heading_out], axis=1), leave[0] - entry[1]
    )  # lengths of the legs
    if min(a, b) <= 0.5:
        return link
    leg = float(min(a, b))
    radius = leg / math.tan(abs(turn) / 2)
    corner = entry[1] + a * heading_in
    shape = np.vstack([entry[1], _arc(corner - leg * heading_in, heading_in, radius, turn), leave[0]])
    is_distinct = np.hypot(*np.diff(shape, axis=0).T) > 0.02
    shape = np.vstack([shape[0], shape[1:][is_distinct]])
    shape[-1] = leave[0]
    return dataclasses.replace(
        link, shape_m=shape, speed_mps=min(limit_mps, math.sqrt(LATERAL_MPS2 * radius))
    )


def _arc(start: Points, heading: Points, radius_m: float, turn_rad: float) -> Points:
    """Return points (N, 2) on an arc that begins at `start` with `heading` and turns by `turn_rad`."""
    count = max(4, math.ceil(abs(turn_rad) / STEP_RAD)) + 1
    swept = np.linspace(0.0, abs(turn_rad), count)
    left = math.copysign(1.0, turn_rad) * np.array([-heading[1], heading[0]])
    return np.asarray(
        start + radius_m * (np.outer(np.sin(swept), heading) + np.outer(1.0 - np.cos(swept), left))
    )


def _unit(vector: Points) -> Points:
    return np.asarray(vector / np.hypot(*vector))
