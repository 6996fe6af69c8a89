"""Routes over edges, one graph for each vehicle class: fastest, random, fringe, connected part."""

from __future__ import annotations

import heapq
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from advdiff_sumo.maps.build_graph import LaneGraph
from advdiff_sumo.maps.lanes import Lane, Link

_MIN_SPEED_MPS = 0.1


@dataclass(frozen=True, eq=False)
class EdgeGraph:
    """Which edge leads to which for one vehicle class.

    Attributes:
        vclass: the vehicle class; None for any road motor vehicle.
        successors: edge → following edge → seconds to drive the junction between them.
        drive_s: seconds to drive each edge.
        length_m: length of each edge.
        ends: junctions at which each edge begins and ends.
    """

    vclass: str | None
    successors: Mapping[str, Mapping[str, float]]
    drive_s: Mapping[str, float]
    length_m: Mapping[str, float]
    ends: Mapping[str, tuple[str, str]]

    @staticmethod
    def of(graph: LaneGraph, vclass: str | None) -> EdgeGraph:
        """Return the graph of the edges that *vclass* may use."""
        successors: dict[str, dict[str, float]] = {}
        drive, length = {}, {}
        for edge in graph.edges.values():
            lanes = [graph.lanes[x] for x in edge.lane_ids if graph.lanes[x].permits(vclass)]
            if edge.is_internal or not lanes:
                continue
            drive[edge.id] = edge.length_m / max(_MIN_SPEED_MPS, *(x.speed_mps for x in lanes))
            length[edge.id] = edge.length_m
            successors[edge.id] = _onward(graph, lanes, vclass)
        ends = {edge: (graph.edges[edge].from_junction, graph.edges[edge].to_junction) for edge in drive}
        return EdgeGraph(vclass, successors, drive, length, ends)

    @cached_property
    def predecessors(self) -> Mapping[str, tuple[str, ...]]:
        """Edges that lead to each edge."""
        before: dict[str, list[str]] = {edge: [] for edge in self.successors}
        for edge, onward in self.successors.items():
            for target in onward:
                before[target].append(edge)
        return {edge: tuple(edges) for edge, edges in before.items()}

    def fastest(self, start: str, goal: str) -> tuple[str, ...] | None:
        """Return the edges of the quickest route, both ends included; None when there is none (Dijkstra)."""
        if start not in self.successors or goal not in self.successors:
            return None
        best = {start: 0.0}
        before: dict[str, str] = {}
        queue = [(0.0, start)]
        while queue:
            cost, edge = heapq.heappop(queue)
            if edge == goal:
                return _traced(before, goal)
            if cost > best[edge]:
                continue
            for target, junction_s in self.successors[edge].items():
                total = cost + junction_s + self.drive_s[target]
                if total < best.get(target, np.inf):
                    best[target], before[target] = total, edge
                    heapq.heappush(queue, (total, target))
        return None

    def random(self, start: str, min_length_m: float, rng: np.random.Generator) -> tuple[str, ...]:
        """Return a random walk of edges from *start* until *min_length_m* beyond it or a dead end.

        Turns into edges from which one can drive on, and that were not driven yet, are preferred.
        """
        if start not in self.successors:
            return ()
        route, driven = [start], 0.0
        while driven < min_length_m:
            options = sorted(self.successors[route[-1]])
            if not options:
                break
            fresh = [e for e in options if e not in route] or options
            lasting = [e for e in fresh if self.drivable_ahead_m[e] >= min_length_m - driven] or [
                e for e in fresh if self.successors[e]
            ]
            choice = lasting or fresh
            route.append(choice[int(rng.integers(len(choice)))])
            driven += self.length_m[route[-1]]
        return tuple(route)

    @cached_property
    def drivable_ahead_m(self) -> Mapping[str, float]:
        """How far one can drive from the start of each edge: inf where a cycle can be reached.

        Without cycles this is the longest path; edges that reach a strongly connected part get inf.
        """
        edges, component = self._components
        size = np.bincount(component)
        ahead = {e: np.inf for e, c in zip(edges, component, strict=True) if size[c] > 1}
        stack = sorted(set(edges) - set(ahead), reverse=True)
        while stack:
            edge = stack[-1]
            todo = [e for e in self.successors[edge] if e not in ahead and e != edge]
            if edge in ahead or not todo:
                stack.pop()
                onward = [ahead[e] for e in self.successors[edge] if e != edge]
                ahead.setdefault(edge, self.length_m[edge] + max(onward, default=0.0))
            else:
                stack.extend(todo)
        return ahead

    @cached_property
    def _components(self) -> tuple[list[str], NDArray[np.int32]]:
        return strong_components(self.successors)

    def strongly_connected(self) -> frozenset[str]:
        """Return the largest set of edges of which each can be reached from each other one."""
        edges, component = self._components
        if not edges:
            return frozenset()
        biggest = int(np.argmax(np.bincount(component)))
        return frozenset(e for e, c in zip(edges, component, strict=True) if c == biggest)

    def sources(self) -> tuple[str, ...]:
        """Return edges that nothing leads to but their own turn-round, sorted."""
        return tuple(sorted(e for e, before in self.predecessors.items() if self._only_back(e, before)))

    def _only_back(self, edge: str, others: tuple[str, ...]) -> bool:
        return all(self.ends[other] == self.ends[edge][::-1] for other in others)


def strong_components(following: Mapping[str, Collection[str]]) -> tuple[list[str], NDArray[np.int32]]:
    """Return the edges in order, and of each the number of the strongly connected part that it belongs to.

    Args:
        following: edge → those that it leads to, which are keys themselves.
    """
    names = sorted(following)
    number = {name: row for row, name in enumerate(names)}
    pairs = [(number[a], number[b]) for a in names for b in following[a]]
    rows, columns = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    matrix = csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(names), len(names)))
    return names, connected_components(matrix, directed=True, connection="strong")[1]


def _onward(graph: LaneGraph, lanes: list[Lane], vclass: str | None) -> dict[str, float]:
    """Return the edges that *lanes* lead to and the seconds of the shortest junction crossing to each."""
    onward: dict[str, float] = {}
    for lane in lanes:
        for link in lane.successors:
            target = graph.lanes[link.to_lane]
            if target.permits(vclass):
                crossing = junction_drive_s(graph.lanes, link)
                onward[target.edge_id] = min(crossing, onward.get(target.edge_id, np.inf))
    return onward


def junction_drive_s(lanes: Mapping[str, Lane], link: Link) -> float:
    """Return the seconds to drive the internal lanes of *link* at their limits."""
    return sum(lanes[x].length_m / max(_MIN_SPEED_MPS, lanes[x].speed_mps) for x in link.via if x in lanes)


def _traced(before: Mapping[str, str], goal: str) -> tuple[str, ...]:
    route = [goal]
    while route[-1] in before:
        route.append(before[route[-1]])
    return tuple(reversed(route))
