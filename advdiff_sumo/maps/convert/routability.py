"""Analyse which edges of a net can reach each other: reachable edges and strongly connected parts."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from advdiff_sumo.maps.routing import strong_components


def reachable(starts: Collection[str], following: Mapping[str, Collection[str]]) -> set[str]:
    """Return the edges that can be reached from *starts*, including these."""
    reached, queue = set(starts), list(starts)
    while queue:
        new = set(following.get(queue.pop(), ())) - reached
        reached |= new
        queue += new
    return reached


def strong_parts(next_edges: Mapping[str, Sequence[str]]) -> list[list[str]]:
    """Return the strongly connected parts of the edges, most edges first, ties by name."""
    parts: dict[int, list[str]] = {}
    for name, part in zip(*strong_components(next_edges), strict=True):
        parts.setdefault(int(part), []).append(name)
    return sorted(parts.values(), key=lambda part: (-len(part), part))


def routability(next_edges: Mapping[str, Sequence[str]], length_m: Mapping[str, float]) -> dict[str, Any]:
    """Return the size of the largest strongly connected part, all parts of several edges, dead ends and sources."""
    if not next_edges:
        return {"edges": 0}
    parts = strong_parts(next_edges)
    entered = {successors for names in next_edges.values() for successors in names}
    total = sum(length_m.get(name, 0.0) for name in next_edges)
    largest = sum(length_m.get(name, 0.0) for name in parts[0])
    return {
        "edges": len(next_edges),
        "largest_part_edges": len(parts[0]),
        "largest_part_share_of_length": round(largest / total, 4) if total else None,
        "strongly_connected_parts": [part for part in parts if len(part) > 1],
        "edges_alone": sum(len(part) == 1 for part in parts),
        "dead_ends": sorted(name for name, successors in next_edges.items() if not successors),
        "sources": sorted(name for name in next_edges if name not in entered),
    }
