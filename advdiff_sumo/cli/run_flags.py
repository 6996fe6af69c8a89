"""The options of ``advdiff-sumo run``; by default they are not set, so that the values of a file apply."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.traffic.attack_names import KIND_NAMES, RECKLESS_ATTACKS

Net: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="SUMO net (.net.xml, .net.xml.gz), a .sumocfg with its demand, or one of advdiff-sumo list nets.",
        show_default="downtown",
    ),
]
Target: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="What drives the target: IDM, Krauss, …, lane_graph, package.module:Class, grpc://HOST:PORT, "
        "or exec:COMMAND.",
        show_default="IDM",
    ),
]
Background: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="What moves the background vehicles: sumo, replay, scripted, diffusion, …, or package.module:Class.",
        show_default="sumo",
    ),
]
Episodes: TypeAlias = Annotated[int | None, typer.Option(help="How many episodes.", show_default="10")]
Horizon: TypeAlias = Annotated[
    float | None, typer.Option(help="Longest duration of an episode, in seconds.", show_default="20")
]
Seed: TypeAlias = Annotated[
    int | None, typer.Option(help="Random seed; the same one gives the same bytes.", show_default="0")
]
Demand: TypeAlias = Annotated[
    Path | None,
    typer.Option(help="Route file (.rou.xml) or .sumocfg of the net; without it traffic is made up."),
]
Scenes: TypeAlias = Annotated[
    Path | None,
    typer.Option(help="Driving log to start from: nuScenes, Argoverse 2, ScenarioNet, CommonRoad, or a run."),
]
Out: TypeAlias = Annotated[
    Path | None,
    typer.Option(help="Folder for the results.", show_default="runs/NET-TARGET-…-sSEED"),
]
Config: TypeAlias = Annotated[
    Path | None, typer.Option(help="TOML file with options, such as a run's own run.toml.")
]
Assign: TypeAlias = Annotated[
    list[str] | None,
    typer.Option("--set", help="Any other option, as NAME=VALUE: --set sim.control_radius_m=80."),
]
OfSweep: TypeAlias = Annotated[
    Path | None, typer.Option(help="Folder of the sweep.", show_default="the one in runs/ that has it")
]
OfRun: TypeAlias = Annotated[Path | None, typer.Option(help="Folder of a run, in place of a sweep.")]
Gui: TypeAlias = Annotated[bool, typer.Option("--gui", help="Watch in sumo-gui (needs a display).")]
Resume: TypeAlias = Annotated[bool, typer.Option("--resume", help="Go on with an interrupted run in --out.")]
RetryFailed: TypeAlias = Annotated[
    bool, typer.Option("--retry-failed", help="With --resume: run failed episodes again.")
]
Strength: TypeAlias = Annotated[
    float | None,
    typer.Option(
        help="diffusion: how hard attackers go for the target, 0 (natural traffic) to 1.", show_default="1"
    ),
]
Attackers: TypeAlias = Annotated[
    int | None,
    typer.Option(
        help="diffusion: how many vehicles are guided at a time, and how many manoeuvres go on beside them.",
        show_default="2",
    ),
]
Licence: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="What attackers may do: lawful (no rule broken), careless, or reckless (the paper's).",
        show_default="lawful",
    ),
]
Attack: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help=f"diffusion and scripted: {', '.join(KIND_NAMES)}; "
        f"with --licence reckless: {', '.join(RECKLESS_ATTACKS)}.",
        show_default="any",
    ),
]
Guide: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="diffusion: reward, reward-only without the attack's own terms, or none for natural traffic.",
        show_default="reward",
    ),
]
Weights: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="diffusion: trained weights, or shipped ones: closed-loop (usual) or traffic (usual for a reckless one).",
        show_default="the shipped ones",
    ),
]
Reward: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        help="scripted and diffusion: what advdiff-sumo warmup learned of the target.", show_default="none"
    ),
]
Device: TypeAlias = Annotated[
    str | None, typer.Option(help="diffusion: auto, cpu or cuda.", show_default="auto")
]
Defect: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--defect",
        help="Plant a defect in the target, as NAME:SEVERITY: late:1.0, range:strong; may be given several times.",
    ),
]
Check: TypeAlias = Annotated[
    bool, typer.Option("--check", help="Print which background vehicle did what no vehicle should do.")
]
NoReport: TypeAlias = Annotated[bool, typer.Option("--no-report", help="Draw no report.html at the end.")]
Quiet: TypeAlias = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
Json: TypeAlias = Annotated[
    bool, typer.Option("--json", help="Print the result as one JSON object and nothing else.")
]


def check_retry(retry_failed: bool, resume: bool) -> None:
    """Raise ConfigError for ``--retry-failed`` without ``--resume``."""
    if retry_failed and not resume:
        raise ConfigError("--retry-failed runs the failed episodes of an earlier folder again; add --resume")


def check_display(gui: bool) -> None:
    """Raise an error if sumo-gui is requested but there is no display."""
    if gui and sys.platform == "linux" and not os.environ.get("DISPLAY"):
        raise ConfigError("--gui needs a display; set DISPLAY, or leave --gui out")


def weights_of(weights: str | None) -> str | None:
    """Return ``--weights`` as an option of a run: an absolute path, or the name of shipped networks."""
    if weights is None or not (Path(weights).exists() or Path(weights).suffix):
        return weights
    return str(Path(weights).resolve())
