"""``advdiff-sumo margin``: the least severe encounter of a seed scene in which a target fails validly."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from advdiff_sumo.cli import run_flags as flags
from advdiff_sumo.cli.terminal import terminal
from advdiff_sumo.cli.worker_flags import MEMORY_MB, PLAN_TIMEOUT_S, Memory, PlanTimeout, limits_of
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.threads import one_thread_for_good


def margin(
    target: flags.Target = None,
    net: flags.Net = None,
    attack: Annotated[
        str, typer.Option(help="How it is attacked: hard-stop, cut-in, stop-and-go or blocked-lane.")
    ] = "hard-stop",
    demand: flags.Demand = None,
    horizon: flags.Horizon = None,
    seed: flags.Seed = None,
    defect: flags.Defect = None,
    within: Annotated[
        float, typer.Option(min=0.05, max=4.0, help="How near the two neighbours shall be, m/s².")
    ] = 0.25,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results.", show_default="runs/margin-ATTACK-sSEED")
    ] = None,
    config: flags.Config = None,
    assign: flags.Assign = None,
    timeout: Annotated[float, typer.Option(min=0.1, help="Longest time for one episode, s.")] = 300.0,
    plan_timeout: PlanTimeout = PLAN_TIMEOUT_S,
    memory: Memory = MEMORY_MB,
) -> None:
    """Find the mildest attack on a target, in one seed scene, in which it fails and a careful driver would not.

    advdiff-sumo margin --target my_planner:MyPlanner --net motorway --attack cut-in --seed 3

    The report shows the failing and the passing neighbour. Trials that are in the folder are not run again.
    """
    one_thread_for_good()
    from advdiff_sumo.cli.run import options_given  # late: --help needs no simulator
    from advdiff_sumo.experiments.margin import SCALED, MarginTrials, bisect
    from advdiff_sumo.report import write_report

    if attack not in SCALED:
        raise ConfigError(f"--attack {attack}: a margin is known for {', '.join(SCALED)}; choose one of them")
    given = {
        "target": target,
        "net": net,
        "demand": demand and str(demand),
        "horizon_s": horizon,
        "seed": seed,
        "background": "scripted",
    }
    options = options_given(config, given, {"attack": attack, "attackers": 1}, assign or [], defect)
    folder = out or Path("runs") / f"margin-{attack}-s{options.seed}"
    console = terminal()
    with ExitStack() as stack:
        trials = MarginTrials(options, folder, limits_of(stack, timeout, plan_timeout, memory))

        def fails(braking_mps2: float) -> bool:
            failed = trials.fails(braking_mps2)
            console.print(f"{braking_mps2:5.2f} m/s²  {'valid failure' if failed else 'no valid failure'}")
            return failed

        found = bisect(fails, within)
        trials.keep(found)
    report = write_report(folder)
    if found.fails_mps2 is None:
        console.print(
            f"{options.target} copes with {attack} up to {found.passes_mps2:g} m/s²: no margin to find"
        )
    elif found.passes_mps2 is None:
        console.print(
            f"{options.target} fails at {found.fails_mps2:g} m/s² already, the mildest that is tried"
        )
    else:
        console.print(
            f"{options.target} copes with {attack} at {found.passes_mps2:g} m/s² and fails at {found.fails_mps2:g} m/s²"
        )
    console.print(f"look at {report}", soft_wrap=True)
