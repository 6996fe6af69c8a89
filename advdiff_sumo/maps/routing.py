"""Finds routes over edges for one vehicle class, entry edges of the net, and its connected part."""

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
"""Lower bound of speed limits, so that travel times are finite."""


@dataclass(frozen=True, eq=False)
class EdgeGraph:
    """The graph of the edges that one vehicle class may use.

    Attributes:
        vclass: the vehicle class; None for any road motor vehicle.
        successors: edge → following edge → travel time in s over the junction between them.
        drive_s: edge → travel time at the speed limit.
        length_m: edge → length.
        ends: edge → junctions at which it begins and ends.
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
        drive_s, length_m = {}, {}
        for edge in graph.edges.values():
            lanes = [graph.lanes[x] for x in edge.lane_ids if graph.lanes[x].permits(vclass)]
            if edge.is_internal or not lanes:
                continue
            drive_s[edge.id] = edge.length_m / max(_MIN_SPEED_MPS, *(x.speed_mps for x in lanes))
            length_m[edge.id] = edge.length_m
            successors[edge.id] = _crossing_times_s(graph, lanes, vclass)
        ends = {edge: (graph.edges[edge].from_junction, graph.edges[edge].to_junction) for edge in drive_s}
        return EdgeGraph(vclass, successors, drive_s, length_m, ends)

    @cached_property
    def predecessors(self) -> Mapping[str, tuple[str, ...]]:
        """Edge → edges that lead to it."""
        predecessors: dict[str, list[str]] = {edge: [] for edge in self.successors}
        for edge, successors in self.successors.items():
            for successor in successors:
                predecessors[successor].append(edge)
        return {edge: tuple(edges) for edge, edges in predecessors.items()}

    def fastest(self, start: str, goal: str) -> tuple[str, ...] | None:
        """Return the edges of the fastest route, with both ends; None if there is no route (Dijkstra)."""
        if start not in self.successors or goal not in self.successors:
            return None
        least_s = {start: 0.0}
        predecessors: dict[str, str] = {}
        queue = [(0.0, start)]
        while queue:
            time_s, edge = heapq.heappop(queue)
            if edge == goal:
                return _traced(predecessors, goal)
            if time_s > least_s[edge]:
                continue
            for successor, junction_s in self.successors[edge].items():
                total_s = time_s + junction_s + self.drive_s[successor]
                if total_s < least_s.get(successor, np.inf):
                    least_s[successor], predecessors[successor] = total_s, edge
                    heapq.heappush(queue, (total_s, successor))
        return None

    def random(self, start: str, min_length_m: float, rng: np.random.Generator) -> tuple[str, ...]:
        """Return a random route from *start* that ends at least *min_length_m* beyond it, or at a dead end.

        Each next edge is drawn from those that are not yet on the route and lead far enough, if there are any. If none
        leads far enough, edges with a successor are preferred.
        """
        if start not in self.successors:
            return ()
        route, driven_m = [start], 0.0
        while driven_m < min_length_m:
            options = sorted(self.successors[route[-1]])
            if not options:
                break
            unvisited = [e for e in options if e not in route] or options
            preferred = [e for e in unvisited if self.drivable_ahead_m[e] >= min_length_m - driven_m] or [
                e for e in unvisited if self.successors[e]
            ]
            candidates = preferred or unvisited
            route.append(candidates[int(rng.integers(len(candidates)))])
            driven_m += self.length_m[route[-1]]
        return tuple(route)

    @cached_property
    def drivable_ahead_m(self) -> Mapping[str, float]:
        """Edge → length of the longest route from its start; inf if a cycle of several edges can be reached."""
        edges, component = self._components
        size = np.bincount(component)
        ahead_m = {e: np.inf for e, c in zip(edges, component, strict=True) if size[c] > 1}
        stack = sorted(set(edges) - set(ahead_m), reverse=True)
        while stack:
            edge = stack[-1]
            unknown = [e for e in self.successors[edge] if e not in ahead_m and e != edge]
            if edge in ahead_m or not unknown:
                stack.pop()
                successors_m = [ahead_m[e] for e in self.successors[edge] if e != edge]
                ahead_m.setdefault(edge, self.length_m[edge] + max(successors_m, default=0.0))
            else:
                stack.extend(unknown)
        return ahead_m

    @cached_property
    def _components(self) -> tuple[list[str], NDArray[np.int32]]:
        return strong_components(self.successors)

    def strongly_connected(self) -> frozenset[str]:
        """Return the largest strongly connected set of edges: each can be reached from each other one."""
        edges, component = self._components
        if not edges:
            return frozenset()
        largest = int(np.argmax(np.bincount(component)))
        return frozenset(e for e, c in zip(edges, component, strict=True) if c == largest)

    def sources(self) -> tuple[str, ...]:
        """Return the edges that no other edge leads to, apart from a U-turn out of their opposite direction; sorted."""
        return tuple(
            sorted(
                edge
                for edge, predecessors in self.predecessors.items()
                if all(self.ends[other] == self.ends[edge][::-1] for other in predecessors)
            )
        )


def strong_components(following: Mapping[str, Collection[str]]) -> tuple[list[str], NDArray[np.int32]]:
    """Return the edges, sorted, and the number of the strongly connected component that each belongs to.

    Args:
        following: edge → edges that it leads to; these must be keys themselves.
    """
    names = sorted(following)
    row_of = {name: row for row, name in enumerate(names)}
    pairs = [(row_of[a], row_of[b]) for a in names for b in following[a]]
    rows, columns = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    matrix = csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(names), len(names)))
    return names, connected_components(matrix, directed=True, connection="strong")[1]


def _crossing_times_s(graph: LaneGraph, lanes: list[Lane], vclass: str | None) -> dict[str, float]:
    """Return each edge that *lanes* lead to → the least travel time over the junction to it."""
    times_s: dict[str, float] = {}
    for lane in lanes:
        for link in lane.successors:
            to_lane = graph.lanes[link.to_lane]
            if to_lane.permits(vclass):
                crossing_s = junction_drive_s(graph.lanes, link)
                times_s[to_lane.edge_id] = min(crossing_s, times_s.get(to_lane.edge_id, np.inf))
    return times_s


def junction_drive_s(lanes: Mapping[str, Lane], link: Link) -> float:
    """Return the travel time in s over the internal lanes of *link* at their speed limits."""
    return sum(lanes[x].length_m / max(_MIN_SPEED_MPS, lanes[x].speed_mps) for x in link.via if x in lanes)


def _traced(predecessors: Mapping[str, str], goal: str) -> tuple[str, ...]:
    route = [goal]
    while route[-1] in predecessors:
        route.append(predecessors[route[-1]])
    return tuple(reversed(route))
