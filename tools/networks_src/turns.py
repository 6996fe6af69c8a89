"""Connect lanes at junctions: one rule for every junction of a plan."""

from __future__ import annotations

import math
from collections.abc import Iterator

from networks_src.plain import Edge, Link, Plan

STRAIGHT_RAD = math.radians(42.0)
U_TURN_RAD = math.radians(150.0)


def connect(plan: Plan, skip: frozenset[str] = frozenset()) -> None:
    """Add the links of every node except those in `skip`.

    The near turn (right; in left-hand traffic left) uses kerb lane 0. The far turn uses the innermost lane; a pocket is
    for the far turn only. Through lanes are connected to their counterparts, counted from the median outwards, so that
    a kerb lane without a counterpart becomes a turn lane or ends.
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
    """Return turn → edge, at most three; of two nearly straight edges, the straighter one counts as straight."""
    exits: dict[str, Edge] = {}
    turns = [(math.remainder(out.heading_in_rad - edge.heading_out_rad, math.tau), out) for out in outgoing]
    for change, out in sorted(turns, key=lambda turn: abs(turn[0])):
        leads_back = out.end == edge.start and out.street == edge.street
        if leads_back or abs(change) > U_TURN_RAD:
            continue
        side = "far" if (change > 0) != plan.lefthand else "near"
        turn = "straight" if abs(change) <= STRAIGHT_RAD and "straight" not in exits else side
        if turn in exits:
            raise ValueError(f"two {turn} turns from {edge.name}: {exits[turn].name}, {out.name}")
        exits[turn] = out
    return exits


def _lanes(edge: Edge, turn: str, exits: dict[str, Edge]) -> Iterator[tuple[int, int]]:
    """Return the (from lane, to lane) pairs of a turn."""
    lanes = exits[turn].lanes
    if len(exits) == 1:
        if edge.lanes < lanes:
            return iter([(i, i) for i in range(edge.lanes)])
        return ((edge.lanes - 1 - i, lanes - 1 - i) for i in range(min(edge.lanes, lanes)))
    if turn == "near":
        return iter([(0, 0)])
    if turn == "far":
        return iter([(edge.lanes - 1, lanes - 1)])
    through = edge.lanes - int(edge.pocket)
    if through > lanes and "near" not in exits:
        return ((i, i) for i in range(lanes))
    return ((through - 1 - i, lanes - 1 - i) for i in range(min(through, lanes)))
