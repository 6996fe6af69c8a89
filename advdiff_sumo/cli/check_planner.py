"""``advdiff-sumo check-planner``: check that a planner fulfils its contract."""

from __future__ import annotations

import math
from contextlib import ExitStack
from typing import Annotated, Any

import typer

from advdiff_sumo.cli.contract_checks import TIMEOUT_S, Episodes, Horizon, Net, Timeout, tell_checks
from advdiff_sumo.cli.run_flags import Defect
from advdiff_sumo.cli.worker_flags import MEMORY_MB, Memory, end_as_by_ctrl_c, limits_of
from advdiff_sumo.config import set_dotted
from advdiff_sumo.core.threads import one_thread_for_good


def check_planner(
    name: Annotated[
        str, typer.Argument(help="As of --target: lane_graph, a plug-in's name, or package.module:Class.")
    ],
    net: Net = "downtown",
    assign: Annotated[
        list[str] | None,
        typer.Option(
            "--set", help="An option of the planner, as NAME=VALUE or as for run: target_options.NAME=VALUE."
        ),
    ] = None,
    defect: Defect = None,
    episodes: Episodes = 2,
    horizon: Horizon = 10.0,
    within_ms: Annotated[float, typer.Option(min=0.0, help="Longest median time of a plan.")] = 500.0,
    seed: Annotated[int, typer.Option(help="Of traffic and planner.")] = 0,
    timeout: Timeout = TIMEOUT_S,
    memory: Memory = MEMORY_MB,
) -> None:
    """Check a planner: its contract, that it repeats itself, how it copes with hard scenes, and how long it takes.

    advdiff-sumo check-planner my_planner:MyPlanner --set headway_s=1.5

    It is checked in a process of its own: a planner that crashes, hangs or leaves fails, too.

    Exit code 0: it may be tested; 1: a check fails; 2: there is no such planner, or it cannot be made.
    """
    end_as_by_ctrl_c()
    one_thread_for_good()
    from advdiff_sumo.experiments.target_trial import Extent, check_in_worker  # late: not for --help

    options: dict[str, Any] = {"defects": defect} if defect else {}
    for assignment in assign or ():
        set_dotted(options, assignment.strip().removeprefix("target_options."))
    extent = Extent(net=net, episodes=episodes, horizon_s=horizon, within_ms=within_ms, seed=seed)
    with ExitStack() as stack:
        limits = limits_of(stack, timeout, math.inf, memory)
        verdicts = check_in_worker(name, options, extent, limits, lambda line: typer.echo(line, err=True))
    tell_checks(name, verdicts)
