"""What a SUMO-driven target's models take into account, and what the signals show."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from advdiff_sumo.sim.world import PERSON

_TLS_STATE = 0x20  # libsumo.constants.TL_RED_YELLOW_GREEN_STATE
_LOOK_AHEAD_M = 100.0
_JUNCTIONS = 2  # ahead, whose crossings are looked at
_CROSSING = re.compile(r":.*_c\d+_0$")  # SUMO's name of the lane of a pedestrian crossing
_NEIGHBOURS = (0b00, 0b01, 0b10, 0b11)  # left and right, followers and leaders


def visible_ids(api: Any, name: str) -> frozenset[str]:
    """Return whom the models of SUMO-driven *name* see now: leader, neighbours, junction foes, people on crossings."""
    vehicle = api.vehicle
    leader = leader_of(api, name, _LOOK_AHEAD_M)
    visible = set() if leader is None else {leader[0]}
    for mode in _NEIGHBOURS:
        visible.update(other for other, _ in vehicle.getNeighbors(name, mode))
    visible |= _foes(api, name) | _on_crossings(api, name)
    return frozenset(visible - {"", name})


def leader_of(api: Any, name: str, within_m: float) -> tuple[str, float] | None:
    """Return who is ahead on the way of *name*, and the gap beyond its gap at standstill; None: nobody near enough."""
    leader = api.vehicle.getLeader(name, within_m)
    return None if leader is None or not leader[0] else (str(leader[0]), float(leader[1]))


def _foes(api: Any, name: str) -> set[str]:
    """Return who is in conflict with *name* at the next junctions; SUMO names some pairs on one side only."""
    foes_of = api.vehicle.getJunctionFoes
    foes = {foe[0] for foe in foes_of(name, _LOOK_AHEAD_M)}
    edge = api.vehicle.getRoadID(name)
    if not edge:
        return foes
    for incoming in api.junction.getIncomingEdges(api.edge.getToJunction(edge)):
        for other in api.edge.getLastStepVehicleIDs(incoming):
            if other not in foes and any(foe[0] == name for foe in foes_of(other, _LOOK_AHEAD_M)):
                foes.add(other)
    return foes


def _on_crossings(api: Any, name: str) -> set[str]:
    """Return the people on crossings over the ways ahead of *name*."""
    if not api.person.getIDCount():
        return set()
    ways = [link[4] for link in api.vehicle.getNextLinks(name)[:_JUNCTIONS]]
    here = api.vehicle.getLaneID(name)
    ways += [here] if here.startswith(":") else []
    lanes = {lane for way in ways if way for lane in api.lane.getInternalFoes(way)}
    crossings = {lane.rpartition("_")[0] for lane in lanes if _CROSSING.match(lane)}
    return {PERSON + person for edge in crossings for person in api.edge.getLastStepPersonIDs(edge)}


def watch_signals(api: Any) -> None:
    """Subscribe to every traffic light."""
    for name in api.trafficlight.getIDList():
        api.trafficlight.subscribe(name, (_TLS_STATE,))


def read_signals(api: Any) -> Mapping[str, str]:
    """Return id → state string of every traffic light."""
    results = api.trafficlight.getAllSubscriptionResults()
    # before its first step, libsumo still shows what the simulation before this one was subscribed to
    return {name: results[name][_TLS_STATE] for name in api.trafficlight.getIDList()}
