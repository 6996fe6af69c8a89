"""Which lane ends meet in one junction: a union-find over the ends of pieces and lanes."""

from __future__ import annotations

from collections.abc import Hashable, Iterable


class Joints:
    """Disjoint sets of lane ends."""

    def __init__(self) -> None:
        self._parent: dict[Hashable, Hashable] = {}

    def find(self, end: Hashable) -> Hashable:
        """Return the representative of the set that holds *end*."""
        parent = self._parent.setdefault(end, end)
        while parent != self._parent[parent]:
            self._parent[parent] = parent = self._parent[self._parent[parent]]
        self._parent[end] = parent
        return parent

    def join(self, ends: Iterable[Hashable]) -> Hashable:
        """Put all *ends* into one set and return its representative."""
        roots = list(dict.fromkeys(self.find(end) for end in ends))
        for root in roots[1:]:
            self._parent[root] = roots[0]
        return roots[0]
