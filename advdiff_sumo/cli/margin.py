"""``advdiff-sumo margin``: find the mildest attack in a seed scene in which a target has a valid failure."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from advdiff_sumo.cli import run_flags as flags
from advdiff_sumo.cli.interruption import same_command_continues
from advdiff_sumo.cli.terminal import print_json, terminal
from advdiff_sumo.cli.worker_flags import (
    MEMORY_MB,
    PLAN_TIMEOUT_S,
    Memory,
    PlanTimeout,
    Timeout,
    end_as_by_ctrl_c,
    limits_of,
)
from advdiff_sumo.core.errors import ConfigError, EpisodeFailure
from advdiff_sumo.core.threads import one_thread_for_good
from advdiff_sumo.experiments.margin import EVERY_ATTACK, SCALES, scale_of

if TYPE_CHECKING:
    from rich.console import Console

    from advdiff_sumo.cli.margin_subject import MarginSubject
    from advdiff_sumo.experiments.margin import Scale, Trial
    from advdiff_sumo.experiments.margin_trials import MarginOf, MarginTrials
    from advdiff_sumo.sim.run_episodes import RunOptions

_FAILED = 1
_QUANTITIES = dict.fromkeys(scale.by for scales in SCALES.values() for scale in scales)

_Attack = Annotated[
    str | None,
    typer.Option(
        help=f"How it is attacked: {', '.join(SCALES)}, or {EVERY_ATTACK}.",
        show_default="as in the episode, else hard-stop",
    ),
]
_By = Annotated[
    str | None,
    typer.Option(
        help=f"Quantity that is varied: {', '.join(_QUANTITIES)}.",
        show_default="what the attack has, of cut-in the gap",
    ),
]
_Key = Annotated[
    str | None,
    typer.Argument(
        help="Key of an episode of a sweep, or how it begins; with --run its number. Its target, seed scene and "
        "attack are taken.",
        show_default=False,
    ),
]
_Number = Annotated[
    int | None,
    typer.Option(min=0, help="Which of the seed's scenes: that of this episode of a run.", show_default="0"),
]
_Out = Annotated[
    Path | None,
    typer.Option(help="Folder for the results.", show_default="runs/margin-…-sSEED"),
]
_Within = Annotated[
    float | None,
    typer.Option(
        min=0.01,
        max=10.0,
        help="The bisection stops at this distance of failing and passing.",
        show_default="0.25 m/s², 1 m, 0.05 s, of cut-out 0.1 s",
    ),
]


def margin(
    key: _Key = None,
    sweep: flags.OfSweep = None,
    run: flags.OfRun = None,
    target: flags.Target = None,
    net: flags.Net = None,
    attack: _Attack = None,
    by: _By = None,
    demand: flags.Demand = None,
    horizon: flags.Horizon = None,
    seed: flags.Seed = None,
    number: _Number = None,
    defect: flags.Defect = None,
    within: _Within = None,
    out: _Out = None,
    config: flags.Config = None,
    assign: flags.Assign = None,
    timeout: Timeout = 300.0,
    plan_timeout: PlanTimeout = PLAN_TIMEOUT_S,
    memory: Memory = MEMORY_MB,
    as_json: flags.Json = False,
) -> None:
    """Find the mildest attack on a target, in one seed scene, in which it fails and a careful driver would not.

    advdiff-sumo margin --target my_planner:MyPlanner --net motorway --attack cut-in --seed 3

    advdiff-sumo margin 53dd5b1d77f3 --sweep runs/planners

    The report shows the failing beside the passing neighbour. Trials that are in the folder are not run again.

    Exit code 0: a margin or a bound of it; 1: nobody was in a position to attack, or an episode failed; 2: something
    given cannot be used.
    """
    one_thread_for_good()
    end_as_by_ctrl_c()
    from advdiff_sumo.cli.margin_subject import described_subject, episode_subject  # late: --help is quick
    from advdiff_sumo.cli.run import options_given
    from advdiff_sumo.experiments.margin_command import episode_margin_command, margin_command
    from advdiff_sumo.experiments.margin_trials import MarginTrials
    from advdiff_sumo.sim.free_folder import named_folder

    if key is None:
        subject = described_subject(number, config, attack, run or sweep)
    else:
        given = {"--net": net, "--demand": demand, "--seed": seed, "--number": number, "--config": config}
        subject = episode_subject(key, run, sweep, attack, given | {"--target": target})
    attacks = _attacks(subject.attack, by, within, subject.default_scale)
    _check_assignments(assign or [], attacks)
    cli_options: dict[str, Any] = {"target": target, "net": net, "demand": demand and str(demand)}
    cli_options |= {"horizon_s": horizon, "seed": seed, "background": None if key else "scripted"}
    policy = {} if key else {"attackers": 1}
    options = _without_varied(
        options_given(config, cli_options, policy, assign or [], defect, subject.base), attacks
    )
    folder = out or named_folder("margin", subject.attack, *_folder_words(subject, options, target))
    console = terminal(quiet=as_json)
    with same_command_continues(folder), ExitStack() as stack:
        limits = limits_of(stack, timeout, plan_timeout, memory)
        trials = stack.enter_context(
            MarginTrials(options, subject.number, subject.asked_attack, folder, limits)
        )
        margins = _margins(console, trials, attacks, within, descends=subject.asked_attack is not None)
        if not margins:
            raise typer.Exit(_FAILED)
        chosen = {
            "--target": target,
            "--attack": attack,
            "--by": by,
            "--within": within,
            "--horizon": horizon,
        }
        command = (
            episode_margin_command(subject.source, chosen, defect or [], assign or [])
            if subject.source
            else margin_command(options, subject.number, subject.attack, by, within)
        )
        trials.keep(margins, command)
    _report(console, options.target, folder, subject.attack, margins, as_json)
    if len(margins) < len(attacks) or not any(result.margin.is_known for result in margins):
        raise typer.Exit(_FAILED)


def _folder_words(subject: MarginSubject, options: RunOptions, target: str | None) -> list[str]:
    """Return the words after which the folder of the results is named; *target* is that of the command line."""
    if subject.name:
        return [subject.name, *([target] if target else [])]
    planted = options.target_options.get("defects", ())
    defects = [planted] if isinstance(planted, str) else map(str, planted)
    place = f"s{options.seed}" + (f"-{subject.number}" if subject.number else "")
    return [options.net, options.target, *defects, place]


def _report(
    console: Console, target: str, folder: Path, attack: str, margins: Sequence[MarginOf], as_json: bool
) -> None:
    """Write the report, and print its path and the *margins* of *target*."""
    from advdiff_sumo.report.page import write_report

    report = write_report(folder)
    for result in margins:
        console.print(f"{target}: {result.margin.text(result.attack, result.scale)}", soft_wrap=True)
    console.print(f"look at {report}", soft_wrap=True)
    if as_json:
        paths = {"folder": str(folder.resolve()), "report": str(report.resolve())}
        print_json({**paths, **_json_values(attack, margins)})


def _json_values(attack: str, margins: Sequence[MarginOf]) -> dict[str, Any]:
    """Return the *margins* as ``--json`` prints them: the values of one attack, or a list for all attacks."""
    summaries = [result.summary() for result in margins]
    return {"margins": summaries} if attack == EVERY_ATTACK else summaries[0]


def _attacks(
    attack: str, by: str | None, within: float | None, default_scale: str | None
) -> list[tuple[str, Scale]]:
    """Return the requested attacks with the scales of their severities.

    Args:
        attack: a kind, or all.
        by: name of the scale.
        within: distance of the neighbouring values.
        default_scale: scale to take if *by* is None; None: the first of the attack.

    Raises:
        ConfigError: the attack or its scale is unknown, or an option for one attack is given for all.
    """
    if attack != EVERY_ATTACK:
        return [(attack, scale_of(attack, by or default_scale))]
    for option, value in (("--by", by), ("--within", within)):
        if value is not None:
            raise ConfigError(f"{option} goes with one attack; leave it out, or choose an --attack")
    return [(name, scale) for name, scales in SCALES.items() for scale in scales]


def _check_assignments(assignments: Sequence[str], attacks: Sequence[tuple[str, Scale]]) -> None:
    """Check that no ``--set`` gives an option that the search sets itself, as it would have no effect.

    Raises:
        ConfigError: one does.
    """
    remedies = {
        f"background_options.{scale.option}": "the search varies it; leave it out" for _, scale in attacks
    }
    remedies["background_options.attack"] = "name the attack with --attack"
    remedies["background"] = "a margin is that of background scripted, or of an episode's own; leave it out"
    remedies["episodes"] = "a margin is that of one seed scene; leave it out"
    for assignment in assignments:
        name = assignment.partition("=")[0].strip()
        if name in remedies:
            raise ConfigError(f"--set {assignment}: {remedies[name]}")


def _without_varied(options: RunOptions, attacks: Sequence[tuple[str, Scale]]) -> RunOptions:
    """Return *options* without the kind and the severity of an attack, which a run's own file may hold."""
    varied = {"attack", *(scale.option for _, scale in attacks)}
    kept = {name: value for name, value in options.background_options.items() if name not in varied}
    return options.model_copy(update={"background_options": kept})


def _margins(
    console: Console,
    trials: MarginTrials,
    attacks: Sequence[tuple[str, Scale]],
    within: float | None,
    descends: bool,
) -> list[MarginOf]:
    """Return the margins of *attacks*; leave out those in which an episode failed, and print its error."""
    margins = []
    for attack, scale in attacks:
        try:
            margins.append(_margin(console, trials, attack, scale, within, descends))
        except EpisodeFailure as failure:
            terminal(stderr=True, soft_wrap=True, highlight=False).print(f"error: {failure}", style="red")
    return margins


def _margin(
    console: Console, trials: MarginTrials, attack: str, scale: Scale, within: float | None, descends: bool
) -> MarginOf:
    """Return the margin of *attack*, and print every trial."""
    from advdiff_sumo.experiments.margin import bisect
    from advdiff_sumo.experiments.margin_trials import MarginOf

    def run(value: float) -> Trial:
        trial = trials.run(attack, scale, value)
        console.print(f"{attack}, {scale.text(value)}: {trial.outcome}", soft_wrap=True)
        return trial

    return MarginOf(attack, scale, bisect(run, scale, within, descends))
