"""Sets of lane ends that meet in one junction, based on scipy's disjoint sets."""

from __future__ import annotations

from collections.abc import Hashable, Iterable

from scipy.cluster.hierarchy import DisjointSet


class Joints:
    """Disjoint sets of lane ends, one per junction; an end that was never joined is a set of its own."""

    def __init__(self) -> None:
        self._sets = DisjointSet()

    def find(self, end: Hashable) -> Hashable:
        """Return the representative of the set that holds *end*."""
        self._sets.add(end)
        representative: Hashable = self._sets[end]
        return representative

    def members(self, end: Hashable) -> set[Hashable]:
        """Return all ends of the set that holds *end*."""
        self._sets.add(end)
        members: set[Hashable] = self._sets.subset(end)
        return members

    def join(self, ends: Iterable[Hashable]) -> Hashable:
        """Put all *ends* into one set and return its representative."""
        first, *others = dict.fromkeys(ends)
        self._sets.add(first)
        for end in others:
            self._sets.add(end)
            self._sets.merge(first, end)
        representative: Hashable = self._sets[first]
        return representative
