"""The margin of a seed scene: the least severe encounter that makes a target fail validly, by bisection.

The severity is the braking of who attacks: where, when and by what it attacks is chosen as for the hardest, and then it
brakes with so much. Whoever fails from 5.5 m/s² on has a margin of 5.25 m/s² there.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.experiments.bench.cells import open_bench_store
from advdiff_sumo.metrics.severity import is_valid_failure
from advdiff_sumo.sim.run_episodes import RunOptions
from advdiff_sumo.sweep.consolidate import consolidate
from advdiff_sumo.sweep.executors import ProcessExecutor
from advdiff_sumo.sweep.job_plan import Plan, plan_sweep
from advdiff_sumo.sweep.spec import Case, SweepSpec
from advdiff_sumo.sweep.sweep_files import write_whole
from advdiff_sumo.sweep.sweep_runner import Todo, run_sweep
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.tasks import Limits

MILDEST_MPS2, HARDEST_MPS2 = 1.0, 9.0
SCALED = ("hard-stop", "cut-in", "stop-and-go", "blocked-lane")
"""Attacks that are as severe as somebody brakes."""
TRIALS = "margin.csv"
_RETRIES = 1


@dataclass(frozen=True)
class Margin:
    """What a bisection came to; at least one of the two is known.

    Attributes:
        passes_mps2: severest braking that the target coped with; None: it failed at the mildest.
        fails_mps2: mildest braking at which it failed; None: it coped with the hardest.
        tried: braking → whether the target failed validly, in the order of the trials.
    """

    passes_mps2: float | None
    fails_mps2: float | None
    tried: Mapping[float, bool]

    @property
    def neighbours(self) -> tuple[float, ...]:
        """The failing and the passing one that lie side by side, as far as there are both."""
        return tuple(one for one in (self.fails_mps2, self.passes_mps2) if one is not None)


def bisect(
    fails: Callable[[float], bool],
    within: float,
    mildest: float = MILDEST_MPS2,
    hardest: float = HARDEST_MPS2,
) -> Margin:
    """Return where *fails* begins to hold between *mildest* and *hardest*, to *within*.

    It is asked at the ends first. Where it holds in several stretches, one of their beginnings is found.
    """
    tried: dict[float, bool] = {}

    def ask(severity: float) -> bool:
        tried[severity] = fails(severity)
        return tried[severity]

    if not ask(hardest):
        return Margin(hardest, None, tried)
    if ask(mildest):
        return Margin(None, mildest, tried)
    low, high = mildest, hardest
    while high - low > within + 1e-9:
        middle = 0.5 * (low + high)
        if ask(middle):
            high = middle
        else:
            low = middle
    return Margin(low, high, tried)


@dataclass(frozen=True)
class MarginTrials:
    """Episodes of one seed scene, each with another severity, in one folder; those that are there are not run again.

    Attributes:
        options: of a run with background ``scripted``.
        folder: of the results.
        limits: of a worker.
    """

    options: RunOptions
    folder: Path
    limits: Limits

    def fails(self, braking_mps2: float) -> bool:
        """Return whether the target fails validly where attackers brake with *braking_mps2* at most.

        Raises:
            ConfigError: the episode did not get to its end.
            InputError: a name is unknown, or there is no seed scene.
        """
        plan = self._plan((braking_mps2,))
        part = self._run(plan).read(plan.jobs[0].key)
        if part is None or part.failed is not None:
            why = "" if part is None or part.failed is None else part.failed.message
            raise ConfigError(f"the episode with {braking_mps2:g} m/s² failed: {why}; see {self.folder}")
        (row,) = part.tables["episodes"].to_pylist()
        return is_valid_failure(row)

    def keep(self, margin: Margin) -> None:
        """Put the neighbours' episodes into the folder's tables, the failing one first, and all trials into a file."""
        plan = self._plan(margin.neighbours)
        store = self._run(plan)
        consolidate(store, plan)
        write_whole(self.folder / TRIALS, trials_text(margin).encode())

    def _plan(self, severities: tuple[float, ...]) -> Plan:
        options = self.options
        cases = [
            Case(
                net=options.net,
                target=options.target,
                target_options=options.target_options,
                background=options.background,
                background_options={**options.background_options, "hardest_mps2": one},
                seed=options.seed,
                episodes=1,
                demand=options.demand,
            ).model_dump(mode="json", exclude_none=True)
            for one in severities
        ]
        values = {
            "horizon_s": options.horizon_s,
            "sim": options.sim.model_dump(mode="json"),
            "scene": options.scene.model_dump(mode="json"),
            "cases": tuple(cases),
        }
        return plan_sweep(SweepSpec.of(values, "the margin"))

    def _run(self, plan: Plan) -> Store:
        store = open_bench_store(self.folder, plan, 1)
        executor = ProcessExecutor(1, self.limits)
        run_sweep(plan, store, Todo.of(plan, store), executor, _RETRIES, lambda *_: None)
        return store


def trials_text(margin: Margin) -> str:
    """Return one line a trial, the mildest first."""
    sink = io.StringIO()
    writer = csv.writer(sink, lineterminator="\n")
    writer.writerow(("braking_mps2", "valid_failure"))
    writer.writerows((f"{one:g}", str(failed).lower()) for one, failed in sorted(margin.tried.items()))
    return sink.getvalue()
