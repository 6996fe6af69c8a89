"""Find routes over edges that no sequence of lanes and permitted lane changes follows, and remove them."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from defusedxml import ElementTree

from advdiff_sumo.maps.convert.layout.lane_paths import LaneConnection
from advdiff_sumo.maps.convert.layout.layout_state import Layout
from advdiff_sumo.maps.convert.netplan import EdgePlan, NetPlan, Track, plan_net
from advdiff_sumo.maps.read_net import BEYOND_TYPE

# Edges shorter than a car allow no lane change: vehicles that merge behind such an edge cannot foresee it.
CHANGE_M = 5.0
State = tuple[str, frozenset[int]]  # an edge, and the lanes on which a route can enter it


@dataclass
class RouteLanes:
    """Permitted lane changes on each edge and connections between lanes.

    Attributes:
        changes: by edge, for each lane the neighbouring lanes to which a change is permitted.
        links: by edge and next edge, the pairs of lanes that are connected.
    """

    changes: dict[str, list[set[int]]] = field(default_factory=dict)
    links: dict[str, dict[str, set[tuple[int, int]]]] = field(default_factory=lambda: defaultdict(dict))

    def add_link(self, origin: tuple[str, int], target: tuple[str, int]) -> None:
        """Connect two lanes."""
        self.links[origin[0]].setdefault(target[0], set()).add((origin[1], target[1]))

    def within_reach(self, edge: str, lanes: Iterable[int]) -> frozenset[int]:
        """Return the lanes of *edge* that can be reached from *lanes* by permitted lane changes."""
        reached, queue = set(lanes), list(lanes)
        while queue:
            new = self.changes[edge][queue.pop()] - reached
            reached |= new
            queue += new
        return frozenset(reached)

    def parts(self, edge: str) -> list[list[int]]:
        """Return the lanes of *edge* in groups; within a group, changes are permitted in both directions."""
        groups: list[list[int]] = []
        for lane, targets in enumerate(self.changes[edge]):
            before = lane - 1
            if groups and before in targets and lane in self.changes[edge][before]:
                groups[-1].append(lane)
            else:
                groups.append([lane])
        return groups


def undrivable_routes(graph: RouteLanes) -> list[tuple[str, ...]]:
    """Return routes of connected edges that no sequence of lanes follows.

    Each route is as short as possible: without its first or its last edge it could be driven. Of the routes that get
    stuck in the same state (edge and lanes that can be entered), only one is returned.
    """
    origin: dict[State, State | None] = {}
    queue: deque[State] = deque()
    for edge in sorted(graph.changes):
        start = (edge, frozenset(range(len(graph.changes[edge]))))
        origin[start] = None
        queue.append(start)
    stuck: dict[tuple[str, ...], None] = {}
    while queue:
        state = queue.popleft()
        edge, lanes = state[0], graph.within_reach(*state)
        for next_edge, pairs in sorted(graph.links.get(edge, {}).items()):
            entered = frozenset(b for a, b in pairs if a in lanes)
            if not entered:
                stuck[(*_route_to(origin, state), next_edge)] = None
            elif (next_edge, entered) not in origin:
                origin[next_edge, entered] = state
                queue.append((next_edge, entered))
    return list(stuck)


def _route_to(origin: Mapping[State, State | None], state: State) -> tuple[str, ...]:
    """Return the edges that the search passed up to *state*."""
    edges: list[str] = []
    current: State | None = state
    while current is not None:
        edges.append(current[0])
        current = origin[current]
    return tuple(edges[::-1])


def graph_of_plan(plan: NetPlan) -> RouteLanes:
    """Return the lane graph of a planned net."""
    graph = RouteLanes({edge.id: _planned_changes(edge) for edge in plan.edges})
    for connection in plan.connections:
        graph.add_link(connection.origin, connection.target)
    return graph


def _planned_changes(edge: EdgePlan) -> list[set[int]]:
    if edge.length_m < CHANGE_M:
        return [set() for _ in edge.lanes]
    last = len(edge.lanes) - 1
    return [_targets(n, last, lane.no_change_up, lane.no_change_down) for n, lane in enumerate(edge.lanes)]


def _targets(lane: int, last: int, no_change_up: bool, no_change_down: bool) -> set[int]:
    """Return the lanes to which a change from *lane* is permitted; *last* is the highest lane index."""
    up = {lane + 1} if lane < last and not no_change_up else set()
    return up | ({lane - 1} if lane > 0 and not no_change_down else set())


def graph_of_net(net: Path) -> RouteLanes:
    """Return the lane graph of a written net, without return edges and streets beyond the rim."""
    root: Any = ElementTree.fromstring(net.read_bytes())
    graph = RouteLanes()
    for edge in root.iter("edge"):
        if edge.get("function", "") == "" and edge.get("type") != BEYOND_TYPE:
            rows = edge.findall("lane")
            graph.changes[edge.attrib["id"]] = [
                _targets(
                    n, len(rows) - 1, row.get("changeLeft") is not None, row.get("changeRight") is not None
                )
                for n, row in enumerate(rows)
            ]
    for row in root.iter("connection"):
        origin, target = row.attrib["from"], row.attrib["to"]
        if origin in graph.changes and target in graph.changes:
            graph.add_link((origin, int(row.attrib["fromLane"])), (target, int(row.attrib["toLane"])))
    return graph


def edges_to_part(graph: RouteLanes) -> list[str]:
    """Return the edges on which an undrivable route gets stuck and whose lanes can be divided among several edges."""
    blocked = {route[-2] for route in undrivable_routes(graph)}
    return sorted(edge for edge in blocked if len(graph.parts(edge)) > 1)


def plan_drivable(
    tracks: list[Track], layout: Layout, connections: list[LaneConnection], lefthand: bool
) -> NetPlan:
    """Return the planned net of *layout*, with edges divided where a route over them cannot be driven.

    SUMO's routes consist of edges. If the lanes of an edge lead to different edges and lane changes between them are
    forbidden, a route over the edge may be impossible to drive. Such lanes become edges of their own. *layout* is
    changed: it gets the new groups.
    """
    while True:
        plan = plan_net(tracks, layout, connections, lefthand)
        graph = graph_of_plan(plan)
        edges = edges_to_part(graph)
        if not edges:
            return plan
        for name in edges:
            number = int(name[1:])
            pieces = [[plan.edge_of[name].lanes[n].piece for n in part] for part in graph.parts(name)]
            ordered = [part[::-1] if lefthand else part for part in pieces]
            layout.groups[number] = ordered[0]
            layout.groups += ordered[1:]
            layout.counts["edges parted as routes got stuck on their lanes"] += 1
