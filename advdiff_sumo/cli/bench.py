"""``advdiff-sumo bench``: the paper's tables, computed from our own runs."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from advdiff_sumo.cli.interruption import same_command_continues
from advdiff_sumo.cli.run import tell_changed_code
from advdiff_sumo.cli.terminal import Bars, print_json, terminal
from advdiff_sumo.cli.worker_flags import Timeout, Workers, cores, end_as_by_ctrl_c, limits_of
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.threads import one_thread_for_good

if TYPE_CHECKING:
    from advdiff_sumo.experiments.bench.bench_config import BenchName, Folder

bench = typer.Typer(
    name="bench",
    help="The paper's tables out of our own runs: paired by seed scene, with intervals, beside the paper's figures.",
    no_args_is_help=True,
)
FOLDER = Path("runs")

Out = Annotated[
    Path | None,
    typer.Option(help="Folder of the bench; a finished one is only printed.", show_default="runs/bench-NAME"),
]
Scenes = Annotated[
    str | None,
    typer.Option(
        help="Number of scenes of the shipped list; or the file of a list, or a driving log: a scene a second.",
        show_default=False,
    ),
]
Horizon = Annotated[
    float | None,
    typer.Option(help="Longest duration of an episode, s.", show_default="10; from a driving log 6"),
]
Policies = Annotated[
    str | None, typer.Option(help="Only these rows, with commas.", show_default="all there are")
]
Targets = Annotated[
    str | None, typer.Option(help="Only these targets, with commas.", show_default="all there are")
]
Steps = Annotated[int | None, typer.Option(min=1, help="Steps of each warm-up.", show_default="90")]
Licence = Annotated[
    str | None,
    typer.Option(help="What attackers may do: lawful, careless, reckless.", show_default="reckless"),
]
DefectsLicence = Annotated[
    str | None,
    typer.Option(help="What attackers may do: lawful, careless, reckless.", show_default="lawful"),
]
Severity = Annotated[
    str | None,
    typer.Option(
        help="Severity of defects given without one: weak, middle or strong.", show_default="strong"
    ),
]
RetryFailed = Annotated[
    bool, typer.Option("--retry-failed", help="Run the failed episodes of an earlier time again.")
]


@bench.command()
def traffic(
    scenes: Annotated[str | None, typer.Option(help="How many windows.", show_default="300")] = None,
    data: Annotated[
        list[Path] | None,
        typer.Option(
            help="Window file, or a folder of them; may be given several times.",
            show_default="made for it, on shipped and random nets",
        ),
    ] = None,
    policies: Policies = None,
    seeds: Annotated[
        int | None, typer.Option(min=1, help="Random seeds of the samples.", show_default="1")
    ] = None,
    samples: Annotated[
        int | None, typer.Option(min=2, help="Joint samples of a window.", show_default="10")
    ] = None,
    workers: Workers = None,
    out: Out = None,
) -> None:
    """Natural traffic, open loop: diversity, realism and common sense of each model (the paper's first table).

    advdiff-sumo bench traffic --data windows/nuscenes --out runs/bench-nuscenes
    """
    cli_options = {
        "scenes": scenes,
        "data": [str(path.resolve()) for path in data or ()] or None,
        "policies": policies,
        "seeds": seeds,
        "samples": samples,
    }
    run_or_print("traffic", out, workers, 300.0, cli_options)


@bench.command()
def adversarial(
    scenes: Scenes = None,
    policies: Policies = None,
    targets: Targets = None,
    horizon: Horizon = None,
    licence: Licence = None,
    workers: Workers = None,
    timeout: Timeout = 600.0,
    retry_failed: RetryFailed = False,
    out: Out = None,
) -> None:
    """Attacks, closed loop: collisions, comfort, plausibility and speed of each policy (the paper's second table).

    advdiff-sumo bench adversarial --scenes 300 --policies diffusion,unguided,replay,sumo --out runs/guided
    """
    cli_options = {"scenes": scenes, "policies": policies, "targets": targets, "horizon_s": horizon}
    cli_options |= {"licence": licence}
    run_or_print("adversarial", out, workers, timeout, cli_options, retry_failed=retry_failed)


@bench.command()
def transfer(
    scenes: Scenes = None,
    policies: Policies = None,
    targets: Targets = None,
    horizon: Horizon = None,
    steps: Steps = None,
    licence: Licence = None,
    workers: Workers = None,
    timeout: Timeout = 600.0,
    retry_failed: RetryFailed = False,
    out: Out = None,
) -> None:
    """Adapted to one planner, met by another (the paper's third table).

    advdiff-sumo bench transfer --policies diffusion,strive --targets lane_graph,IDM
    """
    cli_options = {"scenes": scenes, "policies": policies, "targets": targets, "horizon_s": horizon}
    cli_options |= {"steps": steps, "licence": licence}
    run_or_print("transfer", out, workers, timeout, cli_options, retry_failed=retry_failed)


@bench.command()
def fewshot(
    scenes: Scenes = None,
    targets: Targets = None,
    seeds: Annotated[
        int | None, typer.Option(min=1, help="Warm-ups of each target.", show_default="5")
    ] = None,
    steps: Steps = None,
    horizon: Horizon = None,
    licence: Licence = None,
    workers: Workers = None,
    timeout: Timeout = 600.0,
    retry_failed: RetryFailed = False,
    out: Out = None,
) -> None:
    """Collision rate against warm-up steps, for targets never met before (the paper's few-shot figure).

    advdiff-sumo bench fewshot --targets EIDM --seeds 3
    """
    cli_options = {"scenes": scenes, "targets": targets, "seeds": seeds, "horizon_s": horizon}
    cli_options |= {"steps": steps, "licence": licence}
    run_or_print("fewshot", out, workers, timeout, cli_options, retry_failed=retry_failed)


@bench.command()
def defects(
    scenes: Scenes = None,
    policies: Policies = None,
    targets: Targets = None,
    planted: Annotated[
        str | None,
        typer.Option(
            "--defects",
            help="Only these, with commas, as NAME or NAME:SEVERITY.",
            show_default="all there are",
        ),
    ] = None,
    severity: Severity = None,
    horizon: Annotated[
        float | None, typer.Option(help="Longest duration of an episode, s.", show_default="30")
    ] = None,
    licence: DefectsLicence = None,
    workers: Workers = None,
    timeout: Timeout = 600.0,
    retry_failed: RetryFailed = False,
    out: Out = None,
) -> None:
    """What each background is worth as a test: how many planted defects it detects, beside its false alarms.

    advdiff-sumo bench defects --policies sumo,diffusion --defects late,headway,priority:weak --scenes 30
    """
    cli_options = {
        "scenes": scenes,
        "policies": policies,
        "targets": targets,
        "defects": planted,
        "severity": severity,
        "horizon_s": horizon,
        "licence": licence,
    }
    run_or_print("defects", out, workers, timeout, cli_options, retry_failed=retry_failed)


def run_or_print(
    name: BenchName,
    out: Path | None,
    workers: int | None,
    timeout_s: float,
    cli_options: dict[str, Any],
    as_json: bool = False,
    retry_failed: bool = False,
) -> None:
    """Run a bench and print its table; print only the table if the bench is finished.

    Args:
        name: the bench.
        out: its folder; None: ``runs/bench-NAME``.
        workers: number of worker processes; None: one per core.
        timeout_s: longest time for one episode.
        cli_options: of the command line; None: not given. Policies, targets and defects may be texts with commas.
        as_json: print one JSON object and nothing else; for ``defects`` only.
        retry_failed: run the episodes that failed again, also those of a finished bench.
    """
    one_thread_for_good()
    from advdiff_sumo.experiments.bench.bench_config import Folder, open_bench, request_of
    from advdiff_sumo.experiments.bench.print_table import print_table  # late: --help needs no simulator
    from advdiff_sumo.experiments.bench.runner import DEFAULTS, check_request, run_bench
    from advdiff_sumo.experiments.bench.table_cache import finished_table

    end_as_by_ctrl_c()
    console = terminal(quiet=as_json)
    path = (out or FOLDER / f"bench-{name}").resolve()
    names = {option: _split_names(cli_options.get(option)) for option in ("policies", "targets", "defects")}
    scenes, log_defaults = _log_path_and_defaults(cli_options.get("scenes"))
    request = request_of(
        name, path, {**DEFAULTS[name], **log_defaults}, cli_options | names | {"scenes": scenes}
    )
    _print_changed_code(Folder(path, request))
    table = None if retry_failed else finished_table(Folder(path, request))
    printed: list[str] = []
    if table is None:
        check_request(request)
        folder = open_bench(path, request)
        with same_command_continues(path), ExitStack() as stack:
            limits = limits_of(stack, timeout_s)
            with Bars(console) as bars:
                table = run_bench(folder, workers or cores(), limits, bars, retry_failed)
                printed = bars.said
    if as_json:
        from advdiff_sumo.experiments.bench.defects_object import defects_object  # late, as above

        print_json(defects_object(path, table))
        return
    print_table(console, table, printed)
    files = "table.csv, table.tex, table.md, table.png"
    if name == "defects":
        files += ", detections.csv, first_detection.csv, by_stratum.csv, findings.csv"
    console.print(f"{files}: {path}", soft_wrap=True)


def _print_changed_code(folder: Folder) -> None:
    """Print which planners and policies have changed since the episodes in *folder* were run."""
    from advdiff_sumo.experiments.bench.cells import made_by
    from advdiff_sumo.sweep.code_digests import code_digests  # late, as above

    tell_changed_code(
        code_digests((*folder.request.targets, *folder.request.policies)), made_by(folder.sweep)
    )


def _log_path_and_defaults(scenes: str | None) -> tuple[str | None, dict[str, Any]]:
    """Return *scenes* and the default options of a bench from a driving log.

    If *scenes* is a driving log, its absolute path is returned; otherwise there are no such defaults.
    """
    from advdiff_sumo.experiments.bench.requested_scenes import LOG_HORIZON_S, is_log

    if scenes is None or not is_log(scenes):
        return scenes, {}
    return str(Path(scenes).resolve()), {"horizon_s": LOG_HORIZON_S}


def _split_names(text: str | list[str] | None) -> list[str] | None:
    """Return the names in *text*, which are separated by commas; a list, or None, is returned as it is.

    Raises:
        ConfigError: a name is empty.
    """
    if text is None or isinstance(text, list):
        return text
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise ConfigError(f"'{text}': a name is empty; write them as a,b")
    return names
