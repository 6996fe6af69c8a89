"""Run one SUMO simulation as a context manager; nothing starts before ``with``."""

from __future__ import annotations

import contextlib
import importlib
import io
import locale
import logging
import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from advdiff_sumo.core.errors import SimulationError, StartRefusedError
from advdiff_sumo.core.output import flush_output
from advdiff_sumo.maps.sumo_files import sumo_home

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SessionOptions:
    """What SUMO is started with.

    Attributes:
        net: the net file.
        seed: SUMO's random seed, 31 bits.
        step_s: length of a step.
        lateral_resolution_m: width of a sublane; 0 for the lane model.
        routes: demand files.
        additional: further files (vehicle types, signals, stops).
        load_state: a saved state to start from.
        begin_s: time of the first step.
        gui: open sumo-gui through traci, in place of libsumo.
    """

    net: Path
    seed: int
    step_s: float = 0.1
    lateral_resolution_m: float = 0.4
    routes: tuple[Path, ...] = ()
    additional: tuple[Path, ...] = ()
    load_state: Path | None = None
    begin_s: float = 0.0
    gui: bool = False

    def arguments(self) -> list[str]:
        """Return SUMO's command line without the program's name."""
        options: dict[str, object] = {
            "--net-file": self.net,
            "--seed": self.seed,
            "--step-length": self.step_s,
            "--begin": self.begin_s,
            "--collision.action": "warn",
            "--collision.check-junctions": "true",
            "--collision.mingap-factor": 0,
            "--time-to-teleport": -1,
            "--no-step-log": "true",
            "--no-warnings": "true",
            "--xml-validation": "never",
            "--save-state.rng": "true",
            "--save-state.precision": 9,
            "--save-state.transportables": "true",
            "--ignore-route-errors": "true",
        }
        if self.lateral_resolution_m > 0.0:
            options["--lateral-resolution"] = self.lateral_resolution_m
        if self.routes:
            options["--route-files"] = ",".join(map(str, self.routes))
        if self.additional:
            options["--additional-files"] = ",".join(map(str, self.additional))
        if self.load_state is not None:
            options["--load-state"] = self.load_state
        if self.gui:
            options |= {"--start": "true", "--quit-on-end": "true", "--delay": 100}
        return [text for pair in options.items() for text in map(str, pair)]


class Session:
    """SUMO, started on entry and closed on exit; one at a time in a process.

    Attributes:
        api: libsumo, or traci when ``gui`` is set; the same functions.
    """

    _is_open = False

    def __init__(self, options: SessionOptions) -> None:
        self.options = options
        self.api: Any = None

    def __enter__(self) -> Self:
        if Session._is_open:
            raise SimulationError(
                "a second SUMO simulation in one process would end the first one; close that, or give each a process "
                "(environments: gymnasium.vector.AsyncVectorEnv)"
            )
        files = (self.options.net, *self.options.routes, *self.options.additional)
        with_comma = next((file for file in files if "," in str(file)), None)
        if with_comma is not None:
            raise StartRefusedError(
                f"SUMO takes a comma for the end of a file name; rename or move {with_comma}"
            )
        self.api = load_api(self.options.gui)
        program = "sumo-gui" if self.options.gui else "sumo"
        with _quiet() as output:
            try:
                self.api.start([_binary(program) if self.options.gui else program, *self.options.arguments()])
            except Exception as error:
                raise StartRefusedError(f"SUMO does not start: {_cause(output(), error)}") from error
        Session._is_open = True
        _log.debug("SUMO began: %s", " ".join(self.options.arguments()))
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        Session._is_open = False
        with _quiet(), contextlib.suppress(Exception):
            self.api.close()

    def step(self, until_s: float = 0.0) -> None:
        """Let SUMO do one step, or all steps up to *until_s* on its clock.

        Raises:
            SimulationError: SUMO stopped.
        """
        try:
            self.api.simulationStep(until_s)
        except Exception as error:
            raise SimulationError(f"SUMO stopped: {_one_line(error)}") from error

    @property
    def time_s(self) -> float:
        """SUMO's clock."""
        return float(self.api.simulation.getTime())


def load_api(gui: bool = False) -> Any:
    """Import libsumo (or traci) without its printed notes on versions of other packages.

    libsumo decodes file names by the locale. In the locale "C" it accepts ASCII only, but Python uses UTF-8 (PEP 540).
    """
    if locale.setlocale(locale.LC_CTYPE) in ("C", "POSIX"):
        with contextlib.suppress(locale.Error):  # some systems have UTF-8 under another name
            locale.setlocale(locale.LC_CTYPE, "C.UTF-8")
    with contextlib.redirect_stdout(io.StringIO()):
        return importlib.import_module("traci" if gui else "libsumo")


def _binary(name: str) -> str:
    """Return the path of one of SUMO's programs in its wheel, or the bare name if it is not there."""
    path = sumo_home() / "bin" / name
    return str(path) if path.exists() else name


@contextlib.contextmanager
def _quiet() -> Iterator[Any]:
    """Redirect what SUMO writes to the terminal into a file; yield a function that returns the text."""
    flush_output()
    saved = os.dup(1), os.dup(2)
    with tempfile.TemporaryFile() as sink:

        def output() -> str:
            sink.seek(0)
            return sink.read().decode(errors="replace")

        try:
            os.dup2(sink.fileno(), 1)
            os.dup2(sink.fileno(), 2)
            yield output
        finally:
            os.dup2(saved[0], 1)
            os.dup2(saved[1], 2)
            os.close(saved[0])
            os.close(saved[1])


def _cause(output: str, error: BaseException) -> str:
    """Return SUMO's first error message in *output*, or that of *error*."""
    lines = [line.removeprefix("Error:").strip() for line in output.splitlines() if line.startswith("Error:")]
    return lines[0] if lines else _one_line(error)


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())
