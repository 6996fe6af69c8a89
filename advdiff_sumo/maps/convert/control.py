"""Who goes first: signals, stop signs and yield signs of the source, or a guess where it has none."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import shapely
from shapely.geometry import Point, Polygon

from advdiff_sumo.maps.convert.narrow import long_conflicts
from advdiff_sumo.maps.convert.netplan import EdgePlan, NetPlan
from advdiff_sumo.maps.convert.roundabouts import find_rings
from advdiff_sumo.maps.convert.sources.source_map import SourceMap

NEAR_M = 6.0  # a stop line or light within this of the end of a lane is that lane's
GUESS_APPROACHES, GUESS_LANES = 3, 4  # junctions at least so large get guessed signals
MAJOR, MINOR = 10, 1  # edge priorities: without and with a stop or yield sign


@dataclass(frozen=True)
class Control:
    """Approaches of each kind, by edge."""

    lights: frozenset[str]
    stops: frozenset[str]
    yields: frozenset[str]


def with_control(plan: NetPlan, source: SourceMap, guess_signals: bool) -> NetPlan:
    """Return *plan* with junction kinds and edge priorities set.

    A junction with a light on one of its approaches is signalled. Stop signs on all approaches make an all-way
    stop, on some of them (and yield signs) those approaches yield. With *guess_signals* junctions of at least
    three approaches with four lanes, whose ways cross, are signalled too, but for those of roundabouts. Signals serve
    opposite approaches together unless ways of theirs run along each other.
    """
    control = _read(plan.edges, source)
    approaches: dict[str, list[EdgePlan]] = defaultdict(list)
    for edge in plan.edges:
        approaches[edge.target].append(edge)
    rings = find_rings(plan)
    round_about = {name for ring in rings for name in ring.junctions}
    crossing = _crossing(plan) - round_about if guess_signals else set()
    kinds = {
        name: _kind([edge.id for edge in edges], control)
        or ("traffic_light" if name in crossing and _is_large(edges) else None)
        for name, edges in approaches.items()
    }
    minor = control.stops | control.yields
    long = long_conflicts(plan)
    return replace(
        plan,
        edges=tuple(replace(edge, priority=MINOR if edge.id in minor else MAJOR) for edge in plan.edges),
        junctions=tuple(
            replace(j, kind=kinds.get(j.id) or j.kind, one_by_one=j.id in long) if j.kind == "priority" else j
            for j in plan.junctions
        ),
        rings=rings,
    )


def _read(edges: tuple[EdgePlan, ...], source: SourceMap) -> Control:
    """Return which edges end at a light, a stop sign or a yield sign."""
    found: dict[str, set[str]] = {"light": set(), "stop": set(), "yield": set()}
    ends = [shapely.Point(lane.shape_m[-1]) for edge in edges for lane in edge.lanes]
    owner = [edge.id for edge in edges for _ in edge.lanes]
    places: list[tuple[str, Point | Polygon]] = [("light", signal.at) for signal in source.signals]
    places += [(kind, line.area) for line in source.stop_lines if (kind := _sign(line.kind))]
    tree = shapely.STRtree(ends)
    for kind, place in places:
        for number in tree.query(place, predicate="dwithin", distance=NEAR_M) if ends else ():
            found[kind].add(owner[int(number)])
    return Control(frozenset(found["light"]), frozenset(found["stop"]), frozenset(found["yield"]))


def _sign(kind: str) -> str | None:
    kind = kind.upper()
    if "TRAFFIC_LIGHT" in kind:
        return "light"
    return "stop" if kind == "STOP_SIGN" else "yield" if kind == "YIELD" else None


def _kind(edges: list[str], control: Control) -> str | None:
    if control.lights & set(edges):
        return "traffic_light"
    if len(edges) > 1 and set(edges) <= control.stops:
        return "allway_stop"
    return "priority_stop" if control.stops & set(edges) else None


def _is_large(edges: list[EdgePlan]) -> bool:
    return len(edges) >= GUESS_APPROACHES and sum(len(edge.lanes) for edge in edges) >= GUESS_LANES


def _crossing(plan: NetPlan) -> set[str]:
    """Return the junctions in which two ways cross."""
    target = {edge.id: edge.target for edge in plan.edges}
    lines: dict[str, list[shapely.LineString]] = defaultdict(list)
    for connection in plan.connections:
        lines[target[connection.origin[0]]].append(shapely.LineString(connection.shape_m))
    return {
        name for name, own in lines.items() if len(shapely.STRtree(own).query(own, predicate="crosses")[0])
    }
