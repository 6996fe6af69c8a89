"""``advdiff-sumo defects``: measure which planted defects of a planner a background detects."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

from advdiff_sumo.cli import run_flags as flags
from advdiff_sumo.cli.bench import FOLDER, DefectsLicence, RetryFailed, Severity, run_or_print
from advdiff_sumo.cli.worker_flags import Timeout, Workers
from advdiff_sumo.config import set_dotted
from advdiff_sumo.core.errors import ConfigError

_Target: TypeAlias = Annotated[
    str, typer.Option(help="Planner to plant them in: lane_graph, a plug-in's name, or package.module:Class.")
]
_Background: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        help="Background that is to see them, as of bench defects; may be given several times.",
        show_default="sumo",
    ),
]
_Defect: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        help="Only this one, as NAME or NAME:SEVERITY; may be given several times.", show_default="all"
    ),
]
_Net: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        help="Seed scenes of this net, .sumocfg or shipped net, as run finds them; several take turns.",
        show_default="a shipped list of seed scenes",
    ),
]
_Scenes: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="Number of scenes of --net or the shipped list; or a list file, or a driving log: one a second.",
        show_default="60",
    ),
]
_Horizon: TypeAlias = Annotated[
    float | None, typer.Option(help="Longest duration of an episode, s.", show_default="30")
]
_Assign: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Another option of run, as NAME=VALUE: scene.…, sim.…, seed and demand with --net, "
        "background_options.… and target_options.….",
    ),
]
_Out: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        help="Folder of the results; a finished one is only printed.",
        show_default="runs/defects-TARGET, with --net …-NET",
    ),
]


def defects(
    target: _Target = "lane_graph",
    background: _Background = None,
    defect: _Defect = None,
    severity: Severity = None,
    net: _Net = None,
    scenes: _Scenes = None,
    licence: DefectsLicence = None,
    horizon: _Horizon = None,
    assign: _Assign = None,
    workers: Workers = None,
    timeout: Timeout = 600.0,
    retry_failed: RetryFailed = False,
    out: _Out = None,
    as_json: flags.Json = False,
) -> None:
    """Plant defects in a planner and print which of them a background detects, and its false alarms.

    advdiff-sumo defects --target my_planner:MyPlanner --background scripted --net city.net.xml --scenes 30

    advdiff-sumo list defects prints the catalogue. An interrupted one goes on with the same command; more scenes or
    defects in the same folder run only what is missing.
    """
    if not target.strip():
        raise ConfigError("--target is empty; name a planner, such as lane_graph")
    parts = (target, *(re.split(r"[/\\]", path)[-1].split(".")[0] for path in net or ()))
    folder_name = "-".join(re.sub(r"[^\w.-]+", "-", part) for part in parts)
    cli_options: dict[str, Any] = {
        "scenes": scenes,
        "policies": background or ["sumo"],
        "targets": [target],
        "defects": defect,
        "severity": severity,
        "horizon_s": horizon,
        "licence": licence,
        **_nets_and_options(net or [], assign or []),
    }
    path = out or FOLDER / f"defects-{folder_name}"
    run_or_print("defects", path, workers, timeout, cli_options, as_json, retry_failed)


def _nets_and_options(nets: list[str], assignments: list[str]) -> dict[str, Any]:
    """Return the given nets and options of the episodes, with absolute paths of files; None: not given."""
    from advdiff_sumo.maps.shipped_nets import net_name  # late: --help needs no maps

    options: dict[str, Any] = {}
    for assignment in assignments:
        set_dotted(options, assignment)
    if isinstance(options.get("demand"), str):
        options["demand"] = str(Path(options["demand"]).resolve())
    names = list(dict.fromkeys(net_name(net) for net in nets))
    return {"nets": names or None, "options": options or None}
