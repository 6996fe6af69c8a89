"""Run one closed-loop episode and return its record."""

from __future__ import annotations

import tempfile
import time
import traceback
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from advdiff_sumo.core.errors import EpisodeFailure
from advdiff_sumo.core.record import Controller, EndReason, EpisodeRecord, Failure
from advdiff_sumo.core.threads import one_thread
from advdiff_sumo.sim.episode_loop import Loop
from advdiff_sumo.sim.episode_setup import EpisodeSetup
from advdiff_sumo.sim.heartbeat import ProcessPhase
from advdiff_sumo.sim.session import Session
from advdiff_sumo.sim.start import prepare
from advdiff_sumo.sim.sumo_target import as_driven


@dataclass(frozen=True)
class Timing:
    """Wall-clock time of one episode; kept apart from the record, which is the same on every machine.

    Plans that this process had made before count with the time that they took then.

    Attributes:
        wall_s: whole episode, the start included.
        cpu_s: processor time of the same, SUMO's included.
        target_plans_s: each plan of a Python planner.
        background_plans_s: each plan of the policy; empty if SUMO drives all background vehicles.
    """

    wall_s: float
    cpu_s: float | None = field(default=None, kw_only=True)
    target_plans_s: tuple[float, ...] = ()
    background_plans_s: tuple[float, ...] = ()


@dataclass(frozen=True)
class Ended:
    """How an episode ended the process in which it ran.

    Attributes:
        steps: SUMO steps that were recorded by then; negative before the first.
        kind: as in :class:`~advdiff_sumo.core.record.Failure`.
        message: one sentence.
        trace: where each thread was, as far as known.
    """

    steps: int
    kind: str
    message: str
    trace: str = ""

    def failure(self, time_s: float) -> Failure:
        """Return this as the failure of a record that ends at *time_s*."""
        return Failure(self.kind, self.message, time_s, self.trace)


@dataclass(frozen=True)
class Episode(EpisodeSetup):
    """One closed-loop episode, ready to run."""

    @one_thread()
    def run(self, ended: Ended | None = None) -> tuple[EpisodeRecord, Timing]:
        """Run the episode on one thread; failures of SUMO, planner or policy become part of the record.

        Args:
            ended: how this episode ended an earlier process; it then runs only as far as it came there.

        Raises:
            InputError: an option cannot be used with this scene.
        """
        wall_started_s, cpu_started_s = time.perf_counter(), time.process_time()
        if ended is not None and ended.steps < 0:
            return self._unstarted(ended.failure(0.0)), Timing(time.perf_counter() - wall_started_s)
        self.heartbeat.note(ProcessPhase.SIMULATOR)
        failure: Failure | None = None
        with ExitStack() as stack:
            try:
                loop = stack.enter_context(self.opened())
            except EpisodeFailure as error:
                failed_start = Failure(error.kind, str(error), 0.0, _trace(error))
                return self._unstarted(failed_start), Timing(time.perf_counter() - wall_started_s)
            try:
                loop.start()
                end = loop.run(self.steps if ended is None else min(ended.steps, self.steps))
                if ended is not None:
                    end, failure = EndReason.FAILED, ended.failure(loop.time_s)
            except EpisodeFailure as error:
                end, failure = (
                    EndReason.FAILED,
                    Failure(error.kind, str(error), loop.time_s, _trace(error)),
                )
                if not loop.recorder.frames:
                    return self._unstarted(failure), Timing(time.perf_counter() - wall_started_s)
            record = loop.record(end, failure)
            loop.leave(record)
        self.heartbeat.note(ProcessPhase.OTHER)
        plan_source = loop.background.source
        cpu_s = time.process_time() - cpu_started_s + plan_source.spared_cpu_s
        timing = Timing(
            time.perf_counter() - wall_started_s + plan_source.spared_s, *loop.planning_s(), cpu_s=cpu_s
        )
        return record, timing

    def _unstarted(self, failure: Failure) -> EpisodeRecord:
        """Return the record of an episode that failed before its first instant: the last states of the seed scene."""
        history = self.scene.history
        tracks = replace(history.window(history.steps - 1, history.steps), t0_s=0.0, dt_s=self.sim.step_s)
        return EpisodeRecord(
            episode=self.number,
            seed=self.scene.seed,
            scene=self.scene.name,
            tracks=tracks,
            target=tracks.index[self.scene.target],
            controller=np.where(tracks.valid, Controller.SUMO, Controller.ABSENT),
            route=self.scene.routes.get(self.scene.target, ()),
            end=EndReason.FAILED,
            signals=({},),
            failure=failure,
        )

    @contextmanager
    def opened(self) -> Iterator[Loop]:
        """Yield the loop with SUMO running, but not started; repeated calls of its ``run`` continue the episode.

        Raises:
            InputError: an option cannot be used with this scene.
            SimulationError: SUMO does not start, or a simulation is already running in this process.
        """
        with tempfile.TemporaryDirectory(prefix="advdiff-") as folder:
            driver = as_driven(self.target, self.road.lefthand, self.seed)
            preparation = prepare(self.scene, driver, self.sim, Path(folder), self.gui)
            with Session(preparation.options) as session:
                yield Loop(self, session, preparation.type_of_class)


def _trace(error: EpisodeFailure) -> str:
    """Return the traceback of an error in planner or policy; "" if the package itself found the failure.

    A cause that was not raised here has the traceback, or the output, of another process as its text.
    """
    cause = error.__cause__
    if cause is None:
        return ""
    return str(cause) if cause.__traceback__ is None else "".join(traceback.format_exception(cause))
