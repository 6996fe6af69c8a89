"""Vehicles and people on foot of an OpenSCENARIO file, and where their reference points are; needs the extra."""

from __future__ import annotations

from dataclasses import dataclass

from scenariogeneration import xosc

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.export.export_scene import ExportScene

#: Usual share of the length between the axles; the box's centre is taken to be half-way.
WHEELBASE_SHARE = 0.6
_HEIGHT_M = {AgentClass.CAR: 1.6, AgentClass.TRUCK: 3.2, AgentClass.BUS: 3.2}
_LOW_HEIGHT_M = 1.7
_WHEEL_M, _TOP_MPS, _ACCEL_MPS2, _BRAKE_MPS2, _STEER_RAD = 0.6, 70.0, 10.0, 10.0, 0.6
_PERSON_KG = 80


@dataclass(frozen=True)
class Reference:
    """The point of a box that OpenSCENARIO's positions are of.

    Attributes:
        centre_ahead_m: how far the box's centre is ahead of it.
    """

    centre_ahead_m: float

    def from_centre(self, centre_xy_m: FloatArray, yaw_rad: FloatArray) -> FloatArray:
        """Return reference points (…, 2) of box centres."""
        return centre_xy_m - self.centre_ahead_m * unit(yaw_rad)


def reference_of(kind: int, length_m: float) -> Reference:
    """Return the reference point: the rear axle's centre, or the box's centre of people on foot."""
    if kind == AgentClass.PEDESTRIAN:
        return Reference(0.0)
    return Reference(round(0.5 * WHEELBASE_SHARE * length_m, 4))


def entity_of(scene: ExportScene, row: int, name: str) -> xosc.Vehicle | xosc.Pedestrian:
    """Return the entity of an agent; the properties ``agent`` and ``role`` keep its name and who is tested."""
    kind = AgentClass(int(scene.tracks.classes[row]))
    length, width = (round(float(x), 4) for x in scene.tracks.size_m[row])
    reference, height = reference_of(kind, length), _HEIGHT_M.get(kind, _LOW_HEIGHT_M)
    box = xosc.BoundingBox(width, length, height, reference.centre_ahead_m, 0, round(0.5 * height, 4))
    entity: xosc.Vehicle | xosc.Pedestrian
    if kind is AgentClass.PEDESTRIAN:
        entity = xosc.Pedestrian(name, _PERSON_KG, xosc.PedestrianCategory.pedestrian, box)
    else:
        base = 2.0 * reference.centre_ahead_m
        front = xosc.Axle(_STEER_RAD, _WHEEL_M, width, base, 0.5 * _WHEEL_M)
        rear = xosc.Axle(0, _WHEEL_M, width, 0, 0.5 * _WHEEL_M)
        limits = (_TOP_MPS, _ACCEL_MPS2, _BRAKE_MPS2)
        entity = xosc.Vehicle(name, _category(kind), box, front, rear, *limits)
    entity.add_property("agent", scene.tracks.ids[row])
    entity.add_property("role", "target" if row == scene.target else "other")
    return entity


def _category(kind: AgentClass) -> xosc.VehicleCategory:
    return {
        AgentClass.TRUCK: xosc.VehicleCategory.truck,
        AgentClass.BUS: xosc.VehicleCategory.bus,
        AgentClass.MOTORCYCLE: xosc.VehicleCategory.motorbike,
        AgentClass.BICYCLE: xosc.VehicleCategory.bicycle,
    }.get(kind, xosc.VehicleCategory.car)
