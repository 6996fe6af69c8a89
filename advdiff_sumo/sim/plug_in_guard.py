"""Call planners and policies; any error in them becomes a failure of the episode, with file and line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

from advdiff_sumo.core.errors import (
    AdvdiffError,
    EpisodeFailure,
    OutOfMemoryFailure,
    PlannerError,
    PlanRefusedError,
)
from advdiff_sumo.core.plug_in_source import described, lacks_memory, message_of, planned_at, raised_at
from advdiff_sumo.core.process_end import hears_ctrl_c
from advdiff_sumo.sim.heartbeat import Heartbeat, ProcessPhase

_Result = TypeVar("_Result")


@dataclass(frozen=True)
class PlugInGuard:
    """Calls one planner or policy.

    Attributes:
        plug_in: the object.
        owner: name of planner or policy for messages, such as "target 'mine:Planner'".
        phase: phase of the heartbeat during a call.
        heartbeat: of the episode.
    """

    plug_in: object
    owner: str
    phase: ProcessPhase
    heartbeat: Heartbeat = field(default_factory=Heartbeat)

    def call(self, function: Callable[[], _Result]) -> _Result:
        """Return the result of *function*, which calls the plug-in.

        Raises:
            EpisodeFailure: one of its kinds, for any exception of the plug-in, attempts to end the process included.
            InputError: the plug-in cannot be used with the scene or its options.
        """
        with self.heartbeat.during(self.phase):
            try:
                return function()
            except PlanRefusedError as error:
                raise PlanRefusedError(f"{error}{planned_at(self.plug_in)}") from error.__cause__
            except AdvdiffError:
                raise
            except KeyboardInterrupt as error:
                if hears_ctrl_c():
                    raise
                raise self._as_failure(error) from error
            except BaseException as error:  # includes SystemExit, GeneratorExit and the plug-in's own types
                raise self._as_failure(error) from error

    def _as_failure(self, error: BaseException) -> EpisodeFailure:
        """Return the failure of the episode that *error* of the plug-in causes."""
        place = raised_at(error, self.plug_in)
        if lacks_memory(error):
            return OutOfMemoryFailure(f"{self.owner} ran out of memory{place}{message_of(error)}")
        return PlannerError(f"{self.owner} raised {described(error)}{place}")
