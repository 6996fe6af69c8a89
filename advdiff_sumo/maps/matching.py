"""Map matching: the edges that a recorded trajectory drove.

A hidden Markov model over edges (Newson and Krumm 2009, doi:10.1145/1653771.1653818), with heading in the
emission: states are edges near a point, internal ones included; a transition costs the difference between the
way along the net and the way as the crow flies.
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
"""Points nearer to the last used one than this are left out: they say nothing new."""
MAX_DISTANCE_M = 6.0
_MAX_YAW_ERROR_RAD = 1.75
_DETOUR_SCALE_M = 3.0
_BACK_M = 6.0
_SLACK_M = 40.0


@dataclass(frozen=True)
class _State:
    """An edge that a point may lie on: where along it, and the cost of that."""

    edge: str
    s_m: float
    cost: float


@dataclass
class _Trellis:
    """Points that hang together: states, costs so far, and the best state before each."""

    states: list[list[_State]]
    costs: list[FloatArray]
    before: list[list[int]]


class RouteMatcher:
    """Matches trajectories of one vehicle class to the edges of a net."""

    def __init__(self, graph: LaneGraph, index: LaneIndex, allowed: BoolArray) -> None:
        self._graph = graph
        self._index = index
        self._allowed = allowed
        permitted = {name for name, ok in zip(index.lane_ids, allowed, strict=True) if ok}
        self._onward = _edges_onward(graph, permitted)
        self._reached: dict[tuple[str, int], tuple[dict[str, float], dict[str, str]]] = {}

    def match(self, xy_m: FloatArray, yaw_rad: FloatArray) -> tuple[str, ...] | None:
        """Return the edges driven, without internal ones, in order; None when no point lies near a lane.

        Where the way breaks off (a gap that the net does not join), the stretch with the most points counts.
        A trajectory that begins or ends on a junction gets the edge before or after it as well.

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
        candidates = self._index.candidates(xy_m, MAX_DISTANCE_M)
        error = np.abs(wrap_angle(yaw_rad[candidates.point] - candidates.yaw_rad))
        candidates = candidates.rows(self._allowed[candidates.lane] & (error < _MAX_YAW_ERROR_RAD))
        cost = candidate_cost(candidates, yaw_rad)
        best: list[dict[str, _State]] = [{} for _ in xy_m]
        for point, lane, s, c in zip(candidates.point, candidates.lane, candidates.s_m, cost, strict=True):
            edge = self._graph.lanes[self._index.lane_ids[lane]].edge_id
            known = best[point].get(edge)
            if known is None or c < known.cost:
                best[point][edge] = _State(edge, float(s), float(c))
        return [list(states.values()) for states in best]

    def _stretches(self, xy_m: FloatArray, states: list[list[_State]]) -> list[_Trellis]:
        """Return the stretches of points that hang together, each with its Viterbi tables."""
        stretches: list[_Trellis] = []
        last = -1
        for point, now in enumerate(states):
            if not now:
                continue
            emission = np.array([state.cost for state in now])
            if stretches:
                trellis = stretches[-1]
                apart = float(np.hypot(*(xy_m[point] - xy_m[last])))
                steps = self._transitions(trellis.states[-1], now, apart) + trellis.costs[-1][:, None]
                if np.isfinite(steps).any():
                    trellis.states.append(now)
                    trellis.before.append([int(i) for i in steps.argmin(axis=0)])
                    trellis.costs.append(steps.min(axis=0) + emission)
                    last = point
                    continue
            stretches.append(_Trellis([now], [emission], [[-1] * len(now)]))
            last = point
        return stretches

    def _transitions(self, old: list[_State], new: list[_State], apart_m: float) -> FloatArray:
        """Return the costs (len(old), len(new)) of driving from each state to each; inf where impossible."""
        return np.array(
            [[abs(self._way(a, b, apart_m) - apart_m) / _DETOUR_SCALE_M for b in new] for a in old]
        )

    def _way(self, a: _State, b: _State, apart_m: float) -> float:
        """Return the metres from *a* to *b* along the net; a little backwards is noise, and costs its length."""
        if a.edge == b.edge and b.s_m - a.s_m > -_BACK_M:
            return b.s_m - a.s_m
        rest = max(0.0, self._graph.edges[a.edge].length_m - a.s_m)
        limit = 2.0 * apart_m + _SLACK_M
        return rest + self._reach(a.edge, limit)[0].get(b.edge, np.inf) + b.s_m

    def _reach(self, edge: str, limit_m: float) -> tuple[dict[str, float], dict[str, str]]:
        """Return metres from the end of *edge* to the start of each edge within about *limit_m*, and the way."""
        key = (edge, int(np.ceil(limit_m / 50.0)))
        if key not in self._reached:
            self._reached[key] = self._search(edge, 50.0 * key[1])
        return self._reached[key]

    def _search(self, start: str, limit_m: float) -> tuple[dict[str, float], dict[str, str]]:
        metres: dict[str, float] = {}
        before: dict[str, str] = {}
        queue = [(0.0, edge, start) for edge in self._onward.get(start, ())]
        while queue:
            away, edge, origin = heapq.heappop(queue)
            if edge in metres or away > limit_m:
                continue
            metres[edge], before[edge] = away, origin
            beyond = away + self._graph.edges[edge].length_m
            for following in self._onward.get(edge, ()):
                heapq.heappush(queue, (beyond, following, edge))
        return metres, before

    def _route(self, trellis: _Trellis) -> tuple[str, ...]:
        chosen: list[str] = []
        row = int(np.argmin(trellis.costs[-1]))
        for point in range(len(trellis.states) - 1, -1, -1):
            state = trellis.states[point][row]
            row_before = trellis.before[point][row]
            chosen.append(state.edge)
            if point > 0:
                chosen += self._between(trellis.states[point - 1][row_before], state)
            row = row_before
        full = self._with_ends([edge for edge, _ in groupby(reversed(chosen))])
        return tuple(e for e in full if not self._graph.edges[e].is_internal)

    def _between(self, a: _State, b: _State) -> list[str]:
        """Return the edges strictly between two states, the last first."""
        if a.edge == b.edge and b.s_m - a.s_m > -_BACK_M:
            return []
        limits = sorted(n for (edge, n), (to, _) in self._reached.items() if edge == a.edge and b.edge in to)
        _, before = self._reached[(a.edge, limits[0])]
        way: list[str] = []
        edge = before[b.edge]
        while edge != a.edge:
            way.append(edge)
            edge = before[edge]
        return way

    def _with_ends(self, edges: list[str]) -> list[str]:
        """Extend a way that begins or ends on a junction to the edges around it."""
        for _ in range(2):  # a junction crossing has at most two internal edges
            if self._graph.edges[edges[0]].is_internal:
                origins = [e for e, onward in self._onward.items() if edges[0] in onward]
                edges = [*origins[:1], *edges]
            if self._graph.edges[edges[-1]].is_internal:
                edges = [*edges, *self._onward.get(edges[-1], ())[:1]]
        return edges


def _edges_onward(graph: LaneGraph, permitted: set[str]) -> Mapping[str, tuple[str, ...]]:
    """Return edge → edges that directly follow it, internal ones included."""
    onward: dict[str, dict[str, None]] = {}
    for lane in graph.lanes.values():
        if lane.id not in permitted:
            continue
        for link in lane.successors:
            if link.to_lane in permitted:
                way = [graph.lanes[x].edge_id for x in (lane.id, *link.via, link.to_lane) if x in graph.lanes]
                for edge, following in pairwise(way):
                    onward.setdefault(edge, {})[following] = None
    return {edge: tuple(following) for edge, following in onward.items()}


def _sparse(xy_m: FloatArray, yaw_rad: FloatArray) -> list[int]:
    """Return the rows to use: finite, and :data:`SPACING_M` apart."""
    keep: list[int] = []
    finite = np.isfinite(xy_m).all(axis=1) & np.isfinite(yaw_rad)
    for row in np.flatnonzero(finite):
        if not keep or np.hypot(*(xy_m[row] - xy_m[keep[-1]])) >= SPACING_M:
            keep.append(int(row))
    return keep
