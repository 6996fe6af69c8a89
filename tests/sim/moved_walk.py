"""Move vehicles at random over a net, also off their lanes; run in a process of its own, which SUMO may end.

``python -m tests.sim.moved_walk NET SEED``
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.record import Controller
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.actuate import Actuator
from advdiff_sumo.sim.session import Session, SessionOptions
from advdiff_sumo.sim.world import World, read, register

_VEHICLES, _STEPS, _STEP_S, _PLAN_STEPS = 12, 150, 0.1, 5
_NEAR_M, _MAX_MPS, _MAX_BEND_RAD = 40.0, 12.0, 0.6
_TYPE = "DEFAULT_VEHTYPE"


def walk(net: Path, seed: int) -> None:
    """Move vehicles around one junction of *net* for 15 s, with the calls in the loop's order."""
    road, rng = RoadMap.read(net), np.random.default_rng(seed)
    with Session(SessionOptions(net, seed)) as session:
        world = World()
        actuator = Actuator(session.api, world, road)
        rows = _placed(road, world, rng)
        yaw, speed = world.yaw_rad[rows], rng.uniform(0.0, _MAX_MPS, len(rows))
        bend = np.zeros(len(rows))
        actuator.outside |= set(rows.tolist())
        for step in range(_STEPS):
            bend = np.clip(bend + rng.normal(0.0, 0.15, len(rows)), -_MAX_BEND_RAD, _MAX_BEND_RAD)
            yaw = yaw + bend * _STEP_S * speed / 5.0
            world.set_state(
                rows, world.xy_m[rows] + unit(yaw) * speed[:, None] * _STEP_S, yaw, speed, Controller.POLICY
            )
            if step % _PLAN_STEPS == 0:
                _plan(road, actuator, rows, rng)
            actuator.move(rows, world.xy_m[rows], yaw, actuator.is_on_lane(rows, world.xy_m[rows], yaw))
            session.step()
            actuator.take_inserted(register(world, session.api, session.api.simulation.getDepartedIDList()))
            for row in read(world, session.api, actuator.controlled_rows).tolist():
                if row in actuator.moved and actuator.moved[row].inserted:
                    actuator.moved.pop(row)
                    actuator.outside.add(row)
            actuator.remove_off_lanes()


def _placed(road: RoadMap, world: World, rng: np.random.Generator) -> FloatArray:
    """Put vehicles on lanes around one junction and return their rows."""
    lanes = [lane for lane in road.lanes.values() if not lane.is_internal and lane.length_m > 10.0]
    middle = lanes[rng.integers(len(lanes))].line.xy_m[-1]
    near = [x for x in lanes if np.hypot(*(x.line.xy_m - middle).T).min() < _NEAR_M]
    for k in range(_VEHICLES):
        lane = near[rng.integers(len(near))]
        row = world.add(f"v{k}", 0, 5.0, 1.8)
        point, along = road.to_world(lane.id, float(rng.uniform(0.0, lane.length_m)))
        world.set_state(np.array([row]), point[None], np.array([along]), np.zeros(1), Controller.POLICY)
    return np.arange(_VEHICLES)


def _plan(road: RoadMap, actuator: Actuator, rows: FloatArray, rng: np.random.Generator) -> None:
    """Insert vehicles that are on a lane again, and tell SUMO the routes of the others."""
    world = actuator.world
    waiting = np.array(sorted(actuator.outside), dtype=np.int64)
    if len(waiting):
        for row in sorted(actuator.on_lanes(waiting, world.xy_m[waiting], world.yaw_rad[waiting])):
            actuator.insert(row, _TYPE)
    for row in rows.tolist():
        lane = road.lanes.get(world.lane[row])
        if row in actuator.moved and lane is not None and not lane.is_internal:
            actuator.predict_route(row, road.random_route(lane.edge_id, 200.0, rng))


if __name__ == "__main__":
    walk(Path(sys.argv[1]), int(sys.argv[2]))
