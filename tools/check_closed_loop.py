"""Compare verdicts, in which the others move as recorded, with a careful driver among others that react.

python tools/check_closed_loop.py FOLDER ... [--collisions 100] [--driver careful|same] [--differences]

The tool repeats episodes with collisions of finished runs or sweeps. The target's own planner drives up to the takeover
of the verdict's reference drive. From there on, the target "careful" (or the same reference drive) drives, while SUMO
and the background react. Printed are a table of both answers, and Cohen's kappa with its 95 % interval. The targets
must be Python planners, and the version must be the one that ran the episodes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from reference_src.agreement import cohens_kappa
from reference_src.reference_rerun import ClosedLoop, Driver, close_loop

from advdiff_sumo.cli.terminal import progress_bar, terminal
from advdiff_sumo.core.errors import AdvdiffError, InputError
from advdiff_sumo.core.threads import one_thread_for_good
from advdiff_sumo.data.run_tables import SWEEP_SETTINGS
from advdiff_sumo.experiments.judge_folder import EpisodeTables, open_judging
from advdiff_sumo.sweep.job_plan import Job, SweepPlan, plan_sweep
from advdiff_sumo.sweep.repeat import episode_again, of_run
from advdiff_sumo.sweep.sweep_store import Store


@dataclass(frozen=True)
class Candidate:
    """A stored episode in which the target collided with another road user."""

    folder: Path
    store: Store
    plan: SweepPlan
    job: Job
    stored: EpisodeTables


def main() -> int:
    """Repeat collisions and print how often both answers agree; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+", help="finished runs or sweeps")
    parser.add_argument("--collisions", type=int, default=100, help="how many, drawn from all of them")
    parser.add_argument(
        "--driver", type=Driver, choices=list(Driver), default=Driver.CAREFUL, help="who takes over"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the draw")
    parser.add_argument("--differences", action="store_true", help="name the episodes in which they differ")
    given = parser.parse_args()
    one_thread_for_good()
    try:
        drawn = draw([x for folder in given.folders for x in collided(folder)], given.collisions, given.seed)
        results, omitted = run_again(drawn, given.driver)
    except InputError as error:
        print(f"check_closed_loop: {error}", file=sys.stderr)
        return 2
    for reason in omitted:
        print(f"left out: {reason}")
    if not results:
        print("check_closed_loop: no collision could be run again", file=sys.stderr)
        return 2
    print_agreement(results, given.differences)
    return 0


def collided(folder: Path) -> Iterator[Candidate]:
    """Yield the stored episodes of *folder* in which the target collided with another road user.

    Raises:
        InputError: the folder holds no run and no sweep, or one of another version.
    """
    if (folder / SWEEP_SETTINGS).exists():
        store = Store.open(folder)
        plan = plan_sweep(store.spec())
        store.must_match(plan.keys)
        jobs = {job.key: job for job in plan.jobs}
    else:
        first = of_run("0", folder)
        store, plan = first.store, first.plan
        jobs = {str(job.number): job for job in plan.jobs}
    for key, stored in open_judging(folder).episodes():
        if stored.row["collision_partner"]:
            yield Candidate(folder, store, plan, jobs[key], stored)


def draw(candidates: list[Candidate], count: int, seed: int) -> list[Candidate]:
    """Return *count* random candidates in their order; all if there are fewer."""
    chosen = np.random.default_rng(seed).permutation(len(candidates))[:count]
    return [candidates[index] for index in sorted(chosen.tolist())]


def run_again(drawn: list[Candidate], driver: Driver) -> tuple[list[tuple[Candidate, ClosedLoop]], list[str]]:
    """Repeat the *drawn* collisions; return their results, and the reasons for those left out."""
    results, omitted = [], []
    with progress_bar(terminal()) as bar:
        task = bar.add_task("collisions run again", total=len(drawn))
        for candidate in drawn:
            name = f"{candidate.folder}, episode {candidate.job.key}"
            try:
                result = again(candidate, driver)
            except AdvdiffError as error:
                omitted.append(f"{name}: {error}")
            else:
                if result is None:
                    omitted.append(f"{name}: no reference driver could be put in the target's place")
                else:
                    results.append((candidate, result))
            bar.advance(task)
    return results, omitted


def again(candidate: Candidate, driver: Driver) -> ClosedLoop | None:
    """Repeat one collision; return None if there is no record or no reference drive."""
    _, episode = episode_again(candidate.store, candidate.plan, candidate.job)
    record = candidate.stored.record()
    return None if record is None else close_loop(episode, record, driver)


def print_agreement(results: list[tuple[Candidate, ClosedLoop]], differences: bool) -> None:
    """Print the table of answers and kappa; with *differences*, also the episodes whose answers differ."""
    recorded = np.array([x.preventable for _, x in results])
    reacting = np.array([x.avoided for _, x in results])
    print(f"{len(results)} collisions      avoided while others react   not")
    for text, mask in (("preventable by the verdict", recorded), ("not preventable", ~recorded)):
        print(f"{text:<27}{int((mask & reacting).sum()):>12}{int((mask & ~reacting).sum()):>19}")
    print(f"agreement {float((recorded == reacting).mean()):.1%}")
    print(f"run into from behind by a third, not held against it: {sum(x.run_into for _, x in results)}")
    try:
        kappa, low, high = cohens_kappa(recorded, reacting)
        print(f"kappa {kappa:.2f} (95 %: {low:.2f} to {high:.2f})")
    except ValueError as error:
        print(f"kappa is undefined: {error}")
    if differences:
        for candidate, result in results:
            if result.preventable != result.avoided:
                outcome = "avoided" if result.avoided else "not avoided"
                print(f"    {candidate.folder}, episode {candidate.job.key}: {outcome} where others react")


if __name__ == "__main__":
    sys.exit(main())
