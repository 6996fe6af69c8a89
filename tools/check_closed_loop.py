"""How often do verdicts, which let the others move as recorded, agree with a careful driver among others who react?

python tools/check_closed_loop.py FOLDER ... [--collisions 100] [--driver careful|same] [--differences]

Runs the episodes of collisions of finished runs or sweeps again: the target's own planner drives up to the takeover
of the verdict's reference drive, the target "careful" (or that same drive) from there on, and SUMO and the background
react. Prints who says what, and Cohen's kappa with its 95 % interval. Needs Python planners as targets, and the
version that ran them.
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
    """A stored episode that ended in a collision with another."""

    folder: Path
    store: Store
    plan: SweepPlan
    job: Job
    stored: EpisodeTables


def main() -> int:
    """Run collisions again and print how far both agree; return the exit code."""
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
        results, lacking = run_again(drawn, given.driver)
    except InputError as error:
        print(f"check_closed_loop: {error}", file=sys.stderr)
        return 2
    for reason in lacking:
        print(f"left out: {reason}")
    if not results:
        print("check_closed_loop: no collision could be run again", file=sys.stderr)
        return 2
    tell(results, given.differences)
    return 0


def collided(folder: Path) -> Iterator[Candidate]:
    """Yield the stored episodes of *folder* in which the target collided with another.

    Raises:
        InputError: it holds no run and no sweep, or one of another version.
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
    """Return *count* of the candidates at random, in their order; all where there are fewer."""
    chosen = np.random.default_rng(seed).permutation(len(candidates))[:count]
    return [candidates[at] for at in sorted(chosen.tolist())]


def run_again(drawn: list[Candidate], driver: Driver) -> tuple[list[tuple[Candidate, ClosedLoop]], list[str]]:
    """Return what came of each, and of those left out the reasons."""
    results, lacking = [], []
    with progress_bar(terminal()) as bar:
        task = bar.add_task("collisions run again", total=len(drawn))
        for one in drawn:
            name = f"{one.folder}, episode {one.job.key}"
            try:
                result = again(one, driver)
            except AdvdiffError as error:
                lacking.append(f"{name}: {error}")
            else:
                if result is None:
                    lacking.append(f"{name}: no reference driver could be put in the target's place")
                else:
                    results.append((one, result))
            bar.advance(task)
    return results, lacking


def again(one: Candidate, driver: Driver) -> ClosedLoop | None:
    """Run one collision again."""
    _, episode = episode_again(one.store, one.plan, one.job)
    record = one.stored.record()
    return None if record is None else close_loop(episode, record, driver)


def tell(results: list[tuple[Candidate, ClosedLoop]], differences: bool) -> None:
    """Print the table of answers and kappa."""
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
        for one, result in results:
            if result.preventable != result.avoided:
                outcome = "avoided" if result.avoided else "not avoided"
                print(f"    {one.folder}, episode {one.job.key}: {outcome} where others react")


if __name__ == "__main__":
    sys.exit(main())
