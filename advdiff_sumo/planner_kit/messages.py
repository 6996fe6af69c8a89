"""Creates the message classes of ``planner.proto`` at import, from its compiled description in the same folder.

Generated code is not used, since it runs only with matching versions of protobuf, and planners have their own version.
This module works with every protobuf from 3.20 on. ``make proto`` compiles the description.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

PACKAGE = "advdiff.planner.v1"
SERVICE = f"{PACKAGE}.Planner"
#: Version of the protocol that this package speaks.
VERSION = 1
#: File in the folder of this module: a compiled ``FileDescriptorSet``.
COMPILED = "planner.binpb"
#: Both sides accept messages of any size, as the map of a city has tens of megabytes.
CHANNEL_OPTIONS = (("grpc.max_send_message_length", -1), ("grpc.max_receive_message_length", -1))


def _pool() -> Any:
    files = descriptor_pb2.FileDescriptorSet.FromString(Path(__file__).with_name(COMPILED).read_bytes())
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.AddSerializedFile(file.SerializeToString())
    return pool


def _message(name: str) -> Any:
    descriptor = _POOL.FindMessageTypeByName(f"{PACKAGE}.{name}")
    if hasattr(message_factory, "GetMessageClass"):
        return message_factory.GetMessageClass(descriptor)
    return _OLD_FACTORY.GetPrototype(descriptor)


_POOL = _pool()
_OLD_FACTORY: Any = (
    None if hasattr(message_factory, "GetMessageClass") else message_factory.MessageFactory(_POOL)
)

DescribeRequest, Description = _message("DescribeRequest"), _message("Description")
Map, MapLoaded = _message("Map"), _message("MapLoaded")
Lane, Link, Junction, RightOfWay = (_message(name) for name in ("Lane", "Link", "Junction", "RightOfWay"))
Polygon, Ring = _message("Polygon"), _message("Ring")
Scene, Object = _message("Scene"), _message("Object")
StartRequest, StartReply = _message("StartRequest"), _message("StartReply")
PlanRequest, Plan = _message("PlanRequest"), _message("Plan")
Trajectory, Controls = _message("Trajectory"), _message("Controls")
Outcome, EpisodeEnded = _message("Outcome"), _message("EpisodeEnded")

#: Call → the classes of its request and its reply.
CALLS = {
    "Describe": (DescribeRequest, Description),
    "LoadMap": (Map, MapLoaded),
    "StartEpisode": (StartRequest, StartReply),
    "MakePlan": (PlanRequest, Plan),
    "EndEpisode": (Outcome, EpisodeEnded),
}
