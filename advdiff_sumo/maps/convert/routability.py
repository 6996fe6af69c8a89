"""Which edges can reach which: what is reached from some, and strongly connected parts of a net."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from advdiff_sumo.maps.routing import strong_components


def reached(starts: Collection[str], following: Mapping[str, Collection[str]]) -> set[str]:
    """Return what can be reached from *starts*, these among it."""
    there, queue = set(starts), list(starts)
    while queue:
        new = set(following.get(queue.pop(), ())) - there
        there |= new
        queue += new
    return there


def strong_parts(next_edges: Mapping[str, Sequence[str]]) -> list[list[str]]:
    """Return the strongly connected parts of the edges, largest first, ties by name."""
    parts: dict[int, list[str]] = {}
    for name, part in zip(*strong_components(next_edges), strict=True):
        parts.setdefault(int(part), []).append(name)
    return sorted(parts.values(), key=lambda part: (-len(part), part))


def routability(next_edges: Mapping[str, Sequence[str]], length_m: Mapping[str, float]) -> dict[str, Any]:
    """Return the size of the largest strongly connected part, the others of two and more edges, and dead ends."""
    if not next_edges:
        return {"edges": 0}
    parts = strong_parts(next_edges)
    entered = {after for names in next_edges.values() for after in names}
    total = sum(length_m.get(name, 0.0) for name in next_edges)
    main = sum(length_m.get(name, 0.0) for name in parts[0])
    return {
        "edges": len(next_edges),
        "largest_part_edges": len(parts[0]),
        "largest_part_share_of_length": round(main / total, 4) if total else None,
        "strongly_connected_parts": [part for part in parts if len(part) > 1],
        "edges_alone": sum(len(part) == 1 for part in parts),
        "dead_ends": sorted(name for name, after in next_edges.items() if not after),
        "sources": sorted(name for name in next_edges if name not in entered),
    }
