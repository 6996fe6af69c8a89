"""Find lanes to drive along: chains that follow a route, and plausible chains where none is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import TypeAlias

from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.maps import Link, RoadMap
from advdiff_sumo.maps.lanes import SIDES, lanes_beside

_MAX_EFFORT = 99.0  # of a lane from which the route cannot be followed
_SHORT_EDGE_M = 40.0  # on an edge of this length, a lane change costs twice the effort
_EDGES_AHEAD = 6  # of another vehicle's route
_MAX_LANES = 40  # of a chain

Changes: TypeAlias = Mapping[tuple[int, str], tuple[float, int]]
"""(Index in the route, lane) → effort along the route, signed lane changes on that edge (left positive)."""


@dataclass(frozen=True)
class Chain:
    """Lanes in driving order.

    Attributes:
        lanes: lane ids, internal ones included.
        links: connections over junctions between them.
        follows_route: False if the route cannot be followed beyond the last lane without a lane change.
        changes: signed lane changes (left positive) that the route needs on the first edge; 0 for none.
    """

    lanes: tuple[str, ...]
    links: tuple[Link, ...]
    follows_route: bool = True
    changes: int = 0


def required_changes(road: RoadMap, edges: Sequence[str]) -> Changes:
    """Return, for each (index in *edges*, lane), the effort along the route and the signed lane changes on that edge.

    Dynamic programming from the end of the route backwards. The effort is the number of lane changes. Changes on
    short edges count more, so that they are made earlier. A lane from which the route cannot be reached gets a
    high effort.
    """
    needed: dict[tuple[int, str], tuple[float, int]] = {}
    for k in range(len(edges) - 1, -1, -1):
        lanes = [lane for lane in road.edges[edges[k]].lane_ids if road.lanes[lane].permits("passenger")]
        onward = {lane: _effort_beyond(road, lane, k, edges, needed) for lane in lanes}
        effort = 1.0 + _SHORT_EDGE_M / max(road.edges[edges[k]].length_m, 1.0)
        for lane in lanes:
            needed[k, lane] = min(
                ((effort * abs(n) + onward[target], n) for target, n in _lanes_beside(road, lane, lanes)),
                key=lambda option: (option[0], abs(option[1])),
            )
    return needed


def _effort_beyond(road: RoadMap, lane: str, k: int, edges: Sequence[str], needed: Changes) -> float:
    """Return the least effort from the end of *lane* on edge *k* to the end of the route."""
    if k == len(edges) - 1:
        return 0.0
    links = _links_to(road, lane, edges[k + 1])
    return min((needed.get((k + 1, x.to_lane), (_MAX_EFFORT, 0))[0] for x in links), default=_MAX_EFFORT)


def _lanes_beside(road: RoadMap, lane: str, lanes: Sequence[str]) -> list[tuple[str, int]]:
    """Return each lane that lane changes can reach, with their signed number (left positive)."""
    reached = [(lane, 0)]
    for side, sign in zip(SIDES, (1, -1), strict=True):
        beside = takewhile(lambda x: x.id in lanes, lanes_beside(road.lanes, lane, side))
        reached += [(x.id, sign * count) for count, x in enumerate(beside, 1)]
    return reached


def _links_to(road: RoadMap, lane: str, edge: str) -> list[Link]:
    """Return the connections from *lane* to *edge*."""
    return [x for x in road.lanes[lane].successors if road.lanes[x.to_lane].edge_id == edge]


def route_chain(
    road: RoadMap,
    start: str,
    route: Sequence[str],
    needed: Changes,
    reach_m: float,
) -> Chain:
    """Return the chain from lane *start* (on the first edge of *route*, or on the junction before it).

    Beyond the end of the route the chain takes the straightest connections. It ends early where a lane has no
    connection to the next edge of the route.

    Args:
        road: the map.
        start: first lane; an internal lane leads to ``route[0]``.
        route: edges ahead.
        needed: result of :func:`required_changes` for the same route.
        reach_m: length after which the chain may end.
    """
    lanes, links, follows_route = [start], list[Link](), True
    changes = needed.get((0, start), (0, 0))[1]
    length, k, lane = road.lanes[start].length_m, 0, start
    if road.lanes[start].is_internal:
        k = -1
    while length < reach_m and len(lanes) < _MAX_LANES:
        link = _next_link(road, lane, k, route, needed)
        if link is None:
            follows_route = k >= len(route) - 1
            break
        lane, k = link.to_lane, k + 1
        via = (
            link.via
            if not road.lanes[lanes[-1]].is_internal
            else tuple(v for v in link.via if v not in lanes)
        )
        lanes += [*via, lane]
        links.append(link)
        length += sum(road.lanes[v].length_m for v in (*via, lane))
    return Chain(tuple(lanes), tuple(links), follows_route, changes)


def _next_link(
    road: RoadMap,
    lane: str,
    k: int,
    route: Sequence[str],
    needed: Changes,
) -> Link | None:
    """Return the connection from *lane* on edge *k* that needs the least effort; None if there is none."""
    if k < len(route) - 1:
        links = _links_to(road, lane, route[k + 1])
        return min(links, key=lambda x: needed.get((k + 1, x.to_lane), (_MAX_EFFORT, 0))[0], default=None)
    links = list(road.lanes[lane].successors)
    return min(links, key=lambda x: _turn_rad(road, lane, x), default=None)


def _turn_rad(road: RoadMap, lane: str, link: Link) -> float:
    """Return the turn of *link*; 0.1 more if the net does not call it straight."""
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
    """Return the chains that a vehicle on lane *start* may drive within *reach_m*; one only if its *route* fits.

    At the first junction, every connection is one chain. Beyond it, each takes the straightest connections.

    Args:
        road: the map.
        start: lane on which the vehicle is.
        route: edges of its route.
        reach_m: length after which a chain may end.
        changes: returns the :func:`required_changes` of edges, from a cache; None: compute them here.
    """
    lane = road.lanes[start]
    edge = lane.edge_id if not lane.is_internal else road.lanes[lane.successors[0].to_lane].edge_id
    if edge in route:
        ahead = list(route)[route.index(edge) :][:_EDGES_AHEAD]
        needed = required_changes(road, ahead) if changes is None else changes(ahead)
        chain = route_chain(road, start, ahead, needed, reach_m)
        if chain.follows_route:
            return [chain]
    branches = [x for x in lane.successors if not x.turns_round] or list(lane.successors)
    if lane.length_m >= reach_m or not branches:
        return [Chain((start,), ())]
    return [_chain_over(road, start, link, reach_m) for link in branches]


def _chain_over(road: RoadMap, start: str, link: Link, reach_m: float) -> Chain:
    """Return the chain over *link* and the straightest connections beyond it."""
    beyond = route_chain(road, link.to_lane, (), {}, max(reach_m - road.lanes[start].length_m, 1.0))
    via = tuple(v for v in link.via if v != start)
    return Chain((start, *via, *beyond.lanes), (link, *beyond.links))


def detour(road: RoadMap, lane_id: str, goal: str) -> tuple[str, ...]:
    """Return the shortest of the routes to *goal* over a connection of *lane_id* itself; () for none.

    The first edge is the lane's own. If no connection leads to *goal*, one edge beyond the lane is returned.
    """
    edge = road.lanes[lane_id].edge_id
    exits = sorted(
        {road.lanes[x.to_lane].edge_id for x in road.lanes[lane_id].successors if not x.turns_round}
    )
    routes = [edges for e in exits if (edges := road.route(e, goal)) is not None] or [(e,) for e in exits]
    shortest = min(routes, key=lambda edges: sum(road.edges[e].length_m for e in edges), default=())
    return (edge, *shortest) if shortest else ()


def route_ahead(road: RoadMap, lane_id: str, route: Sequence[str]) -> tuple[str, ...]:
    """Return the edges ahead of a vehicle on *lane_id* whose remaining route is *route*.

    On an internal lane, they begin with the edge beyond the junction. Off the route, they are the quickest route
    to its last edge. If there is none, they are the present edge alone; () if not even that is known.
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
    """Return the rest of *route* from *edge* on, or the quickest route back to its last edge."""
    if edge in route:
        return tuple(route[route.index(edge) :])
    back = road.route(edge, route[-1]) if route and route[-1] in road.edges else None
    return back if back is not None else (edge,)
