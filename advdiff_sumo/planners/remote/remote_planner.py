"""Drive the target by a planner that answers over gRPC."""

from __future__ import annotations

import contextlib
import sys
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

_END_S = 2.0  # deadline for the end of an episode
_CONNECT_S = 10.0  # deadline to reach a server that runs already


class RemoteOptions(Options):
    """Options of remote targets.

    Attributes:
        plan_timeout_s: deadline for a plan, and for the end of an episode.
        start_timeout_s: deadline for a server to start (10 s if it runs already), to load the map, and to start an
            episode.
    """

    plan_timeout_s: float = Field(5.0, gt=0.0)
    start_timeout_s: float = Field(60.0, gt=0.0)


@dataclass(frozen=True)
class RemoteEpisode:
    """Memory of an episode on this side; the planner's own memory is in its server.

    Attributes:
        episode_id: id of the episode in the server.
        wants_osi: whether scenes are sent with OSI.
    """

    episode_id: str
    wants_osi: bool


def remote_planner(name: str, options: Mapping[str, Any]) -> RemotePlanner:
    """Return the remote planner *name*; nothing is started or called yet.

    Raises:
        ConfigError: the address, the command or an option is invalid.
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
    """A planner behind ``planner.proto``. A server started here starts with the first episode, and again after a crash.

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
        """Start the server, ask it for its description, and end it again.

        Raises:
            ConfigError: it cannot be reached, or uses another version of the protocol.
        """
        try:
            self._open(patient=False)
        except EpisodeFailure as error:
            remedy = "correct the command" if self.name.startswith(EXEC) else "start it first"
            is_reachable = not isinstance(error, PlannerCrashedError | PlannerTimeoutError)
            raise ConfigError(str(error) if is_reachable else f"{error}; {remedy}") from error
        finally:
            self.close()

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> RemoteEpisode:
        """Begin an episode; the map is sent if the server does not have it.

        Raises:
            EpisodeFailure: the server does not start, answers late, or its planner raised.
        """
        seed = int(rng.integers(2**63))
        connection = self._open()
        if self._process is not None:
            self._process.begin_episode()
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
            EpisodeFailure: the server is late or gone, returned no plan, or its planner raised.
        """
        del road, rng
        if self._connection is None:
            raise PlannerCrashedError(f"{self._who}: its server has ended since the episode began")
        request = messages.PlanRequest(episode_id=memory.episode_id, scene=self._scene(scene, memory))
        response = self._call(self._connection, "MakePlan", request, self.options.plan_timeout_s)
        try:
            return plan_of(response), memory
        except ValueError as error:
            raise PlanRefusedError(f"{self._who} {error}") from None

    def end(self, memory: RemoteEpisode, end: str, time_s: float, failure: str) -> None:
        """Tell the server how the episode ended, if it still runs, and show what it wrote since the last one.

        After a failure what it wrote as it started is shown, too. Its response and its failures are ignored.
        """
        if self._connection is None:
            return
        outcome = messages.Outcome(episode_id=memory.episode_id, end=end, time_s=time_s, failure=failure)
        with contextlib.suppress(EpisodeFailure):
            self._call(self._connection, "EndEpisode", outcome, min(_END_S, self.options.plan_timeout_s))
        if self._process is None:
            return
        if text := self._process.output() if failure else self._process.new_output():
            sys.stderr.write(f"{text}\n")

    def close(self) -> None:
        """Close the connection, and end the server if it was started here."""
        if self._connection is not None:
            self._connection.close()
        if self._process is not None:
            self._process.end()
        self._connection = self._process = None

    def _open(self, patient: bool = True) -> Connection:
        """Return the connection, opened if need be; *patient*: wait for a server that is still starting."""
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
        """Check the server's version of the protocol, and store whether it wants OSI."""
        request = messages.DescribeRequest(protocol_version=messages.VERSION)
        timeout_s = self.options.start_timeout_s if self._process is not None else _CONNECT_S
        description = self._call(connection, "Describe", request, timeout_s, wait)
        if description.protocol_version < messages.VERSION:
            raise PlannerError(
                f"{self._who} says that it speaks version {description.protocol_version} of the protocol, "
                f"advdiff-sumo {__version__} needs {messages.VERSION}; set protocol_version in the answer to Describe, "
                "and build the server from the files that `advdiff-sumo planner-kit` writes"
            )
        self._wants_osi = description.wants_osi

    def _scene(self, scene: Scene, episode: RemoteEpisode) -> Any:
        """Return the message of *scene*, with OSI if the server wants it."""
        if not episode.wants_osi:
            return scene_message(scene)
        from advdiff_sumo.planners.remote.osi_ground_truth import ground_truth_bytes  # late: an extra

        return scene_message(scene, ground_truth_bytes(scene))

    def _call(
        self, connection: Connection, name: str, request: Any, timeout_s: float, wait: bool = False
    ) -> Any:
        """Call the server; close it if it is late or gone, so that the next episode starts a new one.

        A failure without a traceback has what a server started here wrote last as its cause.
        """
        try:
            return connection.call(name, request, timeout_s, wait)
        except EpisodeFailure as error:
            failure = self._with_exit(error)
            output = self._process.output() if self._process is not None else ""
            if isinstance(error, PlannerTimeoutError | PlannerCrashedError):
                self.close()
            raise failure from error.__cause__ or (PlannerSideError(output) if output else None)

    def _with_exit(self, error: EpisodeFailure) -> EpisodeFailure:
        """Return *error*, which says how the server's process ended if it was started here and has ended."""
        if self._process is None or not isinstance(error, PlannerCrashedError):
            return error
        exit_text = self._process.how_ended()
        return PlannerCrashedError(f"{self._who}: its server {exit_text}") if exit_text else error
