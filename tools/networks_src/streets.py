"""Lay streets of a table as carriageways with medians, turn pockets and lane drops."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from networks_src.curve import Curve
from networks_src.plain import Edge, Node, Plan


@dataclass(frozen=True)
class Street:
    """A street through named nodes and free points.

    Attributes:
        name: name shown on the map.
        course: node names, or (x, y) points in metres that only shape the curve.
        ahead: number of lanes in the direction of the course; 0: none.
        back: number of lanes in the opposite direction; 0: none.
        speed_mps: speed limit.
        priority: netconvert's edge priority.
        median_m: width of the strip between the carriageways; 0: a painted line.
        pocket_m: length of the far-turn pockets, which are cut into the median.
        pockets: (from node, to node) pairs whose approach has a pocket.
        changes: node → (ahead, back) lanes from that node on.
        drops: (from node, to node) → (metres after the start, lanes from there on), for lane drops within a block.
        width_m: lane width.
    """

    name: str
    course: tuple[str | tuple[float, float], ...]
    ahead: int = 1
    back: int = 1
    speed_mps: float = 11.11
    priority: int = 3
    median_m: float = 0.0
    pocket_m: float = 42.0
    pockets: frozenset[tuple[str, str]] = frozenset()
    changes: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    drops: Mapping[tuple[str, str], tuple[float, int]] = field(default_factory=dict)
    width_m: float = 3.25


def lay(plan: Plan, street: Street) -> None:
    """Add the edges of a street, and the nodes at which its cross-section changes, to the plan."""
    points = [plan.nodes[p].xy_m if isinstance(p, str) else p for p in street.course]
    curve = Curve(np.array(points, dtype=float))
    stops = [
        (p, float(s)) for p, s in zip(street.course, curve.stations_m, strict=True) if isinstance(p, str)
    ]
    ahead, back = street.ahead, street.back
    for (start, s0), (end, s1) in itertools.pairwise(stops):
        ahead, back = street.changes.get(start, (ahead, back))
        if ahead:
            _lay_block(plan, street, curve, (start, end), (s0, s1), ahead)
        if back:
            _lay_block(plan, street, curve, (end, start), (s1, s0), back)


def _lay_block(
    plan: Plan,
    street: Street,
    curve: Curve,
    ends: tuple[str, str],
    stations: tuple[float, float],
    lanes: int,
) -> None:
    """Add the edges of one direction between two nodes, `ends`, at arc lengths `stations` of the curve."""
    direction = 1.0 if stations[1] > stations[0] else -1.0
    cuts: list[tuple[float, int, bool]] = [(stations[0], lanes, False)]  # station, lanes, pocket
    if ends in street.drops:
        after_m, lanes_left = street.drops[ends]
        cuts.append((stations[0] + direction * after_m, lanes_left, False))
    if ends in street.pockets:
        cuts.append((stations[1] - direction * street.pocket_m, cuts[-1][1] + 1, True))
    bounds = [*(c[0] for c in cuts), stations[1]]
    names = [ends[0], *(f"{ends[0]}_{ends[1]}_{i}" for i in range(1, len(cuts))), ends[1]]
    for i, (station, count, pocket) in enumerate(cuts):
        if i:
            x, y = curve.at(station)[0]
            plan.add_node(Node(names[i], (float(x), float(y)), radius_m=0.5))
        inner = -street.median_m / 2 if pocket else street.median_m / 2
        side = -direction if not plan.lefthand else direction
        is_two_way = street.ahead and street.back
        plan.add_edge(
            Edge(
                name=f"{ends[0]}-{ends[1]}" + (f".{i}" if i else ""),
                start=names[i],
                end=names[i + 1],
                street=street.name,
                lanes=count,
                speed_mps=street.speed_mps,
                priority=street.priority,
                shape_m=curve.piece(station, bounds[i + 1], side * inner if is_two_way else 0.0),
                spread="right" if is_two_way else "center",
                width_m=street.width_m,
                pocket=pocket,
            )
        )
