"""Which lane may turn where: one rule for every junction of a plan."""

from __future__ import annotations

import math
from collections.abc import Iterator

from networks_src.plain import Edge, Link, Plan

STRAIGHT_RAD = math.radians(42.0)
U_TURN_RAD = math.radians(150.0)


def connect(plan: Plan, skip: frozenset[str] = frozenset()) -> None:
    """Fill `plan.links` for every node at which edges meet, but for the nodes in `skip`.

    Kerb lane 0 serves the near turn (right, in left-hand traffic left), the innermost lane the far
    turn, a pocket the far turn alone; lanes that go on meet their counterparts from the median out,
    so that a kerb lane without a counterpart becomes a turn lane or ends.
    """
    for node in (n for n in plan.nodes if n not in skip):
        incoming = [e for e in plan.edges.values() if e.end == node]
        outgoing = [e for e in plan.edges.values() if e.start == node]
        for edge in incoming:
            exits = _exits(plan, edge, outgoing)
            if edge.pocket and "far" not in exits:
                raise ValueError(f"{edge.name} has a pocket but no far turn to use it")
            for turn in ("near", "straight", "far"):
                if turn in exits:
                    pairs = _lanes(edge, turn, exits)
                    plan.links += [Link(edge.name, exits[turn].name, a, b) for a, b in pairs]


def _exits(plan: Plan, edge: Edge, outgoing: list[Edge]) -> dict[str, Edge]:
    """The at most three ways on from an edge; of two nearly straight ones the straighter is straight."""
    exits: dict[str, Edge] = {}
    ways = [(math.remainder(out.heading_in_rad - edge.heading_out_rad, math.tau), out) for out in outgoing]
    for change, out in sorted(ways, key=lambda way: abs(way[0])):
        back = out.end == edge.start and out.street == edge.street
        if back or abs(change) > U_TURN_RAD:
            continue
        side = "far" if (change > 0) != plan.lefthand else "near"
        turn = "straight" if abs(change) <= STRAIGHT_RAD and "straight" not in exits else side
        if turn in exits:
            raise ValueError(f"two {turn} turns from {edge.name}: {exits[turn].name}, {out.name}")
        exits[turn] = out
    return exits


def _lanes(edge: Edge, turn: str, exits: dict[str, Edge]) -> Iterator[tuple[int, int]]:
    there = exits[turn].lanes
    if len(exits) == 1:
        if edge.lanes < there:
            return iter([(i, i) for i in range(edge.lanes)])
        return ((edge.lanes - 1 - i, there - 1 - i) for i in range(min(edge.lanes, there)))
    if turn == "near":
        return iter([(0, 0)])
    if turn == "far":
        return iter([(edge.lanes - 1, there - 1)])
    through = edge.lanes - int(edge.pocket)
    if through > there and "near" not in exits:
        return ((i, i) for i in range(there))
    return ((through - 1 - i, there - 1 - i) for i in range(min(through, there)))
