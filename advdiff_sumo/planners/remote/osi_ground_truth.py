"""Convert a scene to ASAM OSI ground truth, for stacks that use OSI.

ASAM OSI 3.7 ff., https://opensimulationinterface.github.io/osi-antora-documentation/. Filled in: time, host vehicle,
moving objects with base (position, size, orientation, velocity, acceleration) and classification. The world is
flat; objects reach from height 0 to ``_HEIGHT_M``.
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
    """Return the present instant of *scene* as an ``osi3.GroundTruth``; object ids come from :func:`object_id`.

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
    """Return the OSI id of the road user with SUMO's id *name*; it depends on that alone."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big") >> 1


def ground_truth_bytes(scene: Scene) -> bytes:
    """Return :func:`ground_truth` as bytes."""
    written: bytes = ground_truth(scene).SerializeToString(deterministic=True)
    return written


def _fill(item: Any, scene: Scene, row: int) -> None:
    """Write agent *row* into the ``osi3.MovingObject`` *item*."""
    history = scene.history
    x, y = history.xy_m[row, -1].tolist()
    yaw, speed = float(history.yaw_rad[row, -1]), float(history.speed_mps[row, -1])
    length, width = history.size_m[row].tolist()
    item.id.value = object_id(history.ids[row])
    base = item.base
    base.position.x, base.position.y, base.position.z = x, y, 0.5 * _HEIGHT_M
    base.dimension.length, base.dimension.width, base.dimension.height = length, width, _HEIGHT_M
    base.orientation.yaw, base.orientation.pitch, base.orientation.roll = yaw, 0.0, 0.0
    base.velocity.x, base.velocity.y, base.velocity.z = speed * np.cos(yaw), speed * np.sin(yaw), 0.0
    accel = (speed - float(history.speed_mps[row, -2])) / history.dt_s if history.steps > 1 else 0.0
    if np.isfinite(accel):
        base.acceleration.x, base.acceleration.y, base.acceleration.z = (
            accel * np.cos(yaw),
            accel * np.sin(yaw),
            0.0,
        )
    _classify(item, AgentClass(int(history.classes[row])))


def _classify(item: Any, agent_class: AgentClass) -> None:
    if agent_class is AgentClass.PEDESTRIAN:
        item.type = item.TYPE_PEDESTRIAN
        return
    item.type = item.TYPE_VEHICLE
    classification = item.vehicle_classification
    classification.type = getattr(classification, _VEHICLE_TYPES[agent_class])
