"""``advdiff-sumo defects``: what a user's own test can see of faults in a planner."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any

import typer

from advdiff_sumo.cli.bench import Scenes, Severity, run_or_print
from advdiff_sumo.cli.worker_flags import Timeout, Workers
from advdiff_sumo.core.errors import ConfigError

_FOLDER = Path("runs")


def defects(
    target: Annotated[
        str,
        typer.Option(help="Planner to plant them in: lane_graph, a plug-in's name, or package.module:Class."),
    ] = "lane_graph",
    background: Annotated[
        list[str] | None,
        typer.Option(
            help="Background that is to see them, as of bench defects; may be given several times.",
            show_default="sumo",
        ),
    ] = None,
    defect: Annotated[
        list[str] | None,
        typer.Option(
            help="Only this one, as NAME or NAME:SEVERITY; may be given several times.", show_default="all"
        ),
    ] = None,
    severity: Severity = None,
    scenes: Scenes = None,
    horizon: Annotated[
        float | None, typer.Option(help="Longest duration of an episode, s.", show_default="30")
    ] = None,
    workers: Workers = None,
    timeout: Timeout = 600.0,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the results; a finished one is only printed.", show_default="runs/defects-TARGET"
        ),
    ] = None,
) -> None:
    """Plant defects in a planner and print which of them a background detects, and its false alarms.

    advdiff-sumo defects --target my_planner:MyPlanner --background sumo --scenes 30

    The catalogue is in docs/defects.md. An interrupted one goes on with the same command; more scenes or defects in
    the same folder run only what is missing.
    """
    if not target.strip():
        raise ConfigError("--target is empty; name a planner, such as lane_graph")
    name = re.sub(r"[^\w.-]+", "-", target)
    given: dict[str, Any] = {
        "scenes": scenes,
        "policies": background or ["sumo"],
        "targets": [target],
        "defects": defect,
        "severity": severity,
        "horizon_s": horizon,
    }
    run_or_print("defects", out or _FOLDER / f"defects-{name}", workers, timeout, given)
