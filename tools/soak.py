"""Run every background, target and attack on many nets: soak.py OUT [--data FOLDER] [--episodes 2] [--workers 2].

Each place (net, demand or log) is a sweep in OUT/NAME. A second call keeps finished episodes and runs the others. Then
the states are checked independently: NaN, jumps, vehicles that SUMO drives beside all lanes, and the contacts of the
target, by shapely. Every failure is a line with the command that repeats its episode, on the terminal and in
OUT/failures.txt. The exit code is 1 if there is a failure, and 130 after Ctrl-C; the same command continues.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
from soak_src.checks import States, problems, runs_of
from soak_src.places import Place, places

from advdiff_sumo.cli.interruption import KEPT
from advdiff_sumo.core.errors import INTERRUPTED, UNEXPLAINED_KINDS, AdvdiffError
from advdiff_sumo.core.threads import one_thread_for_good
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.shipped_nets import find_net
from advdiff_sumo.sweep.consolidate import read_rows
from advdiff_sumo.sweep.executors import ProcessExecutor
from advdiff_sumo.sweep.job_plan import plan_sweep
from advdiff_sumo.sweep.spec import SweepSpec
from advdiff_sumo.sweep.sweep_runner import RemainingJobs, open_store, run_sweep
from advdiff_sumo.sweep.tasks import WorkerLimits

TARGETS = ("IDM", "Krauss", "lane_graph")
ATTACKS = ("any", "cut-in", "brake", "junction")
BACKGROUNDS: tuple[dict[str, Any], ...] = (
    {"name": "sumo"},
    {"name": "replay"},
    {"name": "diffusion", "vary": {"attack": list(ATTACKS)}},
    {"name": "diffusion", "options": {"strength": 0.0}},
    {"name": "diffusion", "vary": {"licence": ["careless", "reckless"]}},
    {"name": "scripted"},
    {"name": "adv-rl"},
)
SLOW: tuple[dict[str, Any], ...] = ({"name": "advsim"}, {"name": "strive"}, {"name": "traj2traj"})
SCENE = {
    "warmup_s": 20.0,
    "scenes_per_warmup": 4,
    "spacing_s": 2.0,
    "min_neighbours": 1,
    "min_route_m": 30.0,
    "min_speed_mps": 0.0,
    "density_per_km": 20.0,
    "max_vehicles": 400,
}
RETRIES = 1
#: Kinds of failures that must not occur: those without explanation, and hangs. All others name their cause.
UNTYPED = UNEXPLAINED_KINDS | {"timeout"}


def main() -> int:
    """Run and check all places, and print a line for each; return the exit code."""
    options = _options()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    one_thread_for_good()
    options.out.mkdir(parents=True, exist_ok=True)
    deadline = time.monotonic() + 60.0 * options.minutes
    total: Counter[str] = Counter()
    with (options.out / "failures.txt").open("w", encoding="utf-8") as file:
        for place in places(options.out / "nets", options.data, options.seeds):
            if time.monotonic() > deadline:
                break
            if options.places is not None and place.name not in options.places:
                continue
            counts: Counter[str] = Counter()
            for result, line in _results(place, options):
                counts[result] += 1
                if line:
                    print(f"{result}: {place.name}: {line}", file=file, flush=True)
                    print(f"  {result}: {line}")
            print(f"{place.name:44} {_counts_text(counts)}", flush=True)
            total += Counter({**counts, "places": 1})
    print(f"total: {_counts_text(total)}")
    return int(any(total[result] for result in ("untyped", "lost", "wrong", "broken")))


def _results(place: Place, options: argparse.Namespace) -> Iterator[tuple[str, str]]:
    """Yield a word for the result of each episode of *place*, and a line on what is wrong; "" if nothing is."""
    if place.problem:
        yield "no net", place.problem
        return
    folder = options.out / place.name
    try:
        missing = _run(place, folder, options)
    except AdvdiffError as error:
        yield "no scene", str(error)
        return
    for _ in range(missing):
        yield "lost", f"no record of an episode; advdiff-sumo sweep {folder / 'sweep.toml'} --resume"
    failures = {row["episode"]: row for row in read_rows(folder, "failures")}
    for row in failures.values():
        result = "untyped" if row["kind"] in UNTYPED else "typed"
        yield result, f"{row['kind']}: {row['message']} | {row['command']}"
    rows = {row["episode"]: row for row in read_rows(folder, "episodes")}
    keys = {number: row["key"] for number, row in rows.items()}
    wrong: set[int] = set()
    replays = {number for number, row in rows.items() if row["background"] == "replay"}
    for number, sentence in _problems(place, folder, replays):
        wrong.add(number)
        yield "wrong", f"{sentence} | advdiff-sumo replay {keys.get(number, number)} --sweep {folder}"
    for number in keys:
        if number not in wrong and number not in failures:
            yield "sound", ""


def _run(place: Place, folder: Path, options: argparse.Namespace) -> int:
    """Run the episodes that are not in *folder* yet; return how many are missing afterwards."""
    backgrounds = [
        choice
        for choice in (*BACKGROUNDS, *(SLOW if options.slow else ()))
        if options.backgrounds is None or choice["name"] in options.backgrounds
    ]
    plan = plan_sweep(
        SweepSpec.of(
            {
                "episodes": options.episodes,
                "horizon_s": options.horizon,
                "scene": SCENE,
                "grid": {
                    "nets": [{"net": place.net, "demand": place.demand, "scenes": place.scenes}],
                    "targets": list(TARGETS),
                    "backgrounds": backgrounds,
                },
            },
            place.name,
        )
    )
    store = open_store(folder, plan, options.workers, resume=(folder / "sweep.toml").exists())
    (folder / "logs").mkdir(exist_ok=True)
    limits = WorkerLimits(options.timeout, 8000, tasks=10**6, recycle_share=1.0, logs=folder / "logs")
    executor = ProcessExecutor(options.workers, limits)
    return run_sweep(plan, store, RemainingJobs.of(plan, store), executor, RETRIES, lambda *_: None)


def _problems(place: Place, folder: Path, replays: set[int]) -> Iterator[tuple[int, str]]:
    """Yield (episode, sentence) for what is wrong in the states of the place's episodes.

    *replays* are the episodes in which the others repeat their recorded motion.
    """
    road = RoadMap.read(find_net(place.net))
    contacts = read_rows(folder, "collisions")
    table = pq.read_table(folder / "states.parquet")
    columns = {name: table.column(name).to_numpy() for name in table.column_names}
    for number, rows in runs_of(columns["episode"]):
        states = States.of(
            {name: values[rows] for name, values in columns.items()},
            replay=number in replays,
            log=bool(place.scenes),
        )
        own_contacts = [row for row in contacts if row["episode"] == number]
        for sentence in problems(states, road, own_contacts):
            yield number, sentence


def _counts_text(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {word}" for word, count in sorted(counts.items()))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("out", type=Path, help="folder of results")
    parser.add_argument("--data", type=Path, help="folder of real nets and logs")
    parser.add_argument("--episodes", type=int, default=2, help="seed scenes a place")
    parser.add_argument("--horizon", type=float, default=5.0, help="longest episode, s")
    parser.add_argument("--seeds", type=int, default=10, help="nets of each random kind")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--timeout", type=float, default=120.0, help="longest episode on the clock, s")
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no further place after so long")
    parser.add_argument("--places", nargs="*", help="only these, by the names of their folders")
    parser.add_argument("--backgrounds", nargs="*", help="only these")
    parser.add_argument("--slow", action="store_true", help="advsim, strive and traj2traj too")
    return parser.parse_args()


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        print(f"{KEPT}; the same command goes on", file=sys.stderr)
        sys.exit(INTERRUPTED)
