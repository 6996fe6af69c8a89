"""Read from SUMO which road users its driver models take into account, and what the signals show."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from advdiff_sumo.maps.lanes import edge_of_lane
from advdiff_sumo.sim.world import PERSON

_TLS_STATE = 0x20  # libsumo.constants.TL_RED_YELLOW_GREEN_STATE
_LOOK_AHEAD_M = 100.0
_JUNCTIONS = 2  # junctions ahead at which crossings are considered
_CROSSING = re.compile(r":.*_c\d+_0$")  # SUMO's name of the lane of a pedestrian crossing
_NEIGHBOUR_MODES = (0b00, 0b01, 0b10, 0b11)  # left and right, followers and leaders


def visible_ids(api: Any, name: str) -> frozenset[str]:
    """Return the leader, neighbours, junction foes and people on crossings that *name*'s SUMO models consider now."""
    vehicle = api.vehicle
    leader = leader_of(api, name, _LOOK_AHEAD_M)
    visible = set() if leader is None else {leader[0]}
    for mode in _NEIGHBOUR_MODES:
        visible.update(other for other, _ in vehicle.getNeighbors(name, mode))
    visible |= _foes(api, name) | _on_crossings(api, name)
    return frozenset(visible - {"", name})


def leader_of(api: Any, name: str, within_m: float) -> tuple[str, float] | None:
    """Return the leader of *name* and the gap to it, less the gap at standstill; None if there is none *within_m*."""
    leader = api.vehicle.getLeader(name, within_m)
    return None if leader is None or not leader[0] else (str(leader[0]), float(leader[1]))


def _foes(api: Any, name: str) -> set[str]:
    """Return vehicles in conflict with *name* at the next junctions; SUMO lists some pairs for one of the two only."""
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
    """Return the people on crossings over the lanes ahead of *name*."""
    if not api.person.getIDCount():
        return set()
    inner_lanes = [link[4] for link in api.vehicle.getNextLinks(name)[:_JUNCTIONS]]
    own_lane = api.vehicle.getLaneID(name)
    inner_lanes += [own_lane] if own_lane.startswith(":") else []
    lanes = {lane for inner in inner_lanes if inner for lane in api.lane.getInternalFoes(inner)}
    crossings = {edge_of_lane(lane) for lane in lanes if _CROSSING.match(lane)}
    return {PERSON + person for edge in crossings for person in api.edge.getLastStepPersonIDs(edge)}


def watch_signals(api: Any) -> None:
    """Subscribe to every traffic light."""
    for name in api.trafficlight.getIDList():
        api.trafficlight.subscribe(name, (_TLS_STATE,))


def read_signals(api: Any) -> Mapping[str, str]:
    """Return id → state string of every traffic light."""
    results = api.trafficlight.getAllSubscriptionResults()
    # before the first step, libsumo still returns the subscriptions of the previous simulation
    return {name: results[name][_TLS_STATE] for name in api.trafficlight.getIDList()}
