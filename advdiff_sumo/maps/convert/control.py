"""Set right of way and signals of a net: from the source's lights and signs, or guessed where it has none."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import shapely
from shapely.geometry import Polygon

from advdiff_sumo.maps.convert.approaches import Approaches
from advdiff_sumo.maps.convert.missed_conflicts import by_junction, junctions_of, long_conflicts
from advdiff_sumo.maps.convert.netplan import EdgePlan, NetPlan
from advdiff_sumo.maps.convert.roundabouts import find_rings
from advdiff_sumo.maps.convert.sources.source_map import Lamp, Signal, SourceMap
from advdiff_sumo.maps.convert.stop_lines import with_stop_offsets

GUESS_APPROACHES = 3  # smallest number of approaches of a junction that gets guessed signals
GUESS_LANES = 4  # smallest number of their lanes together
MAJOR = 10  # priority of an edge without a stop or yield sign
MINOR = 1  # priority of an edge with one


@dataclass(frozen=True)
class Control:
    """Edges that end at traffic lights, stop signs and yield signs; *idle* are names of lights that stop no edge.

    *tokens* are the names of the lights of each edge, and *lamps* their lamps, if the source lists them. *lines* are
    the areas of the stop lines of each edge. Lines before a pedestrian crossing set where to stop, but not who yields.
    """

    lights: frozenset[str]
    stops: frozenset[str]
    yields: frozenset[str]
    idle: tuple[str, ...]
    lines: dict[str, list[Polygon]]
    lamps: dict[str, frozenset[Lamp]]
    tokens: dict[str, frozenset[str]]


def with_control(plan: NetPlan, source: SourceMap, guess_signals: bool) -> NetPlan:
    """Return *plan* with junction kinds, edge priorities and stop offsets set.

    A junction with a light on one of its approaches is signalled. Stop signs on all approaches make an all-way stop.
    Otherwise approaches with a stop or yield sign yield. With *guess_signals*, other junctions in which two
    connections cross are signalled too, except those of roundabouts, if they are large (at least three approaches
    with four lanes together) or if two of their connections run close to each other over a long distance. Vehicles
    stop at the stop lines.
    """
    control = _read_control(plan, source)
    approaches: dict[str, list[EdgePlan]] = defaultdict(list)
    for edge in plan.edges:
        approaches[edge.target].append(edge)
    rings = find_rings(plan)
    roundabout_junctions = {name for ring in rings for name in ring.junctions}
    guessable = _crossing_junctions(plan) - roundabout_junctions if guess_signals else set()
    long_pairs = long_conflicts(plan)
    long_conflict_junctions = junctions_of(long_pairs, plan)
    large = {name for name, edges in approaches.items() if _is_large(edges)}
    guessed = guessable & (large | long_conflict_junctions)
    kinds = {
        name: _kind([edge.id for edge in edges], control) or ("traffic_light" if name in guessed else None)
        for name, edges in approaches.items()
    }
    minor_edges = control.stops | control.yields
    return replace(
        plan,
        edges=with_stop_offsets(
            (replace(edge, priority=MINOR if edge.id in minor_edges else MAJOR) for edge in plan.edges),
            control.lines,
        ),
        junctions=tuple(
            replace(j, kind=kinds.get(j.id) or j.kind) if j.kind == "priority" else j for j in plan.junctions
        ),
        rings=rings,
        idle_signals=control.idle,
        lamps=control.lamps,
        lights=control.tokens,
        long_conflicts=frozenset(long_pairs),
    )


def _read_control(plan: NetPlan, source: SourceMap) -> Control:
    """Return which edges of *plan* end at a light, a stop sign, a yield sign or a stop line of *source*."""
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
    """Return the numbers of the road lanes that *signal* names, and of the road lanes before the lanes that it names.

    The latter matter because a light before a junction may name the connectors behind it, but does not stop vehicles at
    their ends. If no road lane leads into a named lane, the second list holds the named lanes themselves.
    """
    number = source.number_of
    named = [number[token] for token in signal.lanes if token in number]
    road_lanes = [lane for lane in named if not source.lanes[lane].is_connector]
    before = [number[a] for a, b in source.links if a in number and b in signal.lanes]
    return road_lanes, [lane for lane in before if not source.lanes[lane].is_connector] or named


def _sign(kind: str) -> str | None:
    """Return what a stop line of the source's *kind* belongs to: light, stop, yield or crossing; else None."""
    kind = kind.upper()
    if "TRAFFIC_LIGHT" in kind:
        return "light"
    return {"STOP_SIGN": "stop", "YIELD": "yield", "PED_CROSSING": "crossing"}.get(kind)


def _kind(edges: list[str], control: Control) -> str | None:
    """Return SUMO's type of a junction with approaches *edges*; None if no light or stop sign sets it."""
    if control.lights & set(edges):
        return "traffic_light"
    if len(edges) > 1 and set(edges) <= control.stops:
        return "allway_stop"
    return "priority_stop" if control.stops & set(edges) else None


def _is_large(edges: list[EdgePlan]) -> bool:
    return len(edges) >= GUESS_APPROACHES and sum(len(edge.lanes) for edge in edges) >= GUESS_LANES


def _crossing_junctions(plan: NetPlan) -> set[str]:
    """Return the junctions in which two connections cross."""
    crossing = set()
    for name, connections in by_junction(plan).items():
        lines = [shapely.LineString(connection.shape_m) for connection in connections]
        if len(shapely.STRtree(lines).query(lines, predicate="crosses")[0]):
            crossing.add(name)
    return crossing
