"""Lay a single-lane roundabout with separate, deflected entries and exits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from networks_src.curve import arc, hermite
from networks_src.plain import Edge, Node, Plan, Points


@dataclass(frozen=True)
class Roundabout:
    """Centre and size of a roundabout; `gap_rad` is the angle between an arm and its entry and exit."""

    name: str
    centre_m: tuple[float, float]
    radius_m: float = 19.0
    gap_rad: float = math.radians(21.0)
    deflection_rad: float = math.radians(38.0)
    speed_mps: float = 8.33
    approach_mps: float = 11.11
    width_m: float = 3.5
    flare_m: float = 22.0  # length over which the two lanes of an arm separate


def lay_roundabout(plan: Plan, ring: Roundabout, arms: Sequence[str]) -> None:
    """Add circle, entries and exits to the plan; `arms` are the existing nodes at which two-way arms begin."""
    turn = -1.0 if plan.lefthand else 1.0
    bearings = {arm: _bearing(ring, plan.nodes[arm].xy_m) for arm in arms}
    corners: list[tuple[str, float]] = []
    for arm in sorted(arms, key=lambda a: turn * bearings[a] % math.tau):
        corners.append((f"{ring.name}_{arm}_out", bearings[arm] - turn * ring.gap_rad))
        corners.append((f"{ring.name}_{arm}_in", bearings[arm] + turn * ring.gap_rad))
    for name, angle in corners:
        x, y = arc(ring.centre_m, ring.radius_m, angle, 0.1)[0]
        plan.add_node(Node(name, (float(x), float(y)), radius_m=5.0))
    for (start, a0), (end, a1) in zip(corners, corners[1:] + corners[:1], strict=True):
        sweep = turn * (turn * (a1 - a0) % math.tau)
        shape = arc(ring.centre_m, ring.radius_m, a0, sweep)
        plan.add_edge(_edge(ring, start, end, ring.speed_mps, 12, shape))
    for arm in arms:
        _lay_arm(plan, ring, arm, bearings[arm], turn)


def _bearing(ring: Roundabout, xy_m: tuple[float, float]) -> float:
    return math.atan2(xy_m[1] - ring.centre_m[1], xy_m[0] - ring.centre_m[0])


def _lay_arm(plan: Plan, ring: Roundabout, arm: str, bearing: float, turn: float) -> None:
    outward = np.array([math.cos(bearing), math.sin(bearing)])
    entry_side = np.array([-outward[1], outward[0]]) * turn * ring.width_m / 2
    far, near = np.array(plan.nodes[arm].xy_m), ring.centre_m + outward * (ring.radius_m + ring.flare_m)
    node_in, node_out = f"{ring.name}_{arm}_in", f"{ring.name}_{arm}_out"
    slant = turn * (math.pi / 2 + ring.gap_rad + ring.deflection_rad)
    entry = hermite(near + entry_side, bearing + math.pi, plan.nodes[node_in].xy_m, bearing + slant)
    leave = hermite(plan.nodes[node_out].xy_m, bearing + turn * math.pi - slant, near - entry_side, bearing)
    entry, leave = np.vstack([far + entry_side, entry]), np.vstack([leave, far - entry_side])
    plan.add_edge(_edge(ring, arm, node_in, ring.approach_mps, 4, entry))
    plan.add_edge(_edge(ring, node_out, arm, ring.approach_mps, 4, leave))


def _edge(ring: Roundabout, start: str, end: str, speed_mps: float, priority: int, shape: Points) -> Edge:
    name = f"{start}-{end}"
    return Edge(
        name, start, end, f"{ring.name} circle", 1, speed_mps, priority, shape, "center", ring.width_m
    )
