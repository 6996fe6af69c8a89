"""Which lanes to drive: chains of lanes that serve a route, and plausible ones of vehicles without a known one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.maps import Link, RoadMap

_FAR_CHANGES = 99.0
_SHORT_EDGE_M = 40.0
_EDGES_AHEAD = 6
_MAX_LANES = 40


Changes: TypeAlias = Mapping[tuple[int, str], tuple[float, int]]
"""(Place in the route, lane) → effort along the route, signed changes of lanes on that edge (left positive)."""


@dataclass(frozen=True)
class Chain:
    """Lanes in driving order.

    Attributes:
        lanes: lane ids, internal ones included.
        links: the connections between them.
        serves: False when the route cannot be followed beyond the last lane without a change of lanes.
        changes: lane changes on the first edge, signed (left positive), that the route needs; 0 for none.
    """

    lanes: tuple[str, ...]
    links: tuple[Link, ...]
    serves: bool = True
    changes: int = 0


def required_changes(road: RoadMap, edges: Sequence[str]) -> Changes:
    """Return, for each (place in *edges*, lane), the effort along the route and the signed changes on that edge.

    Dynamic programming from the route's end backwards. The effort counts changes of lanes, those on short edges
    for more, so that they are made early; lanes from which no change helps get a high one.
    """
    needed: dict[tuple[int, str], tuple[float, int]] = {}
    for k in range(len(edges) - 1, -1, -1):
        lanes = [lane for lane in road.edges[edges[k]].lane_ids if road.lanes[lane].permits("passenger")]
        onward = {lane: _onward(road, lane, k, edges, needed) for lane in lanes}
        each = 1.0 + _SHORT_EDGE_M / max(road.edges[edges[k]].length_m, 1.0)
        for lane in lanes:
            needed[k, lane] = min(
                ((each * abs(a) + onward[other], a) for other, a in _sideways(road, lane, lanes)),
                key=lambda item: (item[0], abs(item[1])),
            )
    return needed


def _onward(
    road: RoadMap,
    lane: str,
    k: int,
    edges: Sequence[str],
    needed: Changes,
) -> float:
    if k == len(edges) - 1:
        return 0.0
    links = _links_to(road, lane, edges[k + 1])
    return min((needed.get((k + 1, x.to_lane), (_FAR_CHANGES, 0))[0] for x in links), default=_FAR_CHANGES)


def _sideways(road: RoadMap, lane: str, lanes: Sequence[str]) -> list[tuple[str, int]]:
    """Return every lane that can be reached sideways with its signed number of changes, left positive."""
    reached = [(lane, 0)]
    for sign in (1, -1):
        at, count = lane, 0
        while (beside := road.lanes[at].left_id if sign > 0 else road.lanes[at].right_id) in lanes:
            at, count = str(beside), count + 1
            reached.append((at, sign * count))
    return reached


def _links_to(road: RoadMap, lane: str, edge: str) -> list[Link]:
    return [x for x in road.lanes[lane].successors if road.lanes[x.to_lane].edge_id == edge]


def route_chain(
    road: RoadMap,
    start: str,
    route: Sequence[str],
    needed: Changes,
    reach_m: float,
) -> Chain:
    """Return the chain from lane *start* (on the first edge of *route*, or on the junction before it).

    Where the route ends, or has no connection from a lane that is the only choice, the straightest goes on.

    Args:
        road: the map.
        start: lane to begin on; an internal lane leads to ``route[0]``.
        route: edges ahead.
        needed: from :func:`required_changes` of the same route.
        reach_m: length after which the chain may end.
    """
    lanes, links, serves = [start], list[Link](), True
    changes = needed.get((0, start), (0, 0))[1]
    length, k, at = road.lanes[start].length_m, 0, start
    if road.lanes[start].is_internal:
        k = -1
    while length < reach_m and len(lanes) < _MAX_LANES:
        link = _next_link(road, at, k, route, needed)
        if link is None:
            serves = k >= len(route) - 1
            break
        at, k = link.to_lane, k + 1
        via = (
            link.via
            if not road.lanes[lanes[-1]].is_internal
            else tuple(v for v in link.via if v not in lanes)
        )
        lanes += [*via, at]
        links.append(link)
        length += sum(road.lanes[v].length_m for v in (*via, at))
    return Chain(tuple(lanes), tuple(links), serves, changes)


def _next_link(
    road: RoadMap,
    lane: str,
    k: int,
    route: Sequence[str],
    needed: Changes,
) -> Link | None:
    if k < len(route) - 1:
        links = _links_to(road, lane, route[k + 1])
        return min(links, key=lambda x: needed.get((k + 1, x.to_lane), (_FAR_CHANGES, 0))[0], default=None)
    links = list(road.lanes[lane].successors)
    return min(links, key=lambda x: _turn(road, lane, x), default=None)


def _turn(road: RoadMap, lane: str, link: Link) -> float:
    before = road.lanes[lane].line.segment_yaw_rad[-1]
    after = road.lanes[link.to_lane].line.segment_yaw_rad[0]
    return float(abs(wrap_angle(float(after - before)))) + (0.0 if link.direction == "s" else 0.1)


def plausible_chains(
    road: RoadMap,
    start: str,
    route: Sequence[str],
    reach_m: float,
    changes: Callable[[Sequence[str]], Changes] | None = None,
) -> list[Chain]:
    """Return the chains that a vehicle on lane *start* may take within *reach_m*; its *route* if that fits.

    At the first junction every connection is taken, beyond it the straightest one.

    Args:
        road: the map.
        start: lane that it is on.
        route: its edges.
        reach_m: length after which a chain may end.
        changes: knows the :func:`required_changes` of edges; None: they are worked out.
    """
    lane = road.lanes[start]
    edge = lane.edge_id if not lane.is_internal else road.lanes[lane.successors[0].to_lane].edge_id
    if edge in route:
        ahead = list(route)[route.index(edge) :][:_EDGES_AHEAD]
        needed = required_changes(road, ahead) if changes is None else changes(ahead)
        chain = route_chain(road, start, ahead, needed, reach_m)
        if chain.serves:
            return [chain]
    branches = [x for x in lane.successors if not x.turns_round] or list(lane.successors)
    if lane.length_m >= reach_m or not branches:
        return [Chain((start,), ())]
    return [_branch(road, start, link, reach_m) for link in branches]


def _branch(road: RoadMap, start: str, link: Link, reach_m: float) -> Chain:
    beyond = route_chain(road, link.to_lane, (), {}, max(reach_m - road.lanes[start].length_m, 1.0))
    via = tuple(v for v in link.via if v != start)
    return Chain((start, *via, *beyond.lanes), (link, *beyond.links))


def detour(road: RoadMap, lane_id: str, goal: str) -> tuple[str, ...]:
    """Return the quickest edges to *goal* by a connection of *lane_id* itself, its own edge first; () for none."""
    edge = road.lanes[lane_id].edge_id
    exits = sorted(
        {road.lanes[x.to_lane].edge_id for x in road.lanes[lane_id].successors if not x.turns_round}
    )
    ways = [way for e in exits if (way := road.route(e, goal)) is not None] or [(e,) for e in exits]
    shortest = min(ways, key=lambda way: sum(road.edges[e].length_m for e in way), default=())
    return (edge, *shortest) if shortest else ()


def route_ahead(road: RoadMap, lane_id: str, route: Sequence[str]) -> tuple[str, ...]:
    """Return the edges ahead of a vehicle on *lane_id* that has *route* left.

    For an internal lane, the edges from the one beyond the junction. Off the route, the way back to it: the
    quickest route to its last edge; () where there is none.
    """
    lane = road.lanes[lane_id]
    if not lane.is_internal:
        return _from_edge(road, lane.edge_id, route)
    exits = [road.lanes[x.to_lane].edge_id for x in lane.successors]
    for edge in exits:
        if edge in route:
            return tuple(route[route.index(edge) :])
    return _from_edge(road, exits[0], route) if exits else ()


def _from_edge(road: RoadMap, edge: str, route: Sequence[str]) -> tuple[str, ...]:
    if edge in route:
        return tuple(route[route.index(edge) :])
    back = road.route(edge, route[-1]) if route and route[-1] in road.edges else None
    return back if back is not None else (edge,)
