"""Simulate a car and a pedestrian who meet at a crossing, in SUMO."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import libsumo
import sumolib


def drive(
    net: Path, tokens: Sequence[str], walker_at_s: float | None, seconds: float
) -> list[dict[str, Any]]:
    """Return each step (0.1 s) of a car and of a pedestrian who crosses its path northwards from *walker_at_s* on.

    The car drives on the edges of the lanes *tokens*, one after the other.
    """
    read = sumolib.net.readNet(str(net))
    lanes: dict[str, list[tuple[float, str]]] = defaultdict(list)
    for edge in read.getEdges():
        token, start, _ = (edge.getLane(0).getParam("source") or "-:0:0").split(":")
        lanes[token].append((float(start), edge.getID()))
    walks = sorted(e.getID() for e in read.getEdges() if e.getLane(0).getPermissions() == {"pedestrian"})
    ends = {name: read.getEdge(name).getShape()[0][1] for name in walks}
    options = ["--step-length", "0.1", "--collision.check-junctions", "--collision.action", "warn"]
    libsumo.start(["sumo", "-n", str(net), "--no-step-log", "--no-warnings", *options])
    steps = []
    try:
        libsumo.route.add("on", [name for token in tokens for _, name in sorted(lanes[token])])
        libsumo.vehicle.add("car", "on", departPos="0", departSpeed="8")
        if walker_at_s is not None:
            south, north = min(ends, key=ends.__getitem__), max(ends, key=ends.__getitem__)
            libsumo.person.add("walker", south, 0.0, depart=walker_at_s)
            libsumo.person.appendWalkingStage("walker", [south, north], -1)
        for step in range(round(seconds * 10)):
            libsumo.simulationStep()
            assert not libsumo.simulation.getCollisions()
            state: dict[str, Any] = {"time_s": 0.1 * step}
            if "car" in libsumo.vehicle.getIDList():
                state |= {
                    "front_m": libsumo.vehicle.getPosition("car")[0],
                    "speed": libsumo.vehicle.getSpeed("car"),
                }
            if "walker" in libsumo.person.getIDList():
                state |= {
                    "where": libsumo.person.getRoadID("walker"),
                    "y": libsumo.person.getPosition("walker")[1],
                    "pace": libsumo.person.getSpeed("walker"),
                }
            for light in libsumo.trafficlight.getIDList():
                state["lights"] = libsumo.trafficlight.getRedYellowGreenState(light)
            steps.append(state)
    finally:
        libsumo.close()
    return steps
