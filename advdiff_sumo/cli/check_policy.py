"""``advdiff-sumo check-policy``: check that a background policy fulfils its contract."""

from __future__ import annotations

import math
from contextlib import ExitStack
from functools import partial
from typing import Annotated, Any

import typer

from advdiff_sumo.cli.contract_checks import TIMEOUT_S, Episodes, Horizon, Net, Timeout, tell_checks
from advdiff_sumo.cli.run import options_given
from advdiff_sumo.cli.worker_flags import MEMORY_MB, Memory, end_as_by_ctrl_c, limits_of
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.threads import one_thread_for_good


def check_policy(
    name: Annotated[
        str, typer.Argument(help="As of --background: scripted, a plug-in's name, or package.module:Class.")
    ],
    net: Net = "downtown",
    assign: Annotated[
        list[str] | None,
        typer.Option(
            "--set", help="An option, as of run: --set background_options.NAME=VALUE, scene.NAME, sim.NAME."
        ),
    ] = None,
    episodes: Episodes = 2,
    horizon: Horizon = 5.0,
    within_ms: Annotated[
        float | None, typer.Option(min=0.0, help="Longest median time of a plan.", show_default="any")
    ] = None,
    seed: Annotated[int, typer.Option(help="Of traffic and policy.")] = 0,
    timeout: Timeout = TIMEOUT_S,
    memory: Memory = MEMORY_MB,
) -> None:
    """Check a background policy: its contract, hard scenes, that it repeats itself, planning times, its traffic.

    advdiff-sumo check-policy my_policy:MyPolicy --set background_options.gap_m=3

    It is checked in a process of its own, with SUMO's IDM as the target. Collisions of background vehicles and road
    departures are counted, and no contract forbids them.

    Exit code 0: it may be used; 1: a check fails; 2: there is no such policy, or it cannot be made.
    """
    end_as_by_ctrl_c()
    one_thread_for_good()
    from advdiff_sumo.experiments.check_results import checked_in_worker  # late: not for --help
    from advdiff_sumo.experiments.policy_trial import check_background

    _check_run_options(assign or [])
    cli_options: dict[str, Any] = {"background": name, "net": net, "episodes": episodes, "seed": seed}
    cli_options |= {"horizon_s": horizon, "scene": {"scenes_per_warmup": episodes}}
    cli_options |= {"sim": {"record_natural": False, "record_plans": 0}}
    options = options_given(None, cli_options, {}, assign or [])
    check = partial(check_background, options, math.inf if within_ms is None else within_ms)
    with ExitStack() as stack:
        limits = limits_of(stack, timeout, math.inf, memory)
        verdicts = checked_in_worker(check, limits, lambda line: typer.echo(line, err=True))
    tell_checks(name, verdicts)


def _check_run_options(assignments: list[str]) -> None:
    """Check that each of *assignments* sets an option of ``run``.

    Raises:
        ConfigError: ``run`` has no such option; it may be one of the policy.
    """
    from advdiff_sumo.sim.run_episodes import RunOptions  # late, as above

    for assignment in assignments:
        path = assignment.partition("=")[0].strip()
        if path.partition(".")[0] not in RunOptions.model_fields:
            raise ConfigError(
                f"--set {assignment}: run has no option '{path}'; one of the policy is background_options.{path}"
            )
