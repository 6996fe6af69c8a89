"""Any error of a planner or policy becomes a typed failure that names file and line of its code."""

from __future__ import annotations

import inspect
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from advdiff_sumo.core.errors import (
    AdvdiffError,
    ConfigError,
    EpisodeFailure,
    OutOfMemoryFailure,
    PlannerError,
    PlanRefusedError,
)
from advdiff_sumo.sim.heartbeat import NOT_STARTED, Heartbeat, ProcessPhase
from advdiff_sumo.sim.plug_in_guard import PlugInGuard


class OwnError(Exception):
    """An error whose message cannot be made."""

    def __str__(self) -> str:
        raise RuntimeError("no words")


class PlugIn:
    """Raises what it is given."""

    def plan(self, error: BaseException) -> Any:
        raise error


def guard() -> PlugInGuard:
    return PlugInGuard(PlugIn(), "target 'mine:P'", ProcessPhase.TARGET)


LINE = inspect.getsourcelines(PlugIn.plan)[1] + 1


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (RuntimeError("out of\nideas"), "raised RuntimeError: out of ideas"),
        (SystemExit(3), "raised SystemExit: 3"),
        (GeneratorExit(), "raised GeneratorExit"),
        (BaseException("base"), "raised BaseException: base"),
        (OwnError(), "raised OwnError"),
    ],
)
def test_what_is_raised_becomes_a_failure_with_its_place(error: BaseException, words: str) -> None:
    with pytest.raises(PlannerError) as caught:
        guard().call(lambda: PlugIn().plan(error))
    assert str(caught.value) == f"target 'mine:P' {words} (test_plug_in_guard.py, line {LINE}, plan)"
    assert caught.value.__cause__ is error


def test_a_library_that_raises_is_called_from_the_plug_in() -> None:
    def plan() -> Any:
        return np.linalg.inv(np.zeros((2, 3)))

    with pytest.raises(PlannerError, match=r"LinAlgError: .* \(test_plug_in_guard.py, line \d+, plan\)$"):
        guard().call(plan)


def test_memory_that_is_not_there() -> None:
    with pytest.raises(OutOfMemoryFailure, match="ran out of memory"):
        guard().call(lambda: PlugIn().plan(MemoryError("17 GB")))
    with pytest.raises(
        OutOfMemoryFailure, match=r"ran out of memory \(test_plug_in_guard.py, line \d+, plan\)$"
    ):
        guard().call(lambda: PlugIn().plan(MemoryError()))  # as Python itself raises it


def test_memory_that_pytorch_does_not_get() -> None:
    """On the CPU it raises a RuntimeError; four petabytes are more than any process can address."""
    with pytest.raises(
        OutOfMemoryFailure, match=r"ran out of memory \(test_plug_in_guard.py, line \d+, .*allocate"
    ):
        guard().call(lambda: torch.empty(10**15))
    with pytest.raises(OutOfMemoryFailure, match=r"ran out of memory .*: CUDA out of memory"):
        guard().call(
            lambda: PlugIn().plan(torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2 GiB"))
        )


def test_a_refused_plan_names_the_method() -> None:
    line = inspect.getsourcelines(PlugIn.plan)[1]
    with pytest.raises(PlanRefusedError) as caught:
        guard().call(lambda: PlugIn().plan(PlanRefusedError("it planned NaN")))
    assert str(caught.value) == f"it planned NaN (test_plug_in_guard.py, line {line}, plan)"


def test_our_own_errors_pass() -> None:
    for error in (ConfigError("no such option"), EpisodeFailure("over")):
        with pytest.raises(AdvdiffError) as caught:
            guard().call(lambda error=error: PlugIn().plan(error))  # type: ignore[misc] # bound at once
        assert caught.value is error


def test_ctrl_c_is_the_users_where_it_can_be_heard_and_else_the_planners() -> None:
    before = signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # the shell may have set another handler
    try:
        with pytest.raises(KeyboardInterrupt):
            guard().call(lambda: PlugIn().plan(KeyboardInterrupt()))
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # as in a worker
        with pytest.raises(PlannerError, match="raised KeyboardInterrupt"):
            guard().call(lambda: PlugIn().plan(KeyboardInterrupt()))
    finally:
        signal.signal(signal.SIGINT, before)


def test_the_heartbeat_can_be_read_from_outside(tmp_path: Path) -> None:
    path = tmp_path / "beat"
    assert Heartbeat.read(path) is None
    heartbeat = Heartbeat(path)
    first = Heartbeat.read(path)
    assert first is not None
    assert (first.pid, first.phase, first.steps) == (os.getpid(), ProcessPhase.OTHER, NOT_STARTED)
    heartbeat.note(ProcessPhase.SIMULATOR, 12)
    inside: list[Any] = []
    PlugInGuard(PlugIn(), "it", ProcessPhase.TARGET, heartbeat).call(
        lambda: inside.append(Heartbeat.read(path))
    )
    assert (inside[0].phase, inside[0].steps) == (ProcessPhase.TARGET, 12)
    assert inside[0].since_s >= first.since_s
    after = Heartbeat.read(path)
    assert after is not None
    assert (after.phase, after.steps) == (ProcessPhase.SIMULATOR, 12)
    path.write_bytes(b"half")
    assert Heartbeat.read(path) is None


def test_a_note_that_is_half_written_is_not_read(tmp_path: Path) -> None:
    """A reader between two bytes of a note sees its beginning, then zeros or the note before."""
    path = tmp_path / "beat"
    heartbeat = Heartbeat(path)
    before = path.read_bytes()
    heartbeat.note(ProcessPhase.BACKGROUND, 34)
    after = path.read_bytes()
    whole = {Heartbeat.read(path)}
    path.write_bytes(before)
    whole.add(Heartbeat.read(path))
    assert len(whole) == 2
    assert None not in whole
    for cut in range(len(after)):
        path.write_bytes(after[:cut] + before[cut:])
        assert Heartbeat.read(path) in {None, *whole}
        path.write_bytes(after[:cut] + bytes(len(after) - cut))
        assert Heartbeat.read(path) in {None, *whole}
