"""Finds the edges that a recorded trajectory drove along (map matching).

The method is a hidden Markov model over edges (Newson and Krumm 2009, doi:10.1145/1653771.1653818). The states are
the edges near a point, internal ones included. The emission cost depends on distance and heading. A transition costs
the difference between the distance along the net and the straight-line distance.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import groupby, pairwise

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.maps.build_graph import LaneGraph
from advdiff_sumo.maps.locate import LaneIndex, candidate_cost

SPACING_M = 2.0
"""Smallest distance between two points that are used; those in between add no information."""
MAX_DISTANCE_M = 6.0
"""Largest distance of a point from a lane that it may be on."""
_MAX_YAW_ERROR_RAD = 1.75
_DETOUR_SCALE_M = 3.0  # a detour of this length costs 1
_BACKWARD_M = 6.0  # backward motion along an edge up to this length is taken for noise of the recording
_SEARCH_MARGIN_M = 40.0  # the search along the net ends at twice the straight-line distance plus this
_SEARCH_STEP_M = 50.0  # search limits are rounded up to a multiple of this, so that results can be reused


@dataclass(frozen=True)
class _State:
    """An edge that a point may lie on, the arc length along it, and the emission cost."""

    edge: str
    s_m: float
    cost: float


@dataclass
class _Trellis:
    """A stretch of connected points: the states of each, their accumulated costs and their best predecessors."""

    states: list[list[_State]]
    costs: list[FloatArray]
    predecessors: list[list[int]]


class RouteMatcher:
    """Matches trajectories of one vehicle class to the edges of a net."""

    def __init__(self, graph: LaneGraph, index: LaneIndex, allowed: BoolArray) -> None:
        self._graph = graph
        self._index = index
        self._allowed = allowed
        permitted = {name for name, ok in zip(index.lane_ids, allowed, strict=True) if ok}
        self._successors = _edge_successors(graph, permitted)
        self._searches: dict[tuple[str, int], tuple[dict[str, float], dict[str, str]]] = {}

    def match(self, xy_m: FloatArray, yaw_rad: FloatArray) -> tuple[str, ...] | None:
        """Return the edges driven along, in order and without internal ones; None if no point is near a lane.

        If the net does not connect all points, the stretch with the most points is used. A trajectory that begins or
        ends on a junction also gets the edge before or after the junction.

        Args:
            xy_m: (T, 2) positions; rows with NaN are left out.
            yaw_rad: (T,) headings.
        """
        keep = _sparse(xy_m, yaw_rad)
        xy, yaw = xy_m[keep], yaw_rad[keep]
        stretches = self._stretches(xy, self._states(xy, yaw))
        if not stretches:
            return None
        return self._route(max(stretches, key=lambda t: len(t.states)))

    def _states(self, xy_m: FloatArray, yaw_rad: FloatArray) -> list[list[_State]]:
        """Return the possible states of each point, at most one an edge."""
        candidates = self._index.candidates(xy_m, MAX_DISTANCE_M)
        error = np.abs(wrap_angle(yaw_rad[candidates.point] - candidates.yaw_rad))
        candidates = candidates.rows(self._allowed[candidates.lane] & (error < _MAX_YAW_ERROR_RAD))
        cost = candidate_cost(candidates, yaw_rad)
        cheapest: list[dict[str, _State]] = [{} for _ in xy_m]
        for point, lane, s, c in zip(candidates.point, candidates.lane, candidates.s_m, cost, strict=True):
            edge = self._graph.lanes[self._index.lane_ids[lane]].edge_id
            previous = cheapest[point].get(edge)
            if previous is None or c < previous.cost:
                cheapest[point][edge] = _State(edge, float(s), float(c))
        return [list(states.values()) for states in cheapest]

    def _stretches(self, xy_m: FloatArray, states: list[list[_State]]) -> list[_Trellis]:
        """Return the stretches of points that the net connects, each with its Viterbi tables."""
        stretches: list[_Trellis] = []
        last_point = -1
        for point, point_states in enumerate(states):
            if not point_states:
                continue
            emission = np.array([state.cost for state in point_states])
            if stretches:
                trellis = stretches[-1]
                straight_m = float(np.hypot(*(xy_m[point] - xy_m[last_point])))
                transition = self._transitions(trellis.states[-1], point_states, straight_m)
                costs = transition + trellis.costs[-1][:, None]
                if np.isfinite(costs).any():
                    trellis.states.append(point_states)
                    trellis.predecessors.append([int(i) for i in costs.argmin(axis=0)])
                    trellis.costs.append(costs.min(axis=0) + emission)
                    last_point = point
                    continue
            stretches.append(_Trellis([point_states], [emission], [[-1] * len(point_states)]))
            last_point = point
        return stretches

    def _transitions(self, old: list[_State], new: list[_State], straight_m: float) -> FloatArray:
        """Return the costs (len(old), len(new)) of driving from each old state to each new one; inf if impossible."""
        return np.array(
            [[abs(self._driven_m(a, b, straight_m) - straight_m) / _DETOUR_SCALE_M for b in new] for a in old]
        )

    def _driven_m(self, a: _State, b: _State, straight_m: float) -> float:
        """Return the distance from *a* to *b* along the net; negative for a short backward motion on one edge."""
        if a.edge == b.edge and b.s_m - a.s_m > -_BACKWARD_M:
            return b.s_m - a.s_m
        to_end_m = max(0.0, self._graph.edges[a.edge].length_m - a.s_m)
        limit_m = 2.0 * straight_m + _SEARCH_MARGIN_M
        return to_end_m + self._reach(a.edge, limit_m)[0].get(b.edge, np.inf) + b.s_m

    def _reach(self, edge: str, limit_m: float) -> tuple[dict[str, float], dict[str, str]]:
        """Return the result of :meth:`_search` from *edge* within about *limit_m*; results are kept."""
        key = (edge, int(np.ceil(limit_m / _SEARCH_STEP_M)))
        if key not in self._searches:
            self._searches[key] = self._search(edge, _SEARCH_STEP_M * key[1])
        return self._searches[key]

    def _search(self, start: str, limit_m: float) -> tuple[dict[str, float], dict[str, str]]:
        """Return edge → metres from the end of *start* to its beginning, and edge → predecessor (Dijkstra)."""
        distance_m: dict[str, float] = {}
        predecessors: dict[str, str] = {}
        queue = [(0.0, edge, start) for edge in self._successors.get(start, ())]
        while queue:
            begin_m, edge, origin = heapq.heappop(queue)
            if edge in distance_m or begin_m > limit_m:
                continue
            distance_m[edge], predecessors[edge] = begin_m, origin
            end_m = begin_m + self._graph.edges[edge].length_m
            for successor in self._successors.get(edge, ()):
                heapq.heappush(queue, (end_m, successor, edge))
        return distance_m, predecessors

    def _route(self, trellis: _Trellis) -> tuple[str, ...]:
        """Return the edges of the cheapest sequence of states, without internal ones."""
        reversed_edges: list[str] = []
        row = int(np.argmin(trellis.costs[-1]))
        for point in range(len(trellis.states) - 1, -1, -1):
            state = trellis.states[point][row]
            previous_row = trellis.predecessors[point][row]
            reversed_edges.append(state.edge)
            if point > 0:
                reversed_edges += self._between(trellis.states[point - 1][previous_row], state)
            row = previous_row
        edges = self._with_ends([edge for edge, _ in groupby(reversed(reversed_edges))])
        return tuple(e for e in edges if not self._graph.edges[e].is_internal)

    def _between(self, a: _State, b: _State) -> list[str]:
        """Return the edges strictly between two states, in reverse order."""
        if a.edge == b.edge and b.s_m - a.s_m > -_BACKWARD_M:
            return []
        limits = sorted(n for (edge, n), (to, _) in self._searches.items() if edge == a.edge and b.edge in to)
        _, predecessors = self._searches[(a.edge, limits[0])]
        edges: list[str] = []
        edge = predecessors[b.edge]
        while edge != a.edge:
            edges.append(edge)
            edge = predecessors[edge]
        return edges

    def _with_ends(self, edges: list[str]) -> list[str]:
        """Extend *edges* by the edge before or after a junction if they begin or end on one."""
        for _ in range(2):  # a link has at most two internal edges
            if self._graph.edges[edges[0]].is_internal:
                origins = [e for e, successors in self._successors.items() if edges[0] in successors]
                edges = [*origins[:1], *edges]
            if self._graph.edges[edges[-1]].is_internal:
                edges = [*edges, *self._successors.get(edges[-1], ())[:1]]
        return edges


def _edge_successors(graph: LaneGraph, permitted: set[str]) -> Mapping[str, tuple[str, ...]]:
    """Return edge → edges that directly follow it, internal ones included; only by *permitted* lanes."""
    successors: dict[str, dict[str, None]] = {}
    for lane in graph.lanes.values():
        if lane.id not in permitted:
            continue
        for link in lane.successors:
            if link.to_lane in permitted:
                edges = [
                    graph.lanes[x].edge_id for x in (lane.id, *link.via, link.to_lane) if x in graph.lanes
                ]
                for edge, successor in pairwise(edges):
                    successors.setdefault(edge, {})[successor] = None
    return {edge: tuple(own_successors) for edge, own_successors in successors.items()}


def _sparse(xy_m: FloatArray, yaw_rad: FloatArray) -> list[int]:
    """Return the rows to use: finite ones that are at least :data:`SPACING_M` apart."""
    keep: list[int] = []
    finite = np.isfinite(xy_m).all(axis=1) & np.isfinite(yaw_rad)
    for row in np.flatnonzero(finite):
        if not keep or np.hypot(*(xy_m[row] - xy_m[keep[-1]])) >= SPACING_M:
            keep.append(int(row))
    return keep
