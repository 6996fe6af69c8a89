"""Who goes first: signals, stop signs and yield signs of the source, or a guess where it has none."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import shapely
from shapely.geometry import Polygon

from advdiff_sumo.maps.convert.approaches import Approaches
from advdiff_sumo.maps.convert.narrow import junctions_of, long_conflicts
from advdiff_sumo.maps.convert.netplan import EdgePlan, NetPlan
from advdiff_sumo.maps.convert.roundabouts import find_rings
from advdiff_sumo.maps.convert.sources.source_map import Lamp, Signal, SourceMap
from advdiff_sumo.maps.convert.stop_lines import with_stop_offsets

GUESS_APPROACHES, GUESS_LANES = 3, 4  # junctions at least so large get guessed signals
MAJOR, MINOR = 10, 1  # edge priorities: without and with a stop or yield sign


@dataclass(frozen=True)
class Control:
    """Approaches of each kind, by edge; *idle* are the lights that stop nobody.

    *tokens* name the lights of each edge; *lamps* are those of the lights, where the source tells them.
    *lines* are the areas of their stop lines; those before a crossing on foot say where to stop, not who yields.
    """

    lights: frozenset[str]
    stops: frozenset[str]
    yields: frozenset[str]
    idle: tuple[str, ...]
    lines: dict[str, list[Polygon]]
    lamps: dict[str, frozenset[Lamp]]
    tokens: dict[str, frozenset[str]]


def with_control(plan: NetPlan, source: SourceMap, guess_signals: bool) -> NetPlan:
    """Return *plan* with junction kinds and edge priorities set.

    A junction with a light on one of its approaches is signalled. Stop signs on all approaches make an all-way
    stop, on some of them (and yield signs) those approaches yield. With *guess_signals* junctions of at least
    three approaches with four lanes, whose ways cross, are signalled too, but for those of roundabouts; so are those
    with ways that run along each other for long. Vehicles stop where the stop lines lie.
    """
    control = _read(plan, source)
    approaches: dict[str, list[EdgePlan]] = defaultdict(list)
    for edge in plan.edges:
        approaches[edge.target].append(edge)
    rings = find_rings(plan)
    round_about = {name for ring in rings for name in ring.junctions}
    crossing = _crossing(plan) - round_about if guess_signals else set()
    apart = long_conflicts(plan)
    long = junctions_of(apart, plan)
    kinds = {
        name: _kind([edge.id for edge in edges], control)
        or ("traffic_light" if name in crossing and (_is_large(edges) or name in long) else None)
        for name, edges in approaches.items()
    }
    minor = control.stops | control.yields
    return replace(
        plan,
        edges=with_stop_offsets(
            (replace(edge, priority=MINOR if edge.id in minor else MAJOR) for edge in plan.edges),
            control.lines,
        ),
        junctions=tuple(
            replace(j, kind=kinds.get(j.id) or j.kind) if j.kind == "priority" else j for j in plan.junctions
        ),
        rings=rings,
        idle_signals=control.idle,
        lamps=control.lamps,
        lights=control.tokens,
        apart=frozenset(apart),
    )


def _read(plan: NetPlan, source: SourceMap) -> Control:
    """Return which edges end at a light, a stop sign or a yield sign, and the lights that stop nobody."""
    approaches = Approaches(plan)
    edges: dict[str, set[str]] = {"light": set(), "stop": set(), "yield": set(), "crossing": set()}
    idle = []
    lamps: dict[str, frozenset[Lamp]] = {}
    tokens: dict[str, frozenset[str]] = {}
    for signal in source.signals:
        lanes, before = _stopped_lanes(signal, source)
        stopped = approaches.stopped_by(signal.at, signal.block, lanes) or approaches.stopped_by(
            None, None, before
        )
        edges["light"] |= stopped
        idle += [] if stopped else [signal.token]
        for name in stopped:
            tokens[name] = tokens.get(name, frozenset()) | {signal.token}
        for name in stopped if signal.lamps else ():
            lamps[name] = lamps.get(name, frozenset()) | signal.lamps
    lines: dict[str, list[Polygon]] = {}
    for line in source.stop_lines:
        kind = _sign(line.kind)
        for name in sorted(approaches.stopped_by(line.area, line.block)) if kind is not None else ():
            edges[str(kind)].add(name)
            lines.setdefault(name, []).append(line.area)
    lights, stops, yields = (frozenset(edges[kind]) for kind in ("light", "stop", "yield"))
    return Control(lights, stops, yields, tuple(idle), lines, lamps, tokens)


def _stopped_lanes(signal: Signal, source: SourceMap) -> tuple[list[int], list[int]]:
    """Return the road lanes that *signal* names, and those that lead into the connectors that it names, by number.

    A light before a junction may name the connectors behind it; it does not stop at their ends. Where no road lane
    leads into them, they are returned themselves.
    """
    number = {lane.token: index for index, lane in enumerate(source.lanes)}
    named = [number[token] for token in signal.lanes if token in number]
    road = [lane for lane in named if not source.lanes[lane].is_connector]
    before = [number[a] for a, b in source.links if a in number and b in signal.lanes]
    return road, [lane for lane in before if not source.lanes[lane].is_connector] or named


def _sign(kind: str) -> str | None:
    kind = kind.upper()
    if "TRAFFIC_LIGHT" in kind:
        return "light"
    return {"STOP_SIGN": "stop", "YIELD": "yield", "PED_CROSSING": "crossing"}.get(kind)


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
