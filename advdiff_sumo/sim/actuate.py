"""Moving vehicles by moveToXY, so that SUMO's drivers see them (measured traps: docs/sumo.md).

Rules that SUMO does not state: a vehicle must have been on a lane before anything else; off the lanes, or with its
front bumper beside the lane that SUMO holds it on, nobody sees it, and with sublanes a step can end the process, so it
is taken out of SUMO until it comes back to a lane (our own states go on); removed straight after a move, a vehicle can
end a step, too, so that it is left to SUMO for one before; on a junction it needs a route over the junction's lane,
and cannot be given another; a moved vehicle loses its route unless it is given the edges that it is about to drive; its
speed, as others see it, is clipped to the lane's limit times its speed factor; and with a stop ahead it is the speed of
SUMO's own driver, so that followers run into who stands, and stops are set aside.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.errors import NotInsertedError
from advdiff_sumo.core.frames import bumper_from_centre, sumo_from_yaw, unit
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.core.sumo_classes import VCLASS_OF_CLASS
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.world import World

# moveToXY's keepRoute: 1 is the nearest place on the own route, 2 and 3 the exact one, 3 on the own route only
_ON_ROUTE, _ANY_EDGE, _OWN_ROUTE = 1, 2, 3
_FREE_SPEED_FACTOR, _FREE_MAX_SPEED = 20.0, 90.0
_SAME_PLACE_M = 0.2
_NO_CHECKS = 0  # SUMO's speed mode and lane-change mode without any
_USUAL_SPEED_MODE, _USUAL_LANE_CHANGE_MODE = 31, 1621


@dataclass
class MovedVehicle:
    """What SUMO had set for a vehicle before we moved it, and the route that we gave it.

    Attributes:
        speed_factor: SUMO's own, to be restored.
        max_speed_mps: SUMO's own, to be restored.
        stops: SUMO's own, still ahead, to be restored.
        route: edges last given to SUMO; () where it may look for a lane anywhere.
        inserted: False until SUMO has taken the vehicle in.
    """

    speed_factor: float
    max_speed_mps: float
    stops: tuple[Any, ...] = ()
    route: tuple[str, ...] = ()
    inserted: bool = True


@dataclass
class Actuator:
    """Holds the moved vehicles of one episode.

    Attributes:
        api: libsumo or traci.
        world: rows and states.
        road: the map.
        moved: row → what we changed in SUMO.
        outside: rows that we move off the lanes, where SUMO has no use for them.
        refused: rows that SUMO would not take in on the lane nearest to them; they stay outside.
    """

    api: Any
    world: World
    road: RoadMap
    moved: dict[int, MovedVehicle] = field(default_factory=dict)
    outside: set[int] = field(default_factory=set)
    refused: set[int] = field(default_factory=set)
    _leaving: set[int] = field(default_factory=set)
    _before: dict[int, tuple[str, ...]] = field(default_factory=dict)
    _entries: dict[int, int] = field(default_factory=dict)

    @property
    def ours(self) -> set[int]:
        """Rows that we move, in SUMO or outside, and those that SUMO is about to lose."""
        return self.outside | self.moved.keys() | self._leaving

    def take(self, row: int) -> None:
        """Begin to move *row*, which is on a lane."""
        vehicle, name = self.api.vehicle, self.world.sumo_ids[row]
        speed_factor, max_speed = vehicle.getSpeedFactor(name), vehicle.getMaxSpeed(name)
        self.moved[row] = MovedVehicle(speed_factor, max_speed, _set_aside_stops(vehicle, name))
        vehicle.setMaxSpeed(name, _FREE_MAX_SPEED)  # draws the speed factor anew, so it comes first
        vehicle.setSpeedFactor(name, _FREE_SPEED_FACTOR)
        vehicle.setSpeedMode(name, _NO_CHECKS)
        vehicle.setLaneChangeMode(name, _NO_CHECKS)

    def release(self, row: int, route: Sequence[str] = ()) -> None:
        """Hand *row* back to SUMO at its present pose and speed."""
        before = self.moved.pop(row)
        name, vehicle = self.world.sumo_ids[row], self.api.vehicle
        if route:
            self._set_route(name, tuple(route))
        vehicle.setMaxSpeed(name, before.max_speed_mps)
        vehicle.setSpeedFactor(name, before.speed_factor)
        vehicle.setSpeedMode(name, _USUAL_SPEED_MODE)
        vehicle.setLaneChangeMode(name, _USUAL_LANE_CHANGE_MODE)
        vehicle.setPreviousSpeed(name, max(float(self.world.speed_mps[row]), 0.0))
        _restore_stops(vehicle, name, before.stops)

    def insert(self, row: int, type_id: str) -> None:
        """Bring *row* into SUMO: on the lane nearest to its pose in the next step, exactly from then on.

        Raises:
            NotInsertedError: the net has no lane to put it on, or SUMO refuses it.
        """
        vclass = VCLASS_OF_CLASS[AgentClass(int(self.world.classes[row]))]
        name = self._fresh_name(row)
        place = self._entrance(row, vclass)
        if place is None:
            raise NotInsertedError(f"no lane of {self.road.name} is open to '{name}', a {vclass}")
        lane_id, front, along = place
        try:
            self.api.route.add(f"insert:{name}", self._edges_at(lane_id))
            self.api.vehicle.add(name, f"insert:{name}", typeID=type_id, depart="now", departPos="base")
            self._set_size(name, row)
            # keepRoute 0 before it departs would give it this route again and again, whatever setRoute says
            self.api.vehicle.moveToXY(
                name, "", -1, *front.tolist(), angle=float(sumo_from_yaw(along)), keepRoute=_ON_ROUTE
            )
        except Exception as error:
            self._forget(name)
            raise NotInsertedError(f"SUMO refuses to insert '{name}': {error}") from error
        self.moved[row] = MovedVehicle(1.0, _FREE_MAX_SPEED, inserted=False)
        self.outside.discard(row)

    def _entrance(self, row: int, vclass: str) -> tuple[str, FloatArray, float] | None:
        """Return the lane nearest to *row*, and the front bumper (2,) and heading that it would have in its middle.

        Who has just been taken out gets the lane on which its bumper is: one that leads on from where it was, if any.
        """
        xy, yaw, length = self.world.xy_m[row], self.world.yaw_rad[row], self.world.size_m[row, 0]
        before = self._before.pop(row, None)
        if before is None:
            pose = self.road.locate(xy, float(yaw), vclass=vclass, max_distance_m=np.inf)
        else:
            bumper = bumper_from_centre(xy, yaw, length)
            pose = self.road.locate(bumper, float(yaw), vclass=vclass, max_distance_m=np.inf, route=before)
            if pose is not None and abs(pose.d_m) > 0.5 * self.road.lanes[pose.lane_id].width_m:
                pose = self.road.locate(bumper, float(yaw), vclass=vclass, max_distance_m=np.inf)
        if pose is None:
            return None
        point, along = self.road.to_world(pose.lane_id, pose.s_m)
        front = bumper_from_centre(point, along, length) if before is None else point
        return pose.lane_id, front, float(along)

    def _edges_at(self, lane_id: str) -> list[str]:
        """Return the shortest route on which SUMO has *lane_id*: of a junction's lane, the edges that it connects."""
        link = self.road.link_over.get(lane_id)
        ends = (lane_id,) if link is None else (link.from_lane, link.to_lane)
        return [self.road.edge_of(lane) for lane in ends]

    def _set_size(self, name: str, row: int) -> None:
        """Give *name* its own size in place of its type's, by which SUMO knows where its rear is."""
        length, width = self.world.size_m[row].tolist()
        self.api.vehicle.setLength(name, length)
        self.api.vehicle.setWidth(name, width)

    def try_insert(self, row: int, type_id: str) -> None:
        """Bring *row* into SUMO, or note that SUMO refuses it and move it outside."""
        try:
            self.insert(row, type_id)
        except NotInsertedError:
            self.refused.add(row)
            self.outside.add(row)

    def _forget(self, name: str) -> None:
        """Take back what SUMO may have been told of *name* before it refused."""
        with contextlib.suppress(Exception):  # libsumo and traci raise different kinds where it has none
            self.api.vehicle.remove(name)

    def on_lanes(self, rows: IntArray, xy_m: FloatArray, yaw_rad: FloatArray) -> set[int]:
        """Return those of *rows* whose front bumpers' centres are on a lane at poses (N, 2), (N,)."""
        bumper = bumper_from_centre(xy_m, yaw_rad, self.world.size_m[rows, 0])
        return set(rows[self.road.on_lane(bumper, yaw_rad)].tolist())

    def settle(self, departed: Sequence[int]) -> None:
        """Free vehicles that SUMO has just inserted for us from its own limits."""
        for row in departed:
            if row in self.moved and not self.moved[row].inserted:
                self.take(row)

    def remove(self, row: int) -> None:
        """Take *row* off the scene; SUMO loses it after the next step."""
        self.outside.discard(row)
        self._leave(row)

    def leave_lanes(self) -> IntArray:
        """Take those out of SUMO that its last step has off the lanes, or beside the lane that it holds them on.

        And those that it was to keep for that step only (:meth:`_leave`). Returns the rows of the former.
        """
        for row in sorted(self._leaving & self.world.in_sumo):
            self._drop(row)
        self._leaving.clear()
        beside = [r for r, m in self.moved.items() if m.inserted and not self._on_its_lane(r)]
        for row in beside:
            del self.moved[row]
            self._before[row] = self._ways_on(self.world.lane[row])
            self._drop(row)
            self.outside.add(row)
        return np.array(beside, dtype=np.int64)

    def _ways_on(self, lane_id: str) -> tuple[str, ...]:
        """Return edges among which is each that *lane_id*, or who is on it of a junction, comes from and leads to."""
        link = self.road.link_over.get(lane_id)
        if lane_id not in self.road.lanes:
            return ()
        edge = self.road.edge_of(lane_id if link is None else link.from_lane)
        return tuple(x for onward in self.road.edges[edge].successors for x in (edge, onward)) or (edge,)

    def _on_its_lane(self, row: int) -> bool:
        """Return whether SUMO has the front bumper's centre of *row* within its lane.

        At the beginning of a route it may be metres beside it: SUMO looks for a lane on the route alone and takes the
        nearest end. A step with sublanes then reads freed memory (docs/sumo.md).
        """
        lane = self.road.lanes.get(self.world.lane[row])
        return lane is not None and self.world.beside_m[row] <= 0.5 * lane.width_m

    def _leave(self, row: int) -> None:
        """Let SUMO drive *row* for one step, and lose it then.

        After moveToXY a lane beside the vehicle's own may hold it as one that reaches into it, and keeps it so when it
        is removed; a step of SUMO's own puts that right (docs/sumo.md).
        """
        state = self.moved.pop(row, None)
        if state is not None and state.inserted:
            self._leaving.add(row)
        elif state is not None:
            self._drop(row)

    def _drop(self, row: int) -> None:
        name = self.world.sumo_ids[row]
        self.api.vehicle.unsubscribe(name)  # else the next step stops at the unknown name
        self.api.vehicle.remove(name)
        self.world.in_sumo.discard(row)

    def holds(self, row: int, lane: str | None, d_m: float) -> bool:
        """Return whether SUMO has *row* on *lane*, *d_m* to its left: where lanes overlap it may not."""
        name = self.world.sumo_ids[row]
        beside = float(self.api.vehicle.getLateralLanePosition(name)) * (-1.0 if self.road.lefthand else 1.0)
        return self.world.lane[row] == lane and abs(beside - d_m) <= _SAME_PLACE_M

    def move(self, rows: IntArray, xy_m: FloatArray, yaw_rad: FloatArray) -> None:
        """Put *rows* at poses (N, 2), (N,) in the next step, and take those out of SUMO that leave the lanes.

        Those outside or being inserted are left alone.
        """
        inserted = [row in self.moved and self.moved[row].inserted for row in rows.tolist()]
        rows, xy_m, yaw_rad = rows[inserted], xy_m[inserted], yaw_rad[inserted]
        bumper = bumper_from_centre(xy_m, yaw_rad, self.world.size_m[rows, 0])
        inside = self.road.on_lane(bumper, yaw_rad)
        for row in rows[~inside].tolist():
            self._leave(row)
            self.outside.add(row)
        if self.road.lefthand:
            _, _, left, turned = self.road.locate_many(bumper, yaw_rad)
            bumper = _mirrored(bumper, left, yaw_rad - turned)
        names, moved = self.world.sumo_ids, self.moved
        places = zip(
            rows[inside].tolist(),
            bumper[inside].tolist(),
            sumo_from_yaw(yaw_rad[inside]).tolist(),
            strict=True,
        )
        for row, (x, y), turn in places:
            keep_route = _OWN_ROUTE if moved[row].route else _ANY_EDGE
            self.api.vehicle.moveToXY(names[row], "", -1, x, y, turn, keep_route)

    def predict_route(self, row: int, route: tuple[str, ...]) -> None:
        """Tell SUMO which edges *row* is about to drive, so that drivers at junctions yield to it (#6140)."""
        state = self.moved.get(row)
        if state is None:
            return
        known = bool(route) and state.route[-len(route) :] == route
        if state.inserted and not known:
            state.route = route if route and self._set_route(self.world.sumo_ids[row], route) else ()

    def _set_route(self, name: str, route: tuple[str, ...]) -> bool:
        """Return whether SUMO accepted *route*, which must begin at the edge where SUMO has the vehicle."""
        vehicle = self.api.vehicle
        current = vehicle.getRoute(name)[max(vehicle.getRouteIndex(name), 0)]
        if current in route:
            route = route[route.index(current) :]
        elif (
            route[0] in self.road.edges[current].successors
        ):  # on the junction SUMO still counts the edge before
            route = (current, *route)
        else:
            return False
        try:
            vehicle.setRoute(name, list(route))
        except Exception:  # noqa: BLE001 - libsumo and traci raise different kinds; SUMO then keeps the old route
            return False
        return True

    def _fresh_name(self, row: int) -> str:
        """Return a name that SUMO has not had in this simulation; the first is the vehicle's own."""
        count = self._entries.get(row, int(row in self.world.had_in_sumo))
        self._entries[row] = count + 1
        name = self.world.ids[row] + (f"~{count}" if count else "")
        self.world.rename(row, name)
        return name


def _set_aside_stops(vehicle: Any, name: str) -> tuple[Any, ...]:
    """Take its stops from *name*, unless it is parked, and return those still ahead; who stands at one may go on."""
    if vehicle.isStoppedParking(name):
        return ()
    stops = tuple(vehicle.getStops(name))
    if stops and vehicle.isStopped(name):
        vehicle.resume(name)
        stops = stops[1:]
    for _ in stops:
        vehicle.replaceStop(name, 0, "")
    return stops


def _restore_stops(vehicle: Any, name: str, stops: Sequence[Any]) -> None:
    """Give *name* those of *stops* that still lie ahead of it on its route."""
    for stop in stops:
        edge, _, lane = stop.lane.rpartition("_")
        place = stop.stoppingPlaceID or edge
        with contextlib.suppress(
            Exception
        ):  # libsumo and traci raise different kinds; it has passed that one
            vehicle.setStop(
                name, place, stop.endPos, int(lane), stop.duration, stop.stopFlags, stop.startPos, stop.until
            )


def _mirrored(bumper_xy_m: FloatArray, d_m: FloatArray, along_rad: FloatArray) -> FloatArray:
    """Return front-bumper points (N, 2), *d_m* left of lanes of heading *along_rad*, on the other side of them.

    With traffic on the left, SUMO counts lateral positions to the right, but moveToXY still sets them to the
    left: others would see the vehicle on the wrong side of its lane, and a released one would jump there.
    """
    along = unit(along_rad)
    left = np.stack((-along[:, 1], along[:, 0]), axis=-1)
    return bumper_xy_m - 2.0 * d_m[:, None] * left
