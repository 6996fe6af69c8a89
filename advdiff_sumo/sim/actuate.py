"""Move vehicles with SUMO's moveToXY, so that SUMO's drivers react to them (measured behaviour: docs/sumo.md).

SUMO does not document these rules, which this module follows:

1. A vehicle must have been on a lane before anything else is done with it.
2. SUMO's drivers do not see a vehicle that is off the lanes, or whose front bumper is beside the lane that SUMO has it
   on. With sublanes the next step can then end the process. Such a vehicle is removed from SUMO and inserted again when
   it is back on a lane; the package's own states continue meanwhile.
3. Removing a vehicle directly after a move can also end the process. SUMO first drives it for one step.
4. On a junction a vehicle needs a route over the junction's lane, and the route cannot be changed there.
5. A moved vehicle loses its route unless SUMO is given the edges that the vehicle is about to drive.
6. Other drivers see a speed of at most the lane's limit times the vehicle's speed factor.
7. If a stop lies ahead, they see the speed of SUMO's own driver, so that followers run into a standing vehicle. Stops
   are therefore removed while the vehicle is moved.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.errors import NotInsertedError
from advdiff_sumo.core.frames import bumper_from_centre, sumo_from_yaw, unit
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.core.sumo_classes import VCLASS_OF_CLASS
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.world import World

# Values of moveToXY's keepRoute.
_NEAREST = 1  # the nearest position on the vehicle's own route
_EXACT = 2  # the exact position, on any edge
_EXACT_ON_ROUTE = 3  # the exact position, on the vehicle's own route only
# High enough that the lane's limit never reduces the speed of a moved vehicle.
_FREE_SPEED_FACTOR, _FREE_MAX_SPEED_MPS = 20.0, 90.0
_SAME_OFFSET_M = 0.2
_NO_CHECKS = 0  # SUMO's speed mode and lane-change mode without any checks
_DEFAULT_SPEED_MODE, _DEFAULT_LANE_CHANGE_MODE = 31, 1621  # SUMO's defaults


@dataclass
class MovedVehicle:
    """What SUMO had set for a vehicle before it was moved, and the route given to it since.

    Attributes:
        speed_factor: SUMO's own value, to be restored.
        max_speed_mps: SUMO's own value, to be restored.
        stops: SUMO's stops that still lie ahead, to be restored.
        route: edges last given to SUMO; () if SUMO may look for a lane on any edge.
        inserted: False until SUMO has inserted the vehicle.
    """

    speed_factor: float
    max_speed_mps: float
    stops: tuple[Any, ...] = ()
    route: tuple[str, ...] = ()
    inserted: bool = True


@dataclass
class Actuator:
    """Moves vehicles of one episode in SUMO.

    Attributes:
        api: libsumo or traci.
        world: rows and states.
        road: the map.
        moved: row → what was changed in SUMO.
        outside: rows of vehicles that are moved off the lanes, and are therefore not in SUMO.
        refused: rows that SUMO refused to insert on the lane nearest to them; they stay outside.
    """

    api: Any
    world: World
    road: RoadMap
    moved: dict[int, MovedVehicle] = field(default_factory=dict)
    outside: set[int] = field(default_factory=set)
    refused: set[int] = field(default_factory=set)
    _leaving: set[int] = field(default_factory=set)
    _last_edges: dict[int, tuple[str, ...]] = field(default_factory=dict)
    _insert_counts: dict[int, int] = field(default_factory=dict)

    @property
    def controlled_rows(self) -> set[int]:
        """Rows whose states are this package's own: in SUMO, outside it, or about to be removed from it."""
        return self.outside | self.moved.keys() | self._leaving

    def take(self, row: int) -> None:
        """Begin to move *row*, which is on a lane and so far driven by SUMO."""
        vehicle, name = self.api.vehicle, self.world.sumo_ids[row]
        speed_factor, max_speed = vehicle.getSpeedFactor(name), vehicle.getMaxSpeed(name)
        self.moved[row] = MovedVehicle(speed_factor, max_speed, _set_aside_stops(vehicle, name))
        vehicle.setMaxSpeed(name, _FREE_MAX_SPEED_MPS)  # resets the speed factor, so it comes first
        vehicle.setSpeedFactor(name, _FREE_SPEED_FACTOR)
        vehicle.setSpeedMode(name, _NO_CHECKS)
        vehicle.setLaneChangeMode(name, _NO_CHECKS)

    def release(self, row: int, route: Sequence[str] = ()) -> None:
        """Let SUMO drive *row* again, from its present pose and speed."""
        original = self.moved.pop(row)
        name, vehicle = self.world.sumo_ids[row], self.api.vehicle
        if route:
            self._set_route(name, tuple(route))
        vehicle.setMaxSpeed(name, original.max_speed_mps)
        vehicle.setSpeedFactor(name, original.speed_factor)
        vehicle.setSpeedMode(name, _DEFAULT_SPEED_MODE)
        vehicle.setLaneChangeMode(name, _DEFAULT_LANE_CHANGE_MODE)
        vehicle.setPreviousSpeed(name, max(float(self.world.speed_mps[row]), 0.0))
        _restore_stops(vehicle, name, original.stops)

    def insert(self, row: int, type_id: str) -> None:
        """Insert *row* into SUMO: in the next step on the lane nearest to its pose, after that exactly at its pose.

        Raises:
            NotInsertedError: the net has no suitable lane, or SUMO refuses the vehicle.
        """
        vclass = VCLASS_OF_CLASS[AgentClass(int(self.world.classes[row]))]
        name = self._fresh_name(row)
        insertion = self._insertion_point(row, vclass)
        if insertion is None:
            raise NotInsertedError(f"no lane of {self.road.name} is open to '{name}', a {vclass}")
        lane_id, bumper, heading_rad = insertion
        try:
            self.api.route.add(f"insert:{name}", self._edges_at(lane_id))
            self.api.vehicle.add(name, f"insert:{name}", typeID=type_id, depart="now", departPos="base")
            self._set_size(name, row)
            # keepRoute 0 before departure would reset the route in every later step, whatever setRoute says
            self.api.vehicle.moveToXY(
                name, "", -1, *bumper.tolist(), angle=float(sumo_from_yaw(heading_rad)), keepRoute=_NEAREST
            )
        except Exception as error:
            self._cancel_insertion(name)
            raise NotInsertedError(f"SUMO refuses to insert '{name}': {error}") from error
        self.moved[row] = MovedVehicle(1.0, _FREE_MAX_SPEED_MPS, inserted=False)
        self.outside.discard(row)

    def _insertion_point(self, row: int, vclass: str) -> tuple[str, FloatArray, float] | None:
        """Return the lane nearest to *row*, with front bumper (2,) and heading of a vehicle centred on it there.

        A vehicle that has just been removed from SUMO gets the lane under its bumper, preferably one that leads on from
        the lane where it was.
        """
        xy, yaw, length = self.world.xy_m[row], self.world.yaw_rad[row], self.world.size_m[row, 0]
        edges = self._last_edges.pop(row, None)
        if edges is None:
            pose = self.road.locate(xy, float(yaw), vclass=vclass, max_distance_m=np.inf)
        else:
            bumper = bumper_from_centre(xy, yaw, length)
            pose = self.road.locate(bumper, float(yaw), vclass=vclass, max_distance_m=np.inf, route=edges)
            if pose is not None and abs(pose.d_m) > 0.5 * self.road.lanes[pose.lane_id].width_m:
                pose = self.road.locate(bumper, float(yaw), vclass=vclass, max_distance_m=np.inf)
        if pose is None:
            return None
        lane_xy, heading_rad = self.road.to_world(pose.lane_id, pose.s_m)
        front = bumper_from_centre(lane_xy, heading_rad, length) if edges is None else lane_xy
        return pose.lane_id, front, float(heading_rad)

    def _edges_at(self, lane_id: str) -> list[str]:
        """Return the shortest route over *lane_id*; for a lane of a junction, the two edges that it connects."""
        link = self.road.link_of_internal_lane.get(lane_id)
        ends = (lane_id,) if link is None else (link.from_lane, link.to_lane)
        return [self.road.edge_of(lane) for lane in ends]

    def _set_size(self, name: str, row: int) -> None:
        """Give *name* its own length and width in place of its type's; SUMO derives the rear from them."""
        length, width = self.world.size_m[row].tolist()
        self.api.vehicle.setLength(name, length)
        self.api.vehicle.setWidth(name, width)

    def try_insert(self, row: int, type_id: str) -> None:
        """Insert *row* into SUMO; if SUMO refuses, note that and move *row* outside SUMO."""
        try:
            self.insert(row, type_id)
        except NotInsertedError:
            self.refused.add(row)
            self.outside.add(row)

    def _cancel_insertion(self, name: str) -> None:
        """Remove *name* from SUMO if the refused insertion left it there."""
        with contextlib.suppress(Exception):  # libsumo and traci raise different types if there is none
            self.api.vehicle.remove(name)

    def is_on_lane(self, rows: IntArray, xy_m: FloatArray, yaw_rad: FloatArray) -> BoolArray:
        """Return (N, …) whether the front bumper's centre of each of *rows* is on a lane at poses (N, …, 2), (N, …)."""
        length_m = self.world.size_m[rows, 0].reshape(-1, *(1,) * (yaw_rad.ndim - 1))
        bumper = bumper_from_centre(xy_m, yaw_rad, length_m)
        return self.road.on_lane(bumper.reshape(-1, 2), yaw_rad.reshape(-1)).reshape(yaw_rad.shape)

    def on_lanes(self, rows: IntArray, xy_m: FloatArray, yaw_rad: FloatArray) -> set[int]:
        """Return those of *rows* whose front bumper's centre is on a lane, with the vehicles at poses (N, 2), (N,)."""
        return set(rows[self.is_on_lane(rows, xy_m, yaw_rad)].tolist())

    def take_inserted(self, departed: Sequence[int]) -> None:
        """Begin to move the vehicles among *departed* that SUMO has just inserted for us."""
        for row in departed:
            if row in self.moved and not self.moved[row].inserted:
                self.take(row)

    def remove(self, row: int) -> None:
        """Remove *row* from the scene; SUMO loses it after the next step."""
        self.outside.discard(row)
        self._remove_after_step(row)

    def remove_off_lanes(self) -> IntArray:
        """Remove vehicles from SUMO that its last step has off the lanes, or beside the lane that it has them on.

        Also remove the vehicles that SUMO was to drive for that step only (:meth:`_remove_after_step`). Return the rows
        of the former.
        """
        for row in sorted(self._leaving & self.world.in_sumo):
            self._remove_now(row)
        self._leaving.clear()
        off_lane = [row for row, moved in self.moved.items() if moved.inserted and not self._on_its_lane(row)]
        for row in off_lane:
            del self.moved[row]
            self._last_edges[row] = self._connected_edges(self.world.lane[row])
            self._remove_now(row)
            self.outside.add(row)
        return np.array(off_lane, dtype=np.int64)

    def _connected_edges(self, lane_id: str) -> tuple[str, ...]:
        """Return the edge of *lane_id* and its successors, alternating; in a junction, those of the edge before it."""
        link = self.road.link_of_internal_lane.get(lane_id)
        if lane_id not in self.road.lanes:
            return ()
        edge = self.road.edge_of(lane_id if link is None else link.from_lane)
        return tuple(e for successor in self.road.edges[edge].successors for e in (edge, successor)) or (
            edge,
        )

    def _on_its_lane(self, row: int) -> bool:
        """Return whether SUMO has the front bumper's centre of *row* within its lane.

        At the beginning of a route it may be metres beside it: SUMO looks for a lane on the route only, and takes the
        nearest end. A step with sublanes then reads freed memory (docs/sumo.md).
        """
        lane = self.road.lanes.get(self.world.lane[row])
        return lane is not None and self.world.beside_m[row] <= 0.5 * lane.width_m

    def _remove_after_step(self, row: int) -> None:
        """Let SUMO drive *row* for one step, and remove it from SUMO then.

        After moveToXY, SUMO may register the vehicle also on a lane beside its own, and keep it there after it has been
        removed. A step of SUMO's own corrects this (docs/sumo.md).
        """
        moved = self.moved.pop(row, None)
        if moved is not None and moved.inserted:
            self._leaving.add(row)
        elif moved is not None:
            self._remove_now(row)

    def _remove_now(self, row: int) -> None:
        name = self.world.sumo_ids[row]
        self.api.vehicle.unsubscribe(name)  # otherwise the next step fails at the unknown name
        self.api.vehicle.remove(name)
        self.world.in_sumo.discard(row)

    def sumo_agrees(self, row: int, lane: str | None, d_m: float) -> bool:
        """Return whether SUMO has *row* on *lane*, *d_m* to its left; where lanes overlap it may be on another one."""
        name = self.world.sumo_ids[row]
        left_m = float(self.api.vehicle.getLateralLanePosition(name)) * (-1.0 if self.road.lefthand else 1.0)
        return self.world.lane[row] == lane and abs(left_m - d_m) <= _SAME_OFFSET_M

    def move(self, rows: IntArray, xy_m: FloatArray, yaw_rad: FloatArray, is_on_lane: BoolArray) -> None:
        """Put *rows* at poses (N, 2), (N,) in the next step, and remove those from SUMO that leave the lanes.

        Rows that are outside SUMO or still being inserted are ignored. *is_on_lane* (N,) is of :meth:`is_on_lane`.
        """
        is_inserted = [row in self.moved and self.moved[row].inserted for row in rows.tolist()]
        rows, xy_m, yaw_rad = rows[is_inserted], xy_m[is_inserted], yaw_rad[is_inserted]
        bumper = bumper_from_centre(xy_m, yaw_rad, self.world.size_m[rows, 0])
        is_on_lane = is_on_lane[is_inserted]
        for row in rows[~is_on_lane].tolist():
            self._remove_after_step(row)
            self.outside.add(row)
        if self.road.lefthand:
            _, _, lateral_m, yaw_error = self.road.locate_many(bumper, yaw_rad)
            bumper = _mirrored(bumper, lateral_m, yaw_rad - yaw_error)
        names, moved = self.world.sumo_ids, self.moved
        poses = zip(
            rows[is_on_lane].tolist(),
            bumper[is_on_lane].tolist(),
            sumo_from_yaw(yaw_rad[is_on_lane]).tolist(),
            strict=True,
        )
        for row, (x, y), angle_deg in poses:
            keep_route = _EXACT_ON_ROUTE if moved[row].route else _EXACT
            self.api.vehicle.moveToXY(names[row], "", -1, x, y, angle_deg, keep_route)

    def predict_route(self, row: int, route: tuple[str, ...]) -> None:
        """Tell SUMO which edges *row* is about to drive, so that drivers at junctions yield to it (#6140)."""
        moved = self.moved.get(row)
        if moved is None:
            return
        is_known = bool(route) and moved.route[-len(route) :] == route
        if moved.inserted and not is_known:
            moved.route = route if route and self._set_route(self.world.sumo_ids[row], route) else ()

    def _set_route(self, name: str, route: tuple[str, ...]) -> bool:
        """Set *route* and return whether SUMO accepted it; it must begin at the edge where SUMO has the vehicle."""
        vehicle = self.api.vehicle
        current = vehicle.getRoute(name)[max(vehicle.getRouteIndex(name), 0)]
        if current in route:
            route = route[route.index(current) :]
        elif route[0] in self.road.edges[current].successors:
            # on a junction SUMO still reports the edge before it
            route = (current, *route)
        else:
            return False
        try:
            vehicle.setRoute(name, list(route))
        except Exception:  # noqa: BLE001 - libsumo and traci raise different types; SUMO then keeps the old route
            return False
        return True

    def _fresh_name(self, row: int) -> str:
        """Return a name that SUMO has not had in this simulation, and note it; the first is the vehicle's own."""
        count = self._insert_counts.get(row, int(row in self.world.had_in_sumo))
        self._insert_counts[row] = count + 1
        name = self.world.ids[row] + (f"~{count}" if count else "")
        self.world.rename(row, name)
        return name


def _set_aside_stops(vehicle: Any, name: str) -> tuple[Any, ...]:
    """Remove the stops of *name* and return those still ahead; a vehicle that stands at a stop is resumed.

    Parked vehicles keep theirs, and () is returned.
    """
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
    """Set those of *stops* again that still lie ahead of *name* on its route."""
    for stop in stops:
        edge, _, lane = stop.lane.rpartition("_")
        place = stop.stoppingPlaceID or edge
        # libsumo and traci raise different types for a stop that the vehicle has passed
        with contextlib.suppress(Exception):
            vehicle.setStop(
                name, place, stop.endPos, int(lane), stop.duration, stop.stopFlags, stop.startPos, stop.until
            )


def _mirrored(bumper_xy_m: FloatArray, d_m: FloatArray, along_rad: FloatArray) -> FloatArray:
    """Return front bumpers (N, 2) mirrored at their lanes' centre lines, *d_m* left of lanes of heading *along_rad*.

    With traffic on the left, SUMO counts lateral positions to the right, but moveToXY still sets them to the left.
    Unmirrored, others would see the vehicle on the wrong side of its lane, and a released one would jump there.
    """
    forward = unit(along_rad)
    left = np.stack((-forward[:, 1], forward[:, 0]), axis=-1)
    return bumper_xy_m - 2.0 * d_m[:, None] * left
