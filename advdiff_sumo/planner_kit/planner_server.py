"""Serves a Python planner over gRPC, one call at a time."""

from __future__ import annotations

import contextlib
import os
import sys
import traceback
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, NoReturn

import grpc
import numpy as np

from advdiff_sumo.core.output import flush_output
from advdiff_sumo.core.plan import Controls, Trajectory
from advdiff_sumo.core.plug_in_source import call_problem, described, lacks_memory, planned_at, raised_at
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.planner_kit import messages
from advdiff_sumo.planner_kit.kit_road import road_of
from advdiff_sumo.planner_kit.wire import plan_message, scene_of

#: Environment variable with the address at which ``--target "exec:…"`` expects the planner.
ADDRESS_VARIABLE = "ADVDIFF_PLANNER_ADDRESS"
DEFAULT_ADDRESS = "localhost:50051"
#: Key of the traceback of a failed call in the trailing metadata of the reply.
TRACE_KEY = "advdiff-trace-bin"
_KEPT_EPISODES, _KEPT_MAPS = 64, 8
_LARGEST_PORT = 65535
_MESSAGE_BYTES, _TRACE_BYTES = 500, 4000  # upper limits, as gRPC limits the size of headers


@dataclass
class _Episode:
    """A running episode: its map, the planner's memory and random numbers, and the time between two plans."""

    road: Any
    memory: Any
    rng: np.random.Generator
    replan_s: float


class _NoPlanError(Exception):
    """The planner returned something that is not a plan."""


class PlannerServer:
    """Handles the calls of ``planner.proto`` with a planner that has the methods ``start`` and ``plan``.

    If the planner has a method ``end(memory, end)``, it is called with the word for how the episode ended.
    """

    def __init__(
        self, planner: Any, name: str, version: str, wants_osi: bool, read_road: Callable[[str], Any] | None
    ) -> None:
        self.planner, self.name, self.version, self.wants_osi = planner, name, version, wants_osi
        self._read_road = read_road
        self._roads: OrderedDict[str, Any] = OrderedDict()
        self._episodes: OrderedDict[str, _Episode] = OrderedDict()

    def Describe(self, request: Any) -> Any:  # noqa: N802 - the call's name
        """Return the planner's name and version, and that of the protocol."""
        del request
        return messages.Description(
            protocol_version=messages.VERSION,
            name=self.name,
            version=self.version,
            wants_osi=self.wants_osi,
        )

    def LoadMap(self, request: Any) -> Any:  # noqa: N802 - the call's name
        """Store a map, and remove the oldest of too many."""
        self._roads[request.map_id] = (
            self._read_road(request.net_path) if self._read_road else road_of(request)
        )
        _drop_oldest(self._roads, _KEPT_MAPS)
        return messages.MapLoaded()

    def StartEpisode(self, request: Any) -> Any:  # noqa: N802 - the call's name
        """Start an episode, or reply that its map is needed."""
        road = self._roads.get(request.map_id)
        if road is None:
            return messages.StartReply(need_map=True)
        self._roads.move_to_end(request.map_id)
        rng = np.random.default_rng(request.seed)
        memory = self.planner.start(road, _scene(request.scene, request.model_step_s), rng)
        self._episodes[request.episode_id] = _Episode(road, memory, rng, request.model_step_s)
        _drop_oldest(self._episodes, _KEPT_EPISODES)
        return messages.StartReply()

    def MakePlan(self, request: Any) -> Any:  # noqa: N802 - the call's name
        """Return a plan for the scene of an episode, and store the planner's memory."""
        episode = self._episodes.get(request.episode_id)
        if episode is None:
            raise RuntimeError("this episode was not started here; was the server restarted?")
        scene = _scene(request.scene, episode.replan_s)
        result = self.planner.plan(episode.road, scene, episode.memory, episode.rng)
        if not (
            isinstance(result, tuple) and len(result) == 2 and isinstance(result[0], (Trajectory, Controls))
        ):
            first = result[0] if isinstance(result, tuple) and len(result) == 2 else result
            raise _NoPlanError(
                f"plan() returned {type(first).__name__}, not (Trajectory or Controls, memory)"
                f"{planned_at(self.planner)}"
            )
        plan, episode.memory = result
        try:
            return plan_message(plan)
        except ValueError as error:
            problem = f"planned {type(plan).__name__} that cannot be driven: {error}"
            raise _NoPlanError(f"{problem}{planned_at(self.planner)}") from None

    def EndEpisode(self, request: Any) -> Any:  # noqa: N802 - the call's name
        """End an episode and remove it."""
        episode = self._episodes.pop(request.episode_id, None)
        end = getattr(self.planner, "end", None)
        if episode is not None and callable(end):
            end(episode.memory, request.end)
        return messages.EpisodeEnded()

    def handlers(self) -> Any:
        """Return the gRPC handlers of all calls."""
        calls = {}
        for name, (request_class, reply_class) in messages.CALLS.items():
            calls[name] = grpc.unary_unary_rpc_method_handler(
                _reporting_errors(getattr(self, name)),
                request_deserializer=request_class.FromString,
                response_serializer=reply_class.SerializeToString,
            )
        return grpc.method_handlers_generic_handler(messages.SERVICE, calls)


def serve(
    planner: Any,
    address: str | None = None,
    *,
    name: str = "",
    version: str = "",
    wants_osi: bool = False,
    read_road: Callable[[str], Any] | None = None,
) -> None:
    """Serve *planner* until this process ends.

    Args:
        planner: an object with ``start(road, scene, rng)`` and ``plan(road, scene, memory, rng)``, or its class.
        address: ``HOST:PORT`` or ``unix:PATH``; by default the one that ``--target "exec:…"`` sets, else port 50051.
        name: name of the planner, for messages.
        version: version of the planner.
        wants_osi: whether ``start`` and ``plan`` receive an :class:`OsiScene`.
        read_road: function, such as ``RoadMap.read``, that returns the planner's map for the path of the net; by
            default the planner receives a :class:`~advdiff_sumo.planner_kit.kit_road.KitRoad`.

    Raises:
        TypeError: *planner* cannot be called as a planner is.
        RuntimeError: the address is in use, or none of this machine.
    """
    planner_object = planner() if isinstance(planner, type) else planner
    if problem := call_problem(planner_object):
        kind = type(planner_object).__name__
        raise TypeError(f"{kind} {problem}; give serve() a planner, or its class")
    bound_address = address or os.environ.get(ADDRESS_VARIABLE) or DEFAULT_ADDRESS
    calls = PlannerServer(
        planner_object, name or type(planner_object).__name__, version, wants_osi, read_road
    )
    with ThreadPoolExecutor(max_workers=1) as executor:  # one worker: one call at a time
        server = grpc.server(executor, options=(*messages.CHANNEL_OPTIONS, ("grpc.so_reuseport", 0)))
        server.add_generic_rpc_handlers((calls.handlers(),))
        _listen(server, bound_address)
        server.start()
        try:
            server.wait_for_termination()
        except KeyboardInterrupt:
            server.stop(grace=None)


def _listen(server: Any, address: str) -> None:
    """Let *server* listen at *address*.

    Raises:
        RuntimeError: it cannot; gRPC itself would take a port beyond 65535 modulo 65536.
    """
    port = address.rpartition(":")[2]
    if port.isdigit() and int(port) > _LARGEST_PORT and not address.startswith("unix:"):
        raise RuntimeError(f"no port {port}: the largest is {_LARGEST_PORT}")
    try:
        server.add_insecure_port(address)
    except RuntimeError:
        problem = f"cannot listen at {address}: it is in use, or no address of this machine"
        raise RuntimeError(problem) from None


@dataclass(frozen=True)
class OsiScene(Scene):
    """A scene for a planner that requested OSI.

    Attributes:
        osi_ground_truth: the serialised ``osi3.GroundTruth`` of the present instant.
    """

    osi_ground_truth: bytes = b""


def _scene(message: Any, replan_s: float) -> Scene:
    scene = replace(scene_of(message), replan_s=replan_s)
    if not message.osi_ground_truth:
        return scene
    return OsiScene(**vars(scene), osi_ground_truth=message.osi_ground_truth)


def _reporting_errors(call: Callable[[Any], Any]) -> Callable[[Any, Any], Any]:
    """Return a handler that performs *call* and reports any exception to the client."""

    def handler(request: Any, context: Any) -> Any:
        try:
            return call(request)
        except SystemExit as error:
            _exit(error)
        except _NoPlanError as error:
            _abort(context, grpc.StatusCode.INVALID_ARGUMENT, str(error))
        except BaseException as error:  # noqa: BLE001 - a planner may raise anything, and the client must learn of it
            if lacks_memory(error):
                _abort(context, grpc.StatusCode.RESOURCE_EXHAUSTED, f"out of memory {error}".strip())
            _abort(context, grpc.StatusCode.INTERNAL, f"{described(error)}{raised_at(error, None)}")

    return handler


def _abort(context: Any, code: Any, message: str) -> NoReturn:
    """End the call with a status code, a message and the traceback of the present exception."""
    trace = traceback.format_exc().encode(errors="replace")[-_TRACE_BYTES:]
    context.set_trailing_metadata(((TRACE_KEY, trace),))
    context.abort(code, message.encode(errors="replace")[:_MESSAGE_BYTES].decode(errors="ignore"))
    raise AssertionError("abort() has raised")


def _exit(error: SystemExit) -> NoReturn:
    """End this process, as ``sys.exit`` would in the main thread of a planner, and write where it was called."""
    with contextlib.suppress(AttributeError, ValueError, OSError):  # the planner has closed or removed it
        sys.stderr.write(f"{described(error)}{raised_at(error, None)}\n")
    flush_output()
    code = error.code
    os._exit(code if isinstance(code, int) else 0 if code is None else 1)


def _drop_oldest(items: OrderedDict[str, Any], limit: int) -> None:
    while len(items) > limit:
        items.popitem(last=False)
