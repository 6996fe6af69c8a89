"""What the right of way asks of one path: lines to stop at, and vehicles to let pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import Link
from advdiff_sumo.planners.lane_graph.conflicts import conflict_zone
from advdiff_sumo.planners.lane_graph.lane_graph_options import LaneGraphOptions
from advdiff_sumo.planners.lane_graph.memory import LaneGraphMemory
from advdiff_sumo.planners.lane_graph.others import Others, PossibleWay
from advdiff_sumo.planners.lane_graph.path import Geometry, Zone
from advdiff_sumo.planners.lane_graph.rules import Duty, Rule, may_go, rule_at
from advdiff_sumo.planners.lane_graph.variants import TargetState, Variant

_SIGNAL_BRAKE_MPS2, _YELLOW_BRAKE_MPS2 = 6.0, 3.0
_PASSED_M = 1.5
_LOOK_M, _LOOK_S = 15.0, 7.0


@dataclass(frozen=True)
class Foe:
    """A vehicle with the right of way at a link ahead.

    Attributes:
        way: index of its way.
        to_stop_m: distance of its front to its own stop line, negative beyond it.
        zone: where the two ways meet.
        origin_m: where along the target's path the zone's distances count from.
        link: the target's link.
    """

    way: int
    to_stop_m: float
    zone: Zone
    origin_m: float
    link: Link


@dataclass(frozen=True)
class Duties:
    """What holds on one path.

    Attributes:
        stop_m: where the front must stop at the latest; inf for nowhere.
        yield_m: places to wait at, in order, for those that go first.
        foes: those that go first.
        passing: links whose stop lines a plan may pass.
    """

    stop_m: float
    yield_m: tuple[float, ...]
    foes: tuple[Foe, ...]
    passing: tuple[tuple[Link, float], ...]


def duties(
    geometry: Geometry,
    scene: Scene,
    state: TargetState,
    variant: Variant,
    others: Others,
    ways: Sequence[PossibleWay],
    memory: LaneGraphMemory,
    options: LaneGraphOptions,
) -> Duties:
    """Return what the links ahead on *variant* ask for."""
    stop, yields, foes, passing = _dead_end(variant), list[float](), list[Foe](), []
    front = variant.s_m + state.front_m
    reach = state.speed_mps * _LOOK_S + _LOOK_M
    path = variant.path
    for link, line, beyond in zip(path.links, path.stop_m, path.exit_m, strict=True):
        distance = line - front
        if variant.s_m > beyond + state.front_m or distance > reach:
            continue
        rule = rule_at(geometry.road, link, scene.signals)
        at_line = distance > (-_PASSED_M if state.speed_mps < 1.0 else -0.3)
        junction_foes = _foes(geometry, scene, link, line, rule, ways, others)
        if (
            at_line
            and _must_stop(link, rule, distance, state, junction_foes, scene, others, ways, memory, options)
        ) or (at_line and _exit_blocked(geometry, link, line, beyond, state, variant, others)):
            stop = min(stop, line)
        if not rule.in_turn:
            foes += junction_foes
            if junction_foes:
                yields.append(_waiting_place(geometry, link, line, front, junction_foes))
        if at_line:
            passing.append((link, line))
    return Duties(stop, tuple(yields[:2]), tuple(foes), tuple(passing))


def _dead_end(variant: Variant) -> float:
    """Return where to stop because the route does not go on from this lane."""
    if variant.chain.serves:
        return np.inf
    end = variant.path.length_m
    return end - 2.0 - 8.0 * max(abs(variant.chain.changes) - 1, 0)


def _must_stop(
    link: Link,
    rule: Rule,
    distance_m: float,
    state: TargetState,
    foes: Sequence[Foe],
    scene: Scene,
    others: Others,
    ways: Sequence[PossibleWay],
    memory: LaneGraphMemory,
    options: LaneGraphOptions,
) -> bool:
    brake = state.speed_mps**2 / (2.0 * max(distance_m, 0.1))
    if rule.duty is Duty.STOP:
        return brake < _SIGNAL_BRAKE_MPS2
    if rule.duty is Duty.CLEAR:
        return brake < _YELLOW_BRAKE_MPS2
    if rule.duty is not Duty.STOP_THEN_YIELD:
        return False
    if memory.stopped != (link.from_lane, link.to_lane):
        return True
    return rule.in_turn and _others_first(scene, foes, others, ways, memory, options)


def _others_first(
    scene: Scene,
    foes: Sequence[Foe],
    others: Others,
    ways: Sequence[PossibleWay],
    memory: LaneGraphMemory,
    options: LaneGraphOptions,
) -> bool:
    """Return whether, at an all-way stop, someone is on the junction or has waited longer."""
    since = memory.waiting_since_s
    mine = since.get(scene.target_id, scene.time_s)
    for foe in foes:
        name = scene.history.ids[int(others.rows[ways[foe.way].other])]
        if foe.to_stop_m < -0.5 and not others.standing[ways[foe.way].other]:
            return True
        first = since.get(name, np.inf)
        patient = scene.time_s - mine < options.patience_s
        if patient and foe.to_stop_m < 5.0 and (first, name) < (mine, scene.target_id):
            return True
    return False


def _foes(
    geometry: Geometry,
    scene: Scene,
    link: Link,
    line_m: float,
    rule: Rule,
    ways: Sequence[PossibleWay],
    others: Others,
) -> list[Foe]:
    if not rule.yields_to:
        return []
    foes = []
    for n, way in enumerate(ways):
        ahead = way.next_link(0.5 * float(others.size_m[way.other, 0]))
        if ahead is None:
            continue
        theirs, to_stop = ahead
        if theirs.junction_id != link.junction_id or theirs.request_index not in rule.yields_to:
            continue
        if to_stop > 0.0 and not may_go(theirs, scene.signals):
            continue
        zone = conflict_zone(geometry, link, theirs)
        if zone is not None:
            foes.append(Foe(n, to_stop, zone, line_m, link))
    return foes


def _waiting_place(
    geometry: Geometry, link: Link, line_m: float, front_m: float, foes: Sequence[Foe]
) -> float:
    """Return where to wait: at the line, at the waiting position on the junction, or short of the conflict."""
    place = line_m
    if len(link.via) > 1:
        place = line_m + geometry.road.lanes[link.via[0]].length_m
    if front_m > place + 0.5:
        place = line_m + min(foe.zone.own_m[0] for foe in foes)
    return place


def _exit_blocked(
    geometry: Geometry,
    link: Link,
    line_m: float,
    beyond_m: float,
    state: TargetState,
    variant: Variant,
    others: Others,
) -> bool:
    """Return whether a standing queue leaves no room beyond a junction that others cross."""
    junction = geometry.road.junctions.get(link.junction_id)
    if junction is None or not junction.foes.get(link.request_index):
        return False
    if not len(others.rows):
        return False
    s, d = variant.path.project(others.xy_m)
    rear = s - 0.5 * others.size_m[:, 0]
    stands = (np.abs(d) < 1.5) & (others.speed_mps < 1.0) & (rear > line_m)
    room = beyond_m + state.length_m + 1.5
    return bool((stands & (rear < room)).any())
