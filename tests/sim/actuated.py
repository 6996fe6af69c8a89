"""Helpers that move vehicles with an actuator on the tiny nets."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from advdiff_sumo.core.record import Controller
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.actuate import Actuator
from advdiff_sumo.sim.world import World, read, register
from tests.sim.nets import Stage

EASTBOUND, WESTBOUND = ("WM", "ME"), ("EM", "MW")
NOBODY = np.zeros(0, dtype=np.int64)


def actuator_on(s: Stage, net: Path) -> Actuator:
    """Return an actuator whose world has a row for every vehicle in SUMO."""
    world = World()
    register(world, s.api, s.api.vehicle.getIDList())
    read(world, s.api, NOBODY)
    return Actuator(s.api, world, RoadMap.read(net))


def move(
    actuator: Actuator,
    s: Stage,
    row: int,
    xy: tuple[float, float],
    yaw: float,
    speed: float = 0.0,
    *,
    take_out: bool = True,
) -> None:
    """Move *row* for one step, as the loop does, and remove vehicles that must not stay in SUMO."""
    rows = np.array([row])
    at, heading = np.array([xy], dtype=np.float64), np.array([yaw])
    actuator.world.set_state(rows, at, heading, np.array([speed]), Controller.POLICY)
    actuator.move(rows, at, heading, actuator.is_on_lane(rows, at, heading))
    s.session.step()
    actuator.take_inserted(register(actuator.world, s.api, s.api.simulation.getDepartedIDList()))
    read(actuator.world, s.api, actuator.controlled_rows)
    if take_out:
        actuator.remove_off_lanes()
