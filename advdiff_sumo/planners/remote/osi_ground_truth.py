"""A scene as ASAM OSI ground truth, for stacks that speak OSI.

ASAM OSI 3.7 ff., https://opensimulationinterface.github.io/osi-antora-documentation/. Filled in: time, host vehicle,
moving objects with base (position, size, orientation, velocity, acceleration) and classification. Heights are 0 to
``_HEIGHT_M``, as the world is flat.
"""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np

from advdiff_sumo.core.errors import MissingExtraError
from advdiff_sumo.core.scene import AgentClass, Scene

_HEIGHT_M = 1.6
_VEHICLE_TYPES = {
    AgentClass.CAR: "TYPE_MEDIUM_CAR",
    AgentClass.TRUCK: "TYPE_HEAVY_TRUCK",
    AgentClass.BUS: "TYPE_BUS",
    AgentClass.MOTORCYCLE: "TYPE_MOTORBIKE",
    AgentClass.BICYCLE: "TYPE_BICYCLE",
}


def ground_truth(scene: Scene) -> Any:
    """Return *scene* as an ``osi3.GroundTruth`` of now; object ids are :func:`object_id` of their names.

    Raises:
        MissingExtraError: ``osi-python`` is not installed.
    """
    try:
        from osi3 import osi_groundtruth_pb2
    except ImportError:
        raise MissingExtraError("OSI ground truth", "osi") from None
    truth = osi_groundtruth_pb2.GroundTruth()
    truth.version.version_major, truth.version.version_minor = 3, 7
    nanos = round(scene.time_s * 1e9)
    truth.timestamp.seconds, truth.timestamp.nanos = divmod(nanos, 1_000_000_000)
    truth.host_vehicle_id.value = object_id(scene.history.ids[scene.target])
    for row in np.flatnonzero(scene.history.valid[:, -1]).tolist():
        _fill(truth.moving_object.add(), scene, row)
    return truth


def object_id(name: str) -> int:
    """Return the OSI id of the road user whom SUMO calls *name*: the same for as long as it is there, and anywhere."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big") >> 1


def ground_truth_bytes(scene: Scene) -> bytes:
    """Return :func:`ground_truth` as bytes."""
    written: bytes = ground_truth(scene).SerializeToString(deterministic=True)
    return written


def _fill(thing: Any, scene: Scene, row: int) -> None:
    """Write agent *row* into the ``osi3.MovingObject`` *thing*."""
    now = scene.history
    x, y = now.xy_m[row, -1].tolist()
    yaw, speed = float(now.yaw_rad[row, -1]), float(now.speed_mps[row, -1])
    length, width = now.size_m[row].tolist()
    thing.id.value = object_id(now.ids[row])
    base = thing.base
    base.position.x, base.position.y, base.position.z = x, y, 0.5 * _HEIGHT_M
    base.dimension.length, base.dimension.width, base.dimension.height = length, width, _HEIGHT_M
    base.orientation.yaw, base.orientation.pitch, base.orientation.roll = yaw, 0.0, 0.0
    base.velocity.x, base.velocity.y, base.velocity.z = speed * np.cos(yaw), speed * np.sin(yaw), 0.0
    accel = (speed - float(now.speed_mps[row, -2])) / now.dt_s if now.steps > 1 else 0.0
    if np.isfinite(accel):
        base.acceleration.x, base.acceleration.y, base.acceleration.z = (
            accel * np.cos(yaw),
            accel * np.sin(yaw),
            0.0,
        )
    _classify(thing, AgentClass(int(now.classes[row])))


def _classify(thing: Any, agent_class: AgentClass) -> None:
    if agent_class is AgentClass.PEDESTRIAN:
        thing.type = thing.TYPE_PEDESTRIAN
        return
    thing.type = thing.TYPE_VEHICLE
    kinds = thing.vehicle_classification
    kinds.type = getattr(kinds, _VEHICLE_TYPES[agent_class])
