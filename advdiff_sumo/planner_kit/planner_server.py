"""Serves a Python planner, one call at a time."""

from __future__ import annotations

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

from advdiff_sumo.core.plan import Controls, Trajectory
from advdiff_sumo.core.plug_in_source import described, lacks_memory, planned_at, raised_at
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.planner_kit import messages
from advdiff_sumo.planner_kit.kit_road import road_of
from advdiff_sumo.planner_kit.wire import plan_message, scene_of

#: Environment variable that holds the address which ``--target "exec:…"`` wants to be served at.
ADDRESS_VARIABLE = "ADVDIFF_PLANNER_ADDRESS"
DEFAULT_ADDRESS = "localhost:50051"
#: Key of a reply's trailing metadata that holds where the planner raised.
TRACE_KEY = "advdiff-trace-bin"
_KEPT_EPISODES, _KEPT_MAPS = 64, 8
_SENTENCE, _TRACE = 500, 4000  # bytes; gRPC bounds the size of headers


@dataclass
class _Running:
    """An episode: its map, the planner's memory and random numbers, and the time from one plan to the next."""

    road: Any
    memory: Any
    rng: np.random.Generator
    replan_s: float


class _NoPlanError(Exception):
    """What the planner returned is no plan."""


class PlannerServer:
    """Answers the calls of ``planner.proto`` with a planner of two methods, ``start`` and ``plan``.

    A method ``end(memory, end)`` is called where there is one, with the word for how the episode ended.
    """

    def __init__(
        self, planner: Any, name: str, version: str, wants_osi: bool, read_road: Callable[[str], Any] | None
    ) -> None:
        self.planner, self.name, self.version, self.wants_osi = planner, name, version, wants_osi
        self._read_road = read_road
        self._roads: OrderedDict[str, Any] = OrderedDict()
        self._episodes: OrderedDict[str, _Running] = OrderedDict()

    def Describe(self, request: Any) -> Any:  # noqa: N802 - the call's name
        """Say who this is."""
        del request
        return messages.Description(
            protocol_version=messages.VERSION,
            name=self.name,
            version=self.version,
            wants_osi=self.wants_osi,
        )

    def LoadMap(self, request: Any) -> Any:  # noqa: N802 - the call's name
        """Keep a map."""
        self._roads[request.map_id] = (
            self._read_road(request.net_path) if self._read_road else road_of(request)
        )
        _forget(self._roads, _KEPT_MAPS)
        return messages.MapLoaded()

    def StartEpisode(self, request: Any) -> Any:  # noqa: N802 - the call's name
        """Begin an episode, or ask for its map."""
        road = self._roads.get(request.map_id)
        if road is None:
            return messages.StartReply(need_map=True)
        self._roads.move_to_end(request.map_id)
        rng = np.random.default_rng(request.seed)
        memory = self.planner.start(road, _scene(request.scene, request.model_step_s), rng)
        self._episodes[request.episode_id] = _Running(road, memory, rng, request.model_step_s)
        _forget(self._episodes, _KEPT_EPISODES)
        return messages.StartReply()

    def MakePlan(self, request: Any) -> Any:  # noqa: N802 - the call's name
        """Plan."""
        running = self._episodes.get(request.episode_id)
        if running is None:
            raise RuntimeError("this episode was not started here; was the server restarted?")
        scene = _scene(request.scene, running.replan_s)
        answer = self.planner.plan(running.road, scene, running.memory, running.rng)
        if not (
            isinstance(answer, tuple) and len(answer) == 2 and isinstance(answer[0], (Trajectory, Controls))
        ):
            first = answer[0] if isinstance(answer, tuple) and len(answer) == 2 else answer
            raise _NoPlanError(
                f"plan() returned {type(first).__name__}, not (Trajectory or Controls, memory)"
                f"{planned_at(self.planner)}"
            )
        plan, running.memory = answer
        try:
            return plan_message(plan)
        except ValueError as error:
            problem = f"planned {type(plan).__name__} that cannot be driven: {error}"
            raise _NoPlanError(f"{problem}{planned_at(self.planner)}") from None

    def EndEpisode(self, request: Any) -> Any:  # noqa: N802 - the call's name
        """Forget an episode."""
        running = self._episodes.pop(request.episode_id, None)
        end = getattr(self.planner, "end", None)
        if running is not None and callable(end):
            end(running.memory, request.end)
        return messages.EpisodeEnded()

    def handlers(self) -> Any:
        """Return what gRPC calls."""
        calls = {}
        for name, (asked, answer) in messages.CALLS.items():
            calls[name] = grpc.unary_unary_rpc_method_handler(
                _answering(getattr(self, name)),
                request_deserializer=asked.FromString,
                response_serializer=answer.SerializeToString,
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
    """Serve *planner* until this process is ended.

    Args:
        planner: an object with ``start(road, scene, rng)`` and ``plan(road, scene, memory, rng)``, or its class.
        address: ``HOST:PORT`` or ``unix:PATH``; by default what ``--target "exec:…"`` asks for, else port 50051.
        name: of the planner, for messages.
        version: of the planner.
        wants_osi: whether ``start`` and ``plan`` shall get an :class:`OsiScene`.
        read_road: makes the map that the planner gets out of the net's path, such as ``RoadMap.read``; by default
            it gets a :class:`~advdiff_sumo.planner_kit.kit_road.KitRoad`.

    Raises:
        RuntimeError: the address is taken.
    """
    served = planner() if isinstance(planner, type) else planner
    place = address or os.environ.get(ADDRESS_VARIABLE) or DEFAULT_ADDRESS
    answers = PlannerServer(served, name or type(served).__name__, version, wants_osi, read_road)
    with ThreadPoolExecutor(max_workers=1) as one_at_a_time:
        server = grpc.server(one_at_a_time, options=(*messages.CHANNEL_OPTIONS, ("grpc.so_reuseport", 0)))
        server.add_generic_rpc_handlers((answers.handlers(),))
        server.add_insecure_port(place)
        server.start()
        try:
            server.wait_for_termination()
        except KeyboardInterrupt:
            server.stop(grace=None)


@dataclass(frozen=True)
class OsiScene(Scene):
    """A scene of a planner that asked for OSI.

    Attributes:
        osi_ground_truth: an ``osi3.GroundTruth`` of now, serialised.
    """

    osi_ground_truth: bytes = b""


def _scene(message: Any, replan_s: float) -> Scene:
    scene = replace(scene_of(message), replan_s=replan_s)
    if not message.osi_ground_truth:
        return scene
    return OsiScene(**vars(scene), osi_ground_truth=message.osi_ground_truth)


def _answering(call: Callable[[Any], Any]) -> Callable[[Any, Any], Any]:
    """Return *call* with everything that it may raise told to the caller."""

    def answer(request: Any, context: Any) -> Any:
        try:
            return call(request)
        except SystemExit as error:
            _leave(error)
        except _NoPlanError as error:
            _refuse(context, grpc.StatusCode.INVALID_ARGUMENT, str(error))
        except BaseException as error:  # noqa: BLE001 - a planner may raise anything, and the caller is to know
            if lacks_memory(error):
                _refuse(context, grpc.StatusCode.RESOURCE_EXHAUSTED, f"out of memory {error}".strip())
            place = raised_at(error, None)
            _refuse(context, grpc.StatusCode.INTERNAL, f"{described(error)}{place}")

    return answer


def _refuse(context: Any, code: Any, sentence: str) -> NoReturn:
    trace = traceback.format_exc().encode(errors="replace")[-_TRACE:]
    context.set_trailing_metadata(((TRACE_KEY, trace),))
    context.abort(code, sentence.encode(errors="replace")[:_SENTENCE].decode(errors="ignore"))
    raise AssertionError("abort() has raised")


def _leave(error: SystemExit) -> NoReturn:
    """End this process, as ``sys.exit`` would in a planner's own main thread."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    code = error.code
    os._exit(code if isinstance(code, int) else 0 if code is None else 1)


def _forget(kept: OrderedDict[str, Any], most: int) -> None:
    while len(kept) > most:
        kept.popitem(last=False)
