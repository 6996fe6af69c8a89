"""Compare collisions and plausibility of configurations of background policies, on seed scenes that no table uses.

A configuration is a background with its options, such as ``strive:rate=0.3,persistence=0.8``; ``strive:`` has the
defaults of the paper's tables, with ``licence=reckless`` unless it is given. All configurations have the same targets
in the same seed scenes. Finished episodes in the folder are not run again, so that configurations can be added one by
one:

    python tools/tune_rivals.py advsim: advsim:spread=0.6 strive: --targets lane_graph,IDM --scenes 10

The table is printed and written to table.md in the folder.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from advdiff_sumo.cli.terminal import Bars, terminal
from advdiff_sumo.cli.worker_flags import limits_of
from advdiff_sumo.config import set_dotted
from advdiff_sumo.experiments.bench.bench_rows import policy_row
from advdiff_sumo.experiments.bench.cells import BenchCell, BenchCells, plan_cells, run_cells
from advdiff_sumo.experiments.bench.episode_results import (
    EpisodeResult,
    Gathered,
    failures_sentence,
    gather_rows,
)
from advdiff_sumo.experiments.bench.intervals import Ratio, Sample
from advdiff_sumo.experiments.bench.print_table import print_table
from advdiff_sumo.experiments.bench.scene_list import TUNING_LIST, SceneList, read_scene_list, shipped_list
from advdiff_sumo.experiments.bench.table import Head, RowSamples, Table, lines_of
from advdiff_sumo.experiments.bench.write_table import markdown_text

HEADS = (
    Head("collision_rate", "collisions", "%", 100.0, 0, "high"),
    Head("touched", "BV collisions", "by episode", better="low"),
    Head("off_road", "BV off the road", "by episode", better="low"),
    Head("cpu_s", "processor time", "s", digits=1, measured=True),
)


def options_of(text: str) -> tuple[str, dict[str, Any]]:
    """Return the background and the options of ``policy:key=value,key=value``."""
    policy, _, rest = text.partition(":")
    options: dict[str, Any] = {}
    for part in filter(None, rest.split(",")):
        set_dotted(options, part)
    return policy, options


def samples_of(results: Sequence[EpisodeResult]) -> dict[str, Sample]:
    """Return the samples from which the table's cells of one configuration and target are computed."""
    scenes, ones = tuple(result.scene for result in results), np.ones(len(results))

    def mean(values: list[Any], rate: bool = False) -> Ratio:
        return Ratio(scenes, np.array([value or 0.0 for value in values], dtype=np.float64), ones, rate)

    return {
        "collision_rate": mean([result.row["target_collision"] for result in results], rate=True),
        "touched": mean([result.row["bv_collisions"] for result in results]),
        "off_road": mean([result.row["bv_offroad_vehicles"] for result in results]),
        "cpu_s": mean([result.cpu_s for result in results]),
    }


def table_of(results: Gathered, title: str) -> Table:
    """Return the table of the gathered *results*."""
    rows = [
        RowSamples(cell.row, cell.target, cell.row, samples_of(episodes))
        for cell, episodes in results.finished.items()
    ]
    failed = failures_sentence(results, results.finished)
    return Table("tune-rivals", title, HEADS, lines_of(HEADS, rows, {}), notes=(failed,) if failed else ())


def cells_of(
    configurations: Sequence[str], targets: Sequence[str], scenes: SceneList, horizon_s: float
) -> BenchCells:
    """Return the episodes of each configuration against each target."""
    configured = [(text, *options_of(text)) for text in configurations]
    cells = [
        BenchCell(text, target, policy, background_options={**policy_row(policy).options, **options})
        for text, policy, options in configured
        for target in targets
    ]
    return plan_cells(cells, scenes, horizon_s)


def main() -> None:
    """Run the configurations, and print and write their table."""
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
    cells = cells_of(given.configurations, given.targets.split(","), scenes, given.horizon)
    console = terminal()
    with ExitStack() as stack:
        limits = limits_of(stack, 600.0)
        bars = stack.enter_context(Bars(console))
        store = run_cells(cells, given.out, given.workers, limits, bars)
    title = f"{given.scenes} seed scenes of {given.list.name}, {given.horizon:g} s"
    table = table_of(gather_rows(cells, store), title)
    print_table(console, table)
    (given.out / "table.md").write_text(markdown_text(table), encoding="utf-8")


if __name__ == "__main__":
    main()
