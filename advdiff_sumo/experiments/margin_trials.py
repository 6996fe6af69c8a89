"""Runs the episodes of a margin: one seed scene, attacks of several severities, one folder that can be resumed."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from advdiff_sumo.core.errors import ConfigError, EpisodeFailure, FileError
from advdiff_sumo.data.episode_states import states_of
from advdiff_sumo.data.run_tables import SWEEP_SETTINGS
from advdiff_sumo.experiments.bench.cells import open_bench_store
from advdiff_sumo.experiments.margin import Margin, Scale, Trial
from advdiff_sumo.experiments.margin_lack import lack_text
from advdiff_sumo.metrics.collision_type import CollisionType
from advdiff_sumo.metrics.severity import is_valid_failure
from advdiff_sumo.report.margin_table import COMMAND, SUBJECT, TRIALS, TrialRow, trials_text
from advdiff_sumo.sim.run_episodes import RunOptions
from advdiff_sumo.sweep.consolidate import consolidate
from advdiff_sumo.sweep.executors import ProcessExecutor
from advdiff_sumo.sweep.job_plan import SweepPlan, plan_sweep
from advdiff_sumo.sweep.spec import Case, SweepSpec
from advdiff_sumo.sweep.sweep_files import write_whole
from advdiff_sumo.sweep.sweep_runner import RemainingJobs, run_sweep
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.tasks import WorkerLimits
from advdiff_sumo.traffic.manoeuvres.commitments import CROSSING_ATTACKS

_RETRIES = 1


@dataclass(frozen=True)
class MarginOf:
    """The margin of one attack.

    Attributes:
        attack: its kind.
        scale: of its severity.
        margin: the result of the bisection.
    """

    attack: str
    scale: Scale
    margin: Margin

    def summary(self) -> dict[str, Any]:
        """Return the margin as plain values; unknown ones are None."""
        fails, passes = self.margin.fails, self.margin.passes if self.margin.is_known else None
        return {
            "attack": self.attack,
            "parameter": self.scale.by,
            "unit": self.scale.unit,
            "failing": None if fails is None else fails.value,
            "passing": None if passes is None else passes.value,
            "why": self.margin.text(self.attack, self.scale),
        }


class MarginTrials(AbstractContextManager["MarginTrials"]):
    """Runs episodes of one seed scene in one folder; episodes that it already holds are not run again.

    Args:
        options: of a run with background ``scripted`` or ``diffusion``, without attack and severity.
        number: which of the seed's scenes it is.
        asked_attack: the background's option ``attack`` in all trials; None: the kind of each margin.
        folder: of the results.
        limits: of the worker.

    Raises:
        FileError: the folder holds a sweep.
        ConfigError: it holds the margin of another target, net or seed.
    """

    def __init__(
        self, options: RunOptions, number: int, asked_attack: str | None, folder: Path, limits: WorkerLimits
    ) -> None:
        self._options, self._number, self._folder = options, number, folder
        self._asked_attack = asked_attack
        further = {"number": number or None, "asked_attack": asked_attack}
        subject = options.model_dump(mode="json", exclude={"episodes"})
        subject |= {name: value for name, value in further.items() if value is not None}
        self._subject = json.dumps(subject, ensure_ascii=False, indent=1).encode() + b"\n"
        self._must_be_own()
        self._executor = ProcessExecutor(1, limits)

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """End the worker."""
        self._executor.__exit__(kind, error, trace)

    def run(self, attack: str, scale: Scale, value: float) -> Trial:
        """Run *attack* with this *value* of *scale*, or read its stored episode.

        Raises:
            EpisodeFailure: the episode did not finish.
            InputError: a name is unknown, or there is no seed scene.
        """
        plan = self._plan([(attack, scale, value)])
        stored = self._run(plan).read(plan.jobs[0].key)
        if stored is None or stored.failed is not None:
            reason = "" if stored is None or stored.failed is None else stored.failed.message
            raise EpisodeFailure(f"the episode with {scale.text(value)} failed: {reason}; see {self._folder}")
        (row,) = stored.tables["episodes"].to_pylist()
        failed = is_valid_failure(row)
        manoeuvre = "crossing" if attack in CROSSING_ATTACKS else attack  # as which it is recorded
        is_exact = failed or self._asked_attack not in (
            None,
            attack,
        )  # a vehicle may be in position for another kind
        met = row["attacker_manoeuvre"] == manoeuvre if is_exact else bool(row["in_position"])
        left_road = failed and row["collision_type"] == CollisionType.OFF_ROAD
        states = None if failed or met else states_of(stored.tables["states"])
        lacks = "" if states is None else lack_text(attack, row, states)
        return Trial(value, failed, met, left_road, lacks)

    def keep(self, margins: Sequence[MarginOf], command: str) -> None:
        """Write tables of the neighbouring trials, each failing one first, and a file of all trials.

        Args:
            margins: of the attacks.
            command: the command line that repeats them.
        """
        neighbours = [(m.attack, m.scale, trial.value) for m in margins for trial in m.margin.neighbours]
        plan = self._plan(neighbours)
        store = self._run(plan)
        consolidate(store, plan)
        episodes = {(attack, scale.by, value): k for k, (attack, scale, value) in enumerate(neighbours)}
        rows = [row for m in margins for row in _rows(m, episodes)]
        write_whole(self._folder / COMMAND, f"{command}\n".encode())
        write_whole(self._folder / TRIALS, trials_text(rows).encode())

    def _plan(self, trials: Sequence[tuple[str, Scale, float]]) -> SweepPlan:
        options = self._options
        cases = [
            Case(
                net=options.net,
                target=options.target,
                target_options=options.target_options,
                background=options.background,
                background_options={
                    **options.background_options,
                    "attack": self._asked_attack or attack,
                    scale.option: value,
                },
                seed=options.seed,
                episodes=1,
                demand=options.demand,
                scenes=options.scenes,
            ).model_dump(mode="json", exclude_none=True)
            for attack, scale, value in trials
        ]
        values = {
            "first_episode": self._number,
            "horizon_s": options.horizon_s,
            "sim": options.sim.model_dump(mode="json"),
            "scene": options.scene.model_dump(mode="json"),
            "cases": tuple(cases),
        }
        return plan_sweep(SweepSpec.of(values, "the margin"))

    def _must_be_own(self) -> None:
        """Refuse a folder that holds another kind of sweep, or the margin of other options."""
        marker = self._folder / SUBJECT
        if marker.is_file():
            if marker.read_bytes() != self._subject:
                raise ConfigError(
                    f"{self._folder}: holds the margin of another target, net, seed or option; choose another --out"
                )
        elif (self._folder / SWEEP_SETTINGS).exists() and not (self._folder / TRIALS).exists():
            raise FileError(self._folder, "holds a sweep", "choose another --out")

    def _run(self, plan: SweepPlan) -> Store:
        store = open_bench_store(self._folder, plan, 1)
        write_whole(self._folder / SUBJECT, self._subject)
        executor = _SharedExecutor(self._executor)
        run_sweep(plan, store, RemainingJobs.of(plan, store), executor, _RETRIES, lambda *_: None)
        return store


class _SharedExecutor(AbstractContextManager["_SharedExecutor"]):
    """An executor whose workers stay alive after a sweep, so that they load networks once; they end after an error."""

    def __init__(self, owner: ProcessExecutor) -> None:
        self._owner, self.slots = owner, owner.slots
        self.submit, self.wait = owner.submit, owner.wait

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if kind is not None:
            self._owner.__exit__(kind, error, trace)


def _rows(of_attack: MarginOf, episodes: dict[tuple[str, str, float], int]) -> Iterator[TrialRow]:
    """Yield the trials of a margin, mildest first."""
    mildest_first = sorted(
        of_attack.margin.trials, key=lambda trial: abs(trial.value - of_attack.scale.mildest)
    )
    for trial in mildest_first:
        episode_number = episodes.get((of_attack.attack, of_attack.scale.by, trial.value))
        yield TrialRow(
            of_attack.attack,
            of_attack.scale.by,
            trial.value,
            of_attack.scale.unit,
            trial.met,
            trial.failed,
            episode_number,
        )
