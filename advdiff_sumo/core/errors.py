"""Every error that this package raises on purpose.

AdvdiffError
├── InputError            something the user gave cannot be used; the CLI exits with code 2
│   ├── FileError         a file is missing, truncated, of another format, or cannot be written
│   ├── NetError          a SUMO net or its side-car cannot be used
│   ├── MapError          an HD map cannot be converted
│   ├── LogError          a driving log cannot be read
│   ├── WeightsError      a checkpoint or weights file cannot be used
│   ├── SceneError        no usable seed scene could be made
│   ├── ConfigError       an option has no such name or value
│   └── UnknownNameError  no planner, policy, … of that name
├── MissingExtraError     an optional dependency is not installed
├── TrainingError         a training cannot go on: a loss or gradient is not a number
└── EpisodeFailure        one episode could not be finished; the run goes on
    ├── PlanRefusedError  a plan holds NaN, a jump or another physical impossibility
    ├── PlannerError      the planner or policy raised
    ├── PlannerTimeoutError  a planner in a process of its own did not answer in time
    ├── PlannerCrashedError  a planner's own process ended, or cannot be reached
    ├── OutOfMemoryFailure  the planner or policy asked for more memory than a worker may have
    └── SimulationError   SUMO refused or stopped
        ├── StartRefusedError  SUMO does not start with the net, demand or options that it is given
        └── NotInsertedError   SUMO has no lane for a vehicle, or refuses it
"""

from __future__ import annotations

import difflib
import errno
from collections.abc import Iterable
from pathlib import Path

INTERRUPTED = 130
"""Exit code after Ctrl-C."""
INTERRUPTION = "interrupted"
"""Message after Ctrl-C where nothing more can be said."""


class AdvdiffError(Exception):
    """Base of all errors of this package; its message is one sentence for the user."""


class InputError(AdvdiffError):
    """Something the user gave cannot be used."""


class FileError(InputError):
    """A file is missing, truncated, of another format, or cannot be written.

    Attributes:
        path: the file.
        problem: what is wrong, as a sentence whose subject is the file.
        remedy: what to do; "" if that is obvious.
    """

    def __init__(self, path: str | Path, problem: str, remedy: str = "") -> None:
        self.path, self.problem, self.remedy = Path(path), problem, remedy
        super().__init__(f"{self.path}: {problem}" + (f"; {remedy}" if remedy else ""))


class NetError(FileError):
    """A SUMO net or its side-car cannot be used."""


class MapError(FileError):
    """An HD map cannot be converted."""


class LogError(FileError):
    """A driving log cannot be read."""


class WeightsError(FileError):
    """A checkpoint or weights file cannot be used."""


class SceneError(InputError):
    """No usable seed scene could be made."""


class ConfigError(InputError):
    """An option has no such name or value."""


class UnknownNameError(InputError):
    """No planner, policy, … of that name; the message suggests the nearest ones."""

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        self.kind, self.name, self.known = kind, name, sorted(known)
        super().__init__(f"unknown {kind} '{name}'; {did_you_mean(name, self.known)}")


class MissingExtraError(AdvdiffError):
    """An optional dependency is not installed."""

    def __init__(self, feature: str, extra: str) -> None:
        super().__init__(f"{feature} needs an optional package: pip install 'advdiff-sumo[{extra}]'")


class TrainingError(AdvdiffError):
    """A training cannot go on; the message names the step and what was wrong there."""


class EpisodeFailure(AdvdiffError):  # noqa: N818 - the record of a failure, shown as such in the results
    """One episode could not be finished; the run records why and goes on."""

    kind = "failure"


class PlanRefusedError(EpisodeFailure):
    """A plan holds NaN, a jump or another physical impossibility."""

    kind = "plan_refused"


class PlannerError(EpisodeFailure):
    """The planner or policy raised an exception."""

    kind = "planner_error"


class PlannerTimeoutError(EpisodeFailure):
    """A planner in a process of its own did not answer within its deadline."""

    kind = "planner_timeout"


class PlannerCrashedError(EpisodeFailure):
    """A planner's own process ended, could not be started, or cannot be reached."""

    kind = "planner_crashed"


class OutOfMemoryFailure(EpisodeFailure):
    """The planner or policy asked for more memory than there is, or than a worker of a sweep may have."""

    kind = "out_of_memory"


class SimulationError(EpisodeFailure):
    """SUMO refused a command or stopped."""

    kind = "simulation_error"


class StartRefusedError(SimulationError):
    """SUMO does not start with the net, demand or options that it is given; the message holds its reason."""

    kind = "start_refused"


class NotInsertedError(SimulationError):
    """SUMO has no lane for a vehicle that it must have, or refuses it."""

    kind = "not_inserted"


UNEXPLAINED_KINDS = frozenset({SimulationError.kind, "simulator_crashed", "worker_died", "error"})
"""Kinds of failure caused by SUMO, the machine or this package, not by a plug-in or by the user's input."""


def is_disk_full(error: OSError) -> bool:
    """Return whether *error* says that there is no more room for a file: on the disk, in a quota, or by its size."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def os_reason(error: OSError) -> str:
    """Return the system's message for *error*, such as "No such file or directory", or else the text of *error*.

    Libraries raise ``OSError("…")`` without a number; its ``strerror`` is None.
    """
    return error.strerror or str(error) or type(error).__name__


def first_line(error: BaseException) -> str:
    """Return the first line of an error's message, or the name of its class if it has none."""
    return (str(error).splitlines() or [type(error).__name__])[0]


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return "did you mean 'x'?" for the name in *known* that is nearest to *name*, else a list of all of them."""
    names = sorted(known)
    suggestion = nearest(name, names)
    return f"known are: {', '.join(names)}" if suggestion is None else f"did you mean '{suggestion}'?"


def nearest(name: str, known: Iterable[str], alike: float = 0.6) -> str | None:
    """Return the name in *known* that is nearest to *name*; None if the similarity of all is below *alike* (of 1)."""
    folded = {n.lower().replace("-", "_"): n for n in known}
    matches = difflib.get_close_matches(name.lower().replace("-", "_"), folded, n=1, cutoff=alike)
    return folded[matches[0]] if matches else None
