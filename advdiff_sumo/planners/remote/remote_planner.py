"""A planner that answers over gRPC, behind the same two methods as any other."""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import Field

from advdiff_sumo import __version__
from advdiff_sumo.config import Options
from advdiff_sumo.core.errors import (
    ConfigError,
    EpisodeFailure,
    PlannerCrashedError,
    PlannerError,
    PlannerTimeoutError,
    PlanRefusedError,
)
from advdiff_sumo.core.plan import Plan
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planner_kit import messages
from advdiff_sumo.planner_kit.wire import plan_of, scene_message
from advdiff_sumo.planners.remote.connection import Connection, PlannerSideError
from advdiff_sumo.planners.remote.map_message import map_id_of, map_message
from advdiff_sumo.planners.remote.planner_process import PlannerProcess, split_command
from advdiff_sumo.planners.remote.remote_name import EXEC, GRPC

_END_S, _REACH_S = 2.0, 10.0


class RemoteOptions(Options):
    """Options of remote targets.

    Attributes:
        plan_timeout_s: deadline of a plan, and of the end of an episode.
        start_timeout_s: for a server that is started to come up (one that runs has 10 s), and to take the map and the
            start of an episode.
    """

    plan_timeout_s: float = Field(5.0, gt=0.0)
    start_timeout_s: float = Field(60.0, gt=0.0)


@dataclass(frozen=True)
class RemoteEpisode:
    """Memory of an episode on our side; the planner's own is in its server.

    Attributes:
        episode_id: name of the episode there.
        wants_osi: whether its scenes hold OSI.
    """

    episode_id: str
    wants_osi: bool


def remote_planner(name: str, options: Mapping[str, Any]) -> RemotePlanner:
    """Return the remote planner *name*; nothing is started or called yet.

    Raises:
        ConfigError: the address, the command or an option cannot be used.
    """
    parsed = RemoteOptions.parse(options, f"options of target '{name}'")
    if name.startswith(EXEC):
        split_command(name.removeprefix(EXEC))
        return RemotePlanner(name, parsed)
    address = name.removeprefix(GRPC)
    host, _, port = address.rpartition(":")
    if not address.startswith("unix:") and not (host and port.isdigit() and 0 < int(port) < 65536):
        raise ConfigError(f"target '{name}': no address; write it like grpc://localhost:50051")
    return RemotePlanner(name, parsed)


class RemotePlanner:
    """Speaks ``planner.proto``; a server of its own is started with the first episode and anew after a crash.

    Attributes:
        name: ``grpc://HOST:PORT`` or ``exec:COMMAND``.
        options: deadlines.
    """

    def __init__(self, name: str, options: RemoteOptions) -> None:
        self.name, self.options = name, options
        self._who = f"target '{name}'"
        self._process: PlannerProcess | None = None
        self._connection: Connection | None = None
        self._wants_osi = False

    def check(self) -> None:
        """Start the server, ask it who it is, and let it go again.

        Raises:
            ConfigError: there is none, or it speaks another version of the protocol.
        """
        try:
            self._open(patient=False)
        except EpisodeFailure as error:
            remedy = "correct the command" if self.name.startswith(EXEC) else "start it first"
            there = not isinstance(error, PlannerCrashedError | PlannerTimeoutError)
            raise ConfigError(str(error) if there else f"{error}; {remedy}") from error
        finally:
            self.close()

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> RemoteEpisode:
        """Begin an episode; the server gets the map where it lacks it.

        Raises:
            EpisodeFailure: the server does not come up, answers late, or its planner raised.
        """
        seed = int(rng.integers(2**63))
        connection = self._open()
        episode = RemoteEpisode(uuid.uuid4().hex, self._wants_osi)
        request = messages.StartRequest(
            episode_id=episode.episode_id,
            map_id=map_id_of(road),
            seed=seed,
            scene=self._scene(scene, episode),
            model_step_s=scene.least_plan_s,
        )
        if self._call(connection, "StartEpisode", request, self.options.start_timeout_s).need_map:
            self._call(connection, "LoadMap", map_message(road), self.options.start_timeout_s)
            if self._call(connection, "StartEpisode", request, self.options.start_timeout_s).need_map:
                raise PlanRefusedError(f"{self._who} asks for the map again right after it was sent")
        return episode

    def plan(
        self, road: RoadMap, scene: Scene, memory: RemoteEpisode, rng: np.random.Generator
    ) -> tuple[Plan, RemoteEpisode]:
        """Return the server's plan.

        Raises:
            EpisodeFailure: it is late, gone, no plan, or its planner raised.
        """
        del road, rng
        if self._connection is None:
            raise PlannerCrashedError(f"{self._who}: its server has ended since the episode began")
        request = messages.PlanRequest(episode_id=memory.episode_id, scene=self._scene(scene, memory))
        answer = self._call(self._connection, "MakePlan", request, self.options.plan_timeout_s)
        try:
            return plan_of(answer), memory
        except ValueError as error:
            raise PlanRefusedError(f"{self._who} {error}") from None

    def end(self, memory: RemoteEpisode, end: str, time_s: float, failure: str) -> None:
        """Tell the server how the episode ended, if it is still there; what it says to that does not matter."""
        if self._connection is None:
            return
        outcome = messages.Outcome(episode_id=memory.episode_id, end=end, time_s=time_s, failure=failure)
        try:
            self._call(self._connection, "EndEpisode", outcome, min(_END_S, self.options.plan_timeout_s))
        except EpisodeFailure:
            return

    def close(self) -> None:
        """End the server that was started here, and hang up."""
        if self._connection is not None:
            self._connection.close()
        if self._process is not None:
            self._process.end()
        self._connection = self._process = None

    def _open(self, patient: bool = True) -> Connection:
        """Return the connection; where there is none yet *patient* waits for a server that is being started."""
        if self._connection is not None:
            if self._process is not None:
                self._process.trim_log()
            return self._connection
        address = self.name.removeprefix(GRPC)
        if self.name.startswith(EXEC):
            self._process = PlannerProcess(self.name.removeprefix(EXEC), self._who)
            address = self._process.address
        try:
            if self._process is not None:
                self._process.wait(self.options.start_timeout_s)
            self._connection = Connection(address, self._who)
            self._describe(self._connection, patient or self._process is not None)
        except EpisodeFailure:
            self.close()
            raise
        return self._connection

    def _describe(self, connection: Connection, wait: bool) -> None:
        request = messages.DescribeRequest(protocol_version=messages.VERSION)
        timeout_s = self.options.start_timeout_s if self._process is not None else _REACH_S
        description = self._call(connection, "Describe", request, timeout_s, wait)
        if description.protocol_version < messages.VERSION:
            raise PlannerError(
                f"{self._who} says that it speaks version {description.protocol_version} of the protocol, "
                f"advdiff-sumo {__version__} needs {messages.VERSION}; set protocol_version in the answer to Describe, "
                "and build the server from the files that `advdiff-sumo planner-kit` writes"
            )
        self._wants_osi = description.wants_osi

    def _scene(self, scene: Scene, episode: RemoteEpisode) -> Any:
        if not episode.wants_osi:
            return scene_message(scene)
        from advdiff_sumo.planners.remote.osi_ground_truth import ground_truth_bytes  # late: an extra

        return scene_message(scene, ground_truth_bytes(scene))

    def _call(
        self, connection: Connection, name: str, request: Any, timeout_s: float, wait: bool = False
    ) -> Any:
        """Call, and let go of a server that is late or gone: the next episode gets a new one."""
        try:
            return connection.call(name, request, timeout_s, wait)
        except (PlannerTimeoutError, PlannerCrashedError) as error:
            failure, output = self._told(error), self._process.said() if self._process is not None else ""
            self.close()
            raise failure from (PlannerSideError(output) if output else None)

    def _told(self, error: EpisodeFailure) -> EpisodeFailure:
        """Return *error* with how the server's process ended, where it is ours and has."""
        if self._process is None or not isinstance(error, PlannerCrashedError):
            return error
        ended = self._process.ended()
        return PlannerCrashedError(f"{self._who}: its server {ended}") if ended else error
