"""Collisions and plausibility of configurations of background policies, on seed scenes that no table uses.

A configuration is a background with its options, ``strive:rate=0.3,persistence=0.8``; ``strive:`` alone is its
default, as in the paper's tables: its attackers may do anything (``licence=reckless``) unless it says otherwise. All
meet the same targets in the same seed scenes. What is there already in the folder is not run again, so that one
configuration after the other can be added:

    python tools/tune_rivals.py advsim: advsim:spread=0.6 strive: --targets lane_graph,IDM --scenes 10

The table is printed and written to table.md in the folder.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from advdiff_sumo.experiments.bench.bench_rows import policy_row
from advdiff_sumo.experiments.bench.cells import BenchCell, BenchCells, plan_cells, run_cells
from advdiff_sumo.experiments.bench.scene_list import TUNING_LIST, SceneList, read_scene_list, shipped_list
from advdiff_sumo.metrics.severity import is_failure
from advdiff_sumo.metrics.statistics import wilson
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.tasks import WorkerLimits

COLUMNS = ("configuration", "target", "collisions", "95 %", "BV collisions", "BV off the road", "s/episode")


@dataclass(frozen=True)
class Result:
    """What one configuration came to against one target.

    Attributes:
        episodes: that finished.
        hits: in which the target collided.
        touched: collisions of background vehicles among themselves.
        off_road: moved background vehicles that left the road.
        seconds: of the clock, by episode.
    """

    episodes: int
    hits: int
    touched: int
    off_road: int
    seconds: float

    @staticmethod
    def of(rows: Sequence[tuple[dict[str, Any], float]]) -> Result:
        """Return the result of *rows* of ``episodes``, each with its time."""
        known, times = [row for row, _ in rows], [time for _, time in rows]
        return Result(
            len(rows),
            sum(bool(row["target_collision"]) for row in known),
            sum(row["bv_collisions"] or 0 for row in known),
            sum(row["bv_offroad_vehicles"] or 0 for row in known),
            sum(times) / max(1, len(times)),
        )

    def cells(self) -> tuple[str, ...]:
        """Return what is printed."""
        low, high = wilson(self.hits, self.episodes) if self.episodes else (0.0, 1.0)
        between = f"{100 * low:.0f}–{100 * high:.0f} %"
        counts = f"{self.hits} of {self.episodes}", between, str(self.touched), str(self.off_road)
        return *counts, f"{self.seconds:.1f}"


def options_of(text: str) -> tuple[str, dict[str, Any]]:
    """Return the background and the options of ``policy:key=value,key=value``."""
    policy, _, rest = text.partition(":")
    pairs = [part.partition("=") for part in rest.split(",") if part]
    return policy, {key.strip(): _value(value.strip()) for key, _, value in pairs}


def _value(text: str) -> int | float | str:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def results(cells: BenchCells, store: Store) -> dict[tuple[str, str], Result]:
    """Return the result of each configuration and target."""
    rows_of: dict[tuple[str, str], list[tuple[dict[str, Any], float]]] = {}
    for cell, job in cells.jobs():
        rows = rows_of.setdefault((cell.row, cell.target), [])
        part = store.read(job.key)
        if part is not None and "episodes" in part.tables:
            (row,), (timing,) = part.tables["episodes"].to_pylist(), part.tables["timing"].to_pylist()
            if not is_failure(row):
                rows.append((row, timing["wall_s"]))
    return {key: Result.of(rows) for key, rows in rows_of.items()}


class Printed:
    """Prints how far the episodes are, now and then."""

    def __init__(self, console: Console) -> None:
        self.console, self.total, self.done = console, 0, 0

    def begin(self, what: str, total: int, done: int = 0) -> None:
        """Say what is to do."""
        self.total, self.done = total, done
        self.console.print(f"{what}: {total}, {done} of them done before")

    def step(self, words: str = "") -> None:
        """Say every tenth."""
        self.done += 1
        if self.done % 10 == 0:
            self.console.print(f"{self.done} of {self.total} · {words}")

    def say(self, sentence: str) -> None:
        """Print it."""
        self.console.print(sentence)


def measure(
    configurations: Sequence[str],
    targets: Sequence[str],
    scenes: SceneList,
    horizon_s: float,
    workers: int,
    folder: Path,
) -> dict[tuple[str, str], Result]:
    """Run what *folder* lacks and return all results."""
    configured = [(text, *options_of(text)) for text in configurations]
    cells = plan_cells(
        [
            BenchCell(text, target, policy, background_options={**policy_row(policy).options, **options})
            for text, policy, options in configured
            for target in targets
        ],
        scenes,
        horizon_s,
    )
    with tempfile.TemporaryDirectory() as logs:
        limits = WorkerLimits(timeout_s=600.0, memory_mb=4000, tasks=250, recycle_share=0.5, logs=Path(logs))
        store = run_cells(cells, folder, workers, limits, Printed(Console()))
    return results(cells, store)


def write(results: dict[tuple[str, str], Result], path: Path) -> None:
    """Write the table as Markdown."""
    rows = [COLUMNS, ("---",) * len(COLUMNS)]
    rows += [(f"`{text}`", target, *result.cells()) for (text, target), result in results.items()]
    path.write_text("".join(f"| {' | '.join(row)} |\n" for row in rows), encoding="utf-8")


def main() -> None:
    """Run, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("configurations", nargs="+", help="policy:key=value,key=value")
    parser.add_argument("--targets", default="lane_graph,IDM", help="with commas")
    parser.add_argument("--scenes", type=int, default=10, help="the list's first so many")
    parser.add_argument("--list", type=Path, default=shipped_list(TUNING_LIST), help="of seed scenes")
    parser.add_argument("--horizon", type=float, default=10.0, help="longest duration of an episode, s")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/tune-rivals"))
    given = parser.parse_args()
    scenes = read_scene_list(given.list).first(given.scenes)
    targets = given.targets.split(",")
    measured = measure(given.configurations, targets, scenes, given.horizon, given.workers, given.out)
    table = Table(title=f"{given.scenes} seed scenes of {given.list.name}, {given.horizon:g} s")
    for name in COLUMNS:
        table.add_column(name)
    for (text, target), result in measured.items():
        table.add_row(text, target, *result.cells())
    Console(width=140).print(table)
    write(measured, given.out / "table.md")


if __name__ == "__main__":
    main()
