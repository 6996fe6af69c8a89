"""States of all vehicles of a running simulation as arrays; a vehicle keeps its row for the whole episode."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.frames import centre_from_bumper, yaw_from_sumo
from advdiff_sumo.core.record import Controller
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.core.sumo_classes import CLASS_OF_VCLASS
from advdiff_sumo.maps.lanes import edge_of_lane

_POSITION, _ANGLE, _SPEED, _LANE, _LATERAL = 0x42, 0x43, 0x40, 0x51, 0xB8  # libsumo.constants.VAR_*
_VEHICLE = 0xC3  # the vehicle in which a person rides
PERSON = "person."  # prefix of pedestrians' names, as a person and a vehicle of SUMO may share a name
_NO_POSITION = -1e9  # coordinates below are none: SUMO's INVALID_DOUBLE_VALUE is −2³⁰
VARIABLES = (_POSITION, _ANGLE, _SPEED, _LANE, _LATERAL)


@dataclass(frozen=True)
class Frame:
    """States of the first n rows at one instant; arrays (n,) or (n, 2)."""

    xy_m: FloatArray
    yaw_rad: FloatArray
    speed_mps: FloatArray
    controller: IntArray

    @property
    def present(self) -> BoolArray:
        """(n,) whether the vehicle is present."""
        return np.asarray(self.controller != Controller.ABSENT)


class World:
    """Rows of vehicles and their present states.

    Attributes:
        ids: name of each row.
        sumo_ids: SUMO's name of each row; differs only after the vehicle was inserted into SUMO again.
        index: row of each of SUMO's names.
        in_sumo: rows that are in SUMO.
        had_in_sumo: rows that are or were in SUMO.
        on_foot: rows of pedestrians. SUMO alone moves them, and they are in neither of the two sets above.
        lane: SUMO's lane of each row at the last read; "" off the road.
        beside_m: distance of the front bumper of each row from that lane's centre line, unsigned, as SUMO has it.
        beyond_rim: edges beyond the rim of a clipped map; vehicles there are not in the scene.
        xy_m, yaw_rad, speed_mps: present states, (capacity, …); NaN where absent.
        controller: (capacity,) values of :class:`Controller`.
    """

    def __init__(self, capacity: int = 64, beyond_rim: Collection[str] = frozenset()) -> None:
        self.ids: list[str] = []
        self.sumo_ids: list[str] = []
        self.index: dict[str, int] = {}
        self.in_sumo: set[int] = set()
        self.had_in_sumo: set[int] = set()
        self.on_foot: set[int] = set()
        self.lane: list[str] = []
        self.beside_m: list[float] = []
        self.beyond_rim = beyond_rim
        self.classes = np.zeros(capacity, dtype=np.int64)
        self.size_m = np.zeros((capacity, 2))
        self.xy_m = np.full((capacity, 2), np.nan)
        self.yaw_rad = np.full(capacity, np.nan)
        self.speed_mps = np.full(capacity, np.nan)
        self.controller = np.full(capacity, Controller.ABSENT, dtype=np.int64)

    def __len__(self) -> int:
        return len(self.ids)

    def add(self, name: str, agent_class: int, length_m: float, width_m: float) -> int:
        """Return the row of *name*; add one if the name is new."""
        if name in self.index:
            return self.index[name]
        row = len(self.ids)
        if row == len(self.classes):
            self._grow()
        self.ids.append(name)
        self.sumo_ids.append(name)
        self.lane.append("")
        self.beside_m.append(0.0)
        self.index[name] = row
        self.classes[row] = agent_class
        self.size_m[row] = length_m, width_m
        return row

    def row_of(self, name: str) -> int | None:
        """Return the row of *name*, or None if it was never present."""
        return self.index.get(name)

    def rename(self, row: int, sumo_id: str) -> None:
        """Note that SUMO has *row* under the name *sumo_id* from now on."""
        self.sumo_ids[row] = sumo_id
        self.index[sumo_id] = row

    def set_state(
        self,
        rows: IntArray,
        xy_m: FloatArray,
        yaw_rad: FloatArray,
        speed_mps: FloatArray,
        controller: Controller | IntArray,
    ) -> None:
        """Set the states of *rows* and their *controller*: one for all, or (N,) values of :class:`Controller`."""
        self.xy_m[rows] = xy_m
        self.yaw_rad[rows] = yaw_rad
        self.speed_mps[rows] = speed_mps
        self.controller[rows] = controller

    def remove(self, rows: IntArray | Iterable[int]) -> None:
        """Mark *rows* as absent; the vehicles keep their rows."""
        row_array = np.asarray(list(rows), dtype=np.int64)
        for values in (self.xy_m, self.yaw_rad, self.speed_mps):
            values[row_array] = np.nan
        self.controller[row_array] = Controller.ABSENT

    def frame(self) -> Frame:
        """Return a copy of the present states."""
        n = len(self.ids)
        return Frame(
            self.xy_m[:n].copy(),
            self.yaw_rad[:n].copy(),
            self.speed_mps[:n].copy(),
            self.controller[:n].copy(),
        )

    def _grow(self) -> None:
        """Double the capacity."""
        added = len(self.classes)
        self.classes = np.concatenate((self.classes, np.zeros(added, dtype=np.int64)))
        self.size_m = np.concatenate((self.size_m, np.zeros((added, 2))))
        self.xy_m = np.concatenate((self.xy_m, np.full((added, 2), np.nan)))
        self.yaw_rad = np.concatenate((self.yaw_rad, np.full(added, np.nan)))
        self.speed_mps = np.concatenate((self.speed_mps, np.full(added, np.nan)))
        self.controller = np.concatenate((self.controller, np.full(added, Controller.ABSENT, dtype=np.int64)))


def register(world: World, api: Any, names: Iterable[str]) -> list[int]:
    """Subscribe to vehicles that SUMO has just inserted, and return their rows."""
    rows = []
    for name in names:
        api.vehicle.subscribe(name, VARIABLES)
        vclass = AgentClass(CLASS_OF_VCLASS.get(api.vehicle.getVehicleClass(name), AgentClass.CAR))
        row = world.add(name, vclass, api.vehicle.getLength(name), api.vehicle.getWidth(name))
        world.in_sumo.add(row)
        world.had_in_sumo.add(row)
        rows.append(row)
    return rows


def read(world: World, api: Any, controlled: Collection[int]) -> IntArray:
    """Read the states of all vehicles and pedestrians from SUMO.

    Args:
        world: updated in place.
        api: libsumo or traci.
        controlled: rows whose states are the package's own; only their lane and distance from it are read.

    Returns:
        Rows that SUMO no longer has, or has beyond the rim of the map.
    """
    # before the first step, libsumo still returns the subscriptions of the previous simulation
    results = {k: v for k, v in api.vehicle.getAllSubscriptionResults().items() if k in world.index}
    rows, states, lost = [], [], []
    rim = world.beyond_rim
    for name, values in results.items():
        row = world.index[name]
        world.lane[row], world.beside_m[row] = values[_LANE], abs(values[_LATERAL])
        x, y = values[_POSITION][:2]
        if row in controlled:
            continue
        if x < _NO_POSITION or (rim and edge_of_lane(values[_LANE]) in rim):
            lost.append(row)  # off the road or beyond the rim, but not arrived
        else:
            rows.append(row)
            states.append((x, y, values[_ANGLE], values[_SPEED]))
    if rows:
        _set_states(world, np.array(rows), np.array(states))
    before = world.in_sumo
    world.in_sumo = {world.index[name] for name in results}
    lost += _read_people(world, api)
    return np.array(sorted((before - world.in_sumo).union(lost)), dtype=np.int64)


def _read_people(world: World, api: Any) -> list[int]:
    """Read the states of pedestrians from SUMO and return the rows of those that have left.

    People in vehicles are not pedestrians.
    """
    names = api.person.getIDList()
    if not names and not world.on_foot:
        return []
    rows, states = [], []
    for name in names:
        row = world.row_of(PERSON + name)
        if row is None or row not in world.on_foot:
            row = _add_person(world, api, name)
        values = api.person.getSubscriptionResults(name)
        if not values[_VEHICLE] and values[_POSITION][0] > _NO_POSITION:
            rows.append(row)
            states.append((*values[_POSITION][:2], values[_ANGLE], values[_SPEED]))
    gone = sorted(world.on_foot.difference(rows))
    world.on_foot = set(rows)
    if rows:
        _set_states(world, np.array(rows), np.array(states))
    return gone


def _add_person(world: World, api: Any, name: str) -> int:
    """Subscribe to pedestrian *name* and return the row for it."""
    api.person.subscribe(name, (_POSITION, _ANGLE, _SPEED, _VEHICLE))
    size_m = api.person.getLength(name), api.person.getWidth(name)
    return world.add(PERSON + name, AgentClass.PEDESTRIAN, *size_m)


def _set_states(world: World, rows: IntArray, states: FloatArray) -> None:
    """Set (N, 4) states of SUMO: front bumper x and y, angle in degrees, speed."""
    yaw = yaw_from_sumo(states[:, 2])
    centre = centre_from_bumper(states[:, :2], yaw, world.size_m[rows, 0])
    world.set_state(rows, centre, yaw, states[:, 3], Controller.SUMO)


def stack(
    world: World, frames: list[Frame], rows: IntArray, t0_s: float, dt_s: float
) -> tuple[Tracks, IntArray]:
    """Return tracks (A, T) of *rows* over *frames*, and which controller moved them (A, T)."""
    shape = (len(rows), len(frames))
    xy, yaw, speed = np.full((*shape, 2), np.nan), np.full(shape, np.nan), np.full(shape, np.nan)
    controller = np.full(shape, Controller.ABSENT, dtype=np.int64)
    for t, frame in enumerate(frames):
        is_known = rows < len(frame.yaw_rad)
        known_rows = rows[is_known]
        xy[is_known, t], yaw[is_known, t] = frame.xy_m[known_rows], frame.yaw_rad[known_rows]
        speed[is_known, t], controller[is_known, t] = (
            frame.speed_mps[known_rows],
            frame.controller[known_rows],
        )
    tracks = Tracks(
        ids=tuple(world.ids[row] for row in rows),
        classes=world.classes[rows],
        size_m=world.size_m[rows],
        xy_m=xy,
        yaw_rad=yaw,
        speed_mps=speed,
        valid=controller != Controller.ABSENT,
        t0_s=t0_s,
        dt_s=dt_s,
    )
    return tracks, controller
