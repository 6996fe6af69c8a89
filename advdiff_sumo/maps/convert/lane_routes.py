"""Routes over edges that no car can drive, as no lane and no permitted lane change leads along them."""

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

CHANGE_M = 5.0  # on an edge shorter than a car, who merges behind it cannot foresee a lane change
State = tuple[str, frozenset[int]]


@dataclass
class RouteLanes:
    """Lanes of each edge and where they lead.

    Attributes:
        changes: by edge, for each lane the lanes next to it that may be changed to.
        links: by edge and next edge the pairs of lanes that are connected.
    """

    changes: dict[str, list[set[int]]] = field(default_factory=dict)
    links: dict[str, dict[str, set[tuple[int, int]]]] = field(default_factory=lambda: defaultdict(dict))

    def add_link(self, origin: tuple[str, int], target: tuple[str, int]) -> None:
        """Connect two lanes."""
        self.links[origin[0]].setdefault(target[0], set()).add((origin[1], target[1]))

    def within_reach(self, edge: str, lanes: Iterable[int]) -> frozenset[int]:
        """Return the lanes of *edge* that can be had from *lanes* by permitted changes."""
        reached, todo = set(lanes), list(lanes)
        while todo:
            new = self.changes[edge][todo.pop()] - reached
            reached |= new
            todo += new
        return frozenset(reached)

    def parts(self, edge: str) -> list[list[int]]:
        """Return the lanes of *edge* in groups within which each lane can be changed to the next and back."""
        groups: list[list[int]] = []
        for lane, after in enumerate(self.changes[edge]):
            before = lane - 1
            if groups and before in after and lane in self.changes[edge][before]:
                groups[-1].append(lane)
            else:
                groups.append([lane])
        return groups


def undrivable_routes(graph: RouteLanes) -> list[tuple[str, ...]]:
    """Return edge routes, each step of which is connected, that no sequence of lanes follows.

    Each is as short as can be: without its first or its last edge it could be driven. One is given for each way
    of getting stuck.
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
        for after, pairs in sorted(graph.links.get(edge, {}).items()):
            entered = frozenset(b for a, b in pairs if a in lanes)
            if not entered:
                stuck[(*_way(origin, state), after)] = None
            elif (after, entered) not in origin:
                origin[after, entered] = state
                queue.append((after, entered))
    return list(stuck)


def _way(origin: Mapping[State, State | None], state: State) -> tuple[str, ...]:
    way: list[str] = []
    here: State | None = state
    while here is not None:
        way.append(here[0])
        here = origin[here]
    return tuple(way[::-1])


def graph_of_plan(plan: NetPlan) -> RouteLanes:
    """Return the lanes of a net as planned."""
    graph = RouteLanes({edge.id: _planned_changes(edge) for edge in plan.edges})
    for connection in plan.connections:
        graph.add_link(connection.origin, connection.target)
    return graph


def _planned_changes(edge: EdgePlan) -> list[set[int]]:
    if edge.length_m < CHANGE_M:
        return [set() for _ in edge.lanes]
    last = len(edge.lanes) - 1
    return [_beside(n, last, lane.no_change_up, lane.no_change_down) for n, lane in enumerate(edge.lanes)]


def _beside(lane: int, last: int, not_up: bool, not_down: bool) -> set[int]:
    up = {lane + 1} if lane < last and not not_up else set()
    return up | ({lane - 1} if lane > 0 and not not_down else set())


def graph_of_net(net: Path) -> RouteLanes:
    """Return the lanes of a written net."""
    root: Any = ElementTree.fromstring(net.read_bytes())
    graph = RouteLanes()
    for edge in root.iter("edge"):
        if edge.get("function", "") == "" and edge.get("type") != BEYOND_TYPE:
            rows = edge.findall("lane")
            graph.changes[edge.attrib["id"]] = [
                _beside(
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
    """Return the edges on which an undrivable route gets stuck and whose lanes could be edges of their own."""
    blocked = {route[-2] for route in undrivable_routes(graph)}
    return sorted(edge for edge in blocked if len(graph.parts(edge)) > 1)


def plan_drivable(tracks: list[Track], layout: Layout, ways: list[LaneConnection], lefthand: bool) -> NetPlan:
    """Return the net of *layout*; lanes that may not be changed become edges of their own where routes get stuck.

    SUMO's routes are made of edges, so an edge whose lanes lead to different places and may not be changed invites
    routes that nobody can drive. *layout* gets the new groups.
    """
    while True:
        plan = plan_net(tracks, layout, ways, lefthand)
        graph = graph_of_plan(plan)
        edges = edges_to_part(graph)
        if not edges:
            return plan
        by_id = {edge.id: edge for edge in plan.edges}
        for name in edges:
            number = int(name[1:])
            pieces = [[by_id[name].lanes[n].piece for n in part] for part in graph.parts(name)]
            ordered = [part[::-1] if lefthand else part for part in pieces]
            layout.groups[number] = ordered[0]
            layout.groups += ordered[1:]
            layout.counts["edges parted as routes got stuck on their lanes"] += 1
