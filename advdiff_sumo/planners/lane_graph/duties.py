"""Find what the right of way demands on one path: lines to stop at, and vehicles to yield to."""

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

_RED_BRAKE_MPS2, _YELLOW_BRAKE_MPS2 = 6.0, 3.0  # the target does not stop for a signal if that needs more
_PASSED_M = 1.5  # a slow target so far beyond a stop line can still stop for it
_REACH_M, _REACH_S = 15.0, 7.0  # links are considered within the drive of 7 s, plus 15 m


@dataclass(frozen=True)
class Foe:
    """A vehicle on a possible way that has the right of way at a link ahead.

    Attributes:
        way: index of its possible way.
        to_stop_m: distance from its front to its own stop line, negative beyond it.
        zone: conflict area of the two links.
        origin_m: arc length along the target's path from which the zone's own distances count (its stop line).
        link: the target's link.
    """

    way: int
    to_stop_m: float
    zone: Zone
    origin_m: float
    link: Link


@dataclass(frozen=True)
class Duties:
    """What the traffic rules demand on one path.

    Attributes:
        stop_m: arc length at which the front must stop at the latest; inf for none.
        yield_m: arc lengths at which to wait for the foes, in order.
        foes: vehicles with the right of way.
        passing: links whose stop lines are still ahead, with their arc lengths.
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
    """Return what the links ahead on *variant* demand."""
    stop, waiting_m, foes, passing = _dead_end(variant), list[float](), list[Foe](), []
    front = variant.s_m + state.front_m
    reach_m = state.speed_mps * _REACH_S + _REACH_M
    path = variant.path
    for link, line, beyond in zip(path.links, path.stop_m, path.exit_m, strict=True):
        distance = line - front
        if variant.s_m > beyond + state.front_m or distance > reach_m:
            continue
        rule = rule_at(geometry.road, link, scene.signals)
        before_line = distance > (-_PASSED_M if state.speed_mps < 1.0 else -0.3)
        junction_foes = _foes(geometry, scene, link, line, rule, ways, others)
        if before_line and (
            _must_stop(link, rule, distance, state, junction_foes, scene, others, ways, memory, options)
            or _exit_blocked(geometry, link, line, beyond, state, variant, others)
        ):
            stop = min(stop, line)
        if not rule.in_turn:
            foes += junction_foes
            if junction_foes:
                waiting_m.append(_waiting_position_m(geometry, link, line, front, junction_foes))
        if before_line:
            passing.append((link, line))
    return Duties(stop, tuple(waiting_m[:2]), tuple(foes), tuple(passing))


def _dead_end(variant: Variant) -> float:
    """Return where to stop if the route cannot be followed from this lane; inf if it can."""
    if variant.chain.follows_route:
        return np.inf
    end_m = variant.path.length_m
    return end_m - 2.0 - 8.0 * max(abs(variant.chain.changes) - 1, 0)


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
    """Return whether the target must stop at the line of *link*, for a signal, a stop sign or its turn to go."""
    required_mps2 = state.speed_mps**2 / (2.0 * max(distance_m, 0.1))
    if rule.duty is Duty.STOP:
        return required_mps2 < _RED_BRAKE_MPS2
    if rule.duty is Duty.CLEAR:
        return required_mps2 < _YELLOW_BRAKE_MPS2
    if rule.duty is not Duty.STOP_THEN_YIELD:
        return False
    if memory.stopped != (link.from_lane, link.to_lane):
        return True
    return rule.in_turn and _must_wait_turn(scene, foes, others, ways, memory, options)


def _must_wait_turn(
    scene: Scene,
    foes: Sequence[Foe],
    others: Others,
    ways: Sequence[PossibleWay],
    memory: LaneGraphMemory,
    options: LaneGraphOptions,
) -> bool:
    """Return whether, at an all-way stop, a foe is on the junction or arrived before the target."""
    since = memory.waiting_since_s
    own_arrival = since.get(scene.target_id, scene.time_s)
    for foe in foes:
        foe_id = scene.history.ids[int(others.rows[ways[foe.way].other])]
        if foe.to_stop_m < -0.5 and not others.standing[ways[foe.way].other]:
            return True
        arrival = since.get(foe_id, np.inf)
        is_patient = scene.time_s - own_arrival < options.patience_s
        if is_patient and foe.to_stop_m < 5.0 and (arrival, foe_id) < (own_arrival, scene.target_id):
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
    """Return the vehicles that may enter the junction now and have the right of way over *link*."""
    if not rule.yields_to:
        return []
    foes = []
    for n, way in enumerate(ways):
        next_link = way.next_link(0.5 * float(others.size_m[way.other, 0]))
        if next_link is None:
            continue
        foe_link, to_stop = next_link
        if foe_link.junction_id != link.junction_id or foe_link.request_index not in rule.yields_to:
            continue
        if to_stop > 0.0 and not may_go(foe_link, scene.signals):
            continue
        zone = conflict_zone(geometry, link, foe_link)
        if zone is not None:
            foes.append(Foe(n, to_stop, zone, line_m, link))
    return foes


def _waiting_position_m(
    geometry: Geometry, link: Link, line_m: float, front_m: float, foes: Sequence[Foe]
) -> float:
    """Return where to wait: at the line, at the waiting position on the junction, or before the conflict areas."""
    waiting_m = line_m
    if len(link.via) > 1:
        waiting_m = line_m + geometry.road.lanes[link.via[0]].length_m
    if front_m > waiting_m + 0.5:
        waiting_m = line_m + min(foe.zone.own_m[0] for foe in foes)
    return waiting_m


def _exit_blocked(
    geometry: Geometry,
    link: Link,
    line_m: float,
    beyond_m: float,
    state: TargetState,
    variant: Variant,
    others: Others,
) -> bool:
    """Return whether a standing queue leaves no room for the target beyond a junction with crossing traffic."""
    junction = geometry.road.junctions.get(link.junction_id)
    if junction is None or not junction.foes.get(link.request_index):
        return False
    if not len(others.rows):
        return False
    s, d = variant.path.project(others.xy_m)
    rear = s - 0.5 * others.size_m[:, 0]
    in_queue = (np.abs(d) < 1.5) & (others.speed_mps < 1.0) & (rear > line_m)
    needed_m = beyond_m + state.length_m + 1.5
    return bool((in_queue & (rear < needed_m)).any())
