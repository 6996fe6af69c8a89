"""``advdiff-sumo verdict``: judge the collisions of a finished run or sweep, or of a recorded scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from advdiff_sumo.cli import run_flags as flags
from advdiff_sumo.cli.terminal import print_json, progress_bar, terminal
from advdiff_sumo.cli.worker_flags import cores
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.wording import counted


def verdict(
    folder: Annotated[
        Path,
        typer.Argument(help="Folder of a run or sweep; with --net a scenario or log.", show_default=False),
    ],
    workers: Annotated[int, typer.Option(min=0, help="Processes; 0: one a core.")] = 0,
    search: Annotated[
        bool,
        typer.Option(
            "--search",
            help="Look for any drive that avoids each collision, knowing what the others will do (seconds each).",
        ),
    ] = False,
    net: Annotated[
        str, typer.Option(help="SUMO net of a scenario: a file that was exported, or a driving log.")
    ] = "",
    target: Annotated[
        str,
        typer.Option(
            help="Road user of a scenario to judge.",
            show_default="the exported target, or the log's recording vehicle",
        ),
    ] = "",
    as_json: flags.Json = False,
) -> None:
    """Judge the collisions of a finished run or sweep: which of them count, and why.

    advdiff-sumo verdict runs/first

    Adds the columns of the verdict to episodes.parquet and collisions.parquet, or brings them up to date, and writes
    the report again. Folders of earlier versions will do; what they do not hold is named in each verdict's sentence.

    advdiff-sumo verdict scenario.xml --net nets/scenario.net.xml --target 42

    Judges a road user of a CommonRoad scenario, another driving log or an exported file, and writes nothing.
    """
    if net:
        _judge_scenarios(folder, net, target, search, as_json)
        return
    if target:
        raise ConfigError("--target is for scenarios, which need --net, too; a run knows its target")
    from advdiff_sumo.cli.summary import run_object
    from advdiff_sumo.experiments.judge_folder import open_judging
    from advdiff_sumo.report.page import write_report

    console = terminal(quiet=as_json)
    judging = open_judging(folder)
    if judging.doubt:
        console.print(
            f"judged on the nets that are there now: {judging.doubt}", style="yellow", soft_wrap=True
        )
    with progress_bar(console) as bar:
        task = bar.add_task("episodes judged", total=judging.count)
        rows = judging.judge(workers or cores(), lambda: bar.advance(task), search)
    _print_counts(console, rows, search)
    if (folder / "report.html").exists():
        console.print(f"look at {write_report(folder)}", soft_wrap=True)
    if as_json:
        print_json(run_object(folder))


def _print_counts(console: Console, rows: Sequence[Mapping[str, Any]], search: bool) -> None:
    """Print the numbers of collisions, valid failures, near misses and rule breaches.

    Args:
        console: receives the text.
        rows: of ``episodes.parquet``; those without an outcome are counted as failed.
        search: whether to print the number of unavoidable collisions, too.
    """
    from advdiff_sumo.metrics.severity import broke_rule, has_outcome, is_valid_failure

    failed = sum(not has_outcome(row) for row in rows)
    rows = [row for row in rows if has_outcome(row)]
    collided = [row for row in rows if row["target_collision"]]
    valid, critical = sum(map(is_valid_failure, rows)), sum(bool(row["critical"]) for row in rows)
    collisions = f"{counted(len(collided), 'collision')} of the target: {counted(valid, 'valid failure')}"
    console.print(f"{counted(len(rows), 'episode')}, {collisions}")
    console.print(counted(critical, "critical near miss"))
    console.print(f"{counted(sum(map(broke_rule, rows)), 'episode')} in which the target broke a rule")
    if failed:
        console.print(f"{counted(failed, 'episode')} failed: not judged")
    if search:
        console.print(f"{sum(bool(row['unavoidable']) for row in collided)} unavoidable")


def _judge_scenarios(path: Path, net: str, target: str, search: bool, as_json: bool) -> None:
    """Judge and print each scenario in *path*; *target* is the road user to judge, "" the default one."""
    from advdiff_sumo.experiments.judge_scenario import judge_scenario, outcome, read_scenarios  # as above
    from advdiff_sumo.maps import RoadMap
    from advdiff_sumo.maps.shipped_nets import find_net

    console = terminal(highlight=False, soft_wrap=True, quiet=as_json)
    road = RoadMap.read(find_net(net))
    judged = []
    for scenario in read_scenarios(path, target or None):
        judgement = judge_scenario(scenario, road, search)
        console.print(f"{scenario.name}, {scenario.target_id}: {outcome(judgement.metrics)}")
        judged.append({"scenario": scenario.name, "target": scenario.target_id, **judgement.summary()})
    if as_json:
        print_json({"scenarios": judged})
