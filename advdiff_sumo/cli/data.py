"""``advdiff-sumo data``: make training windows from simulations and driving logs, and print their statistics."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from advdiff_sumo.cli.interruption import same_command_continues
from advdiff_sumo.cli.terminal import progress_bar, terminal
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.map_view import MapView
from advdiff_sumo.core.wording import counted

if TYPE_CHECKING:
    from advdiff_sumo.sim.training_windows.log_windows import Built
    from advdiff_sumo.sim.training_windows.simulate import ShardResult, SimulateOptions

data = typer.Typer(
    name="data",
    help="Make training windows (2 s of past, 6 s of future, 2 Hz) and see what is in them.",
    no_args_is_help=True,
)
_LISTED_DRIVES = 5  # in a note
_console = terminal(highlight=False, soft_wrap=True)
_MapView = Annotated[
    MapView,
    typer.Option(help="Map that each vehicle sees: 60 m around, or what it may drive in 6 s, too."),
]


@data.command()
def simulate(
    out: Annotated[Path, typer.Option(help="Folder for the window files.")],
    net: Annotated[
        list[str] | None,
        typer.Option(
            help="SUMO net or a shipped one; may be given several times.",
            show_default="downtown, downtown-left, motorway",
        ),
    ] = None,
    windows: Annotated[int, typer.Option(min=1, help="How many windows in all.")] = 24_000,
    random_share: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of the windows on random nets.")
    ] = 0.5,
    map_view: _MapView = "near",
    driven_by: Annotated[
        str,
        typer.Option(
            metavar="WEIGHTS",
            help="Let a trained model drive (closed-loop, or a file) before SUMO's drivers take over: windows of what "
            "to do where its own driving leads.",
            show_default="SUMO's drivers alone",
        ),
    ] = "",
    seed: Annotated[int, typer.Option(min=0, help="Random seed; the same one gives the same bytes.")] = 0,
    workers: Annotated[int, typer.Option(min=1, max=256, help="Processes.")] = 2,
) -> None:
    """Record natural SUMO traffic with varied drivers, vehicles and nets as training windows.

    Complete files in --out are kept, so the same command goes on after an interrupt. Example:

    advdiff-sumo data simulate --out windows --windows 20000 --seed 1
    """
    from advdiff_sumo.maps.shipped_nets import SHIPPED_NETS  # late: --help needs no SUMO
    from advdiff_sumo.sim.training_windows.simulate import SimulateOptions

    options = SimulateOptions.parse(
        {
            "windows": windows,
            "nets": tuple(net or SHIPPED_NETS),
            "random_share": random_share,
            "view": map_view,
            "driven_by": driven_by,
            "seed": seed,
        }
    )
    if out.exists() and not out.is_dir():
        raise ConfigError(f"--out {out} is a file; name a folder")
    with same_command_continues(out):
        _simulate(options, out, workers)


def _simulate(options: SimulateOptions, out: Path, workers: int) -> None:
    """Make the windows with a progress bar, and print how many there are."""
    from advdiff_sumo.sim.training_windows.simulate import plan, simulate

    with progress_bar(terminal(stderr=True)) as progress:
        task = progress.add_task("windows", total=options.windows)

        def show(result: ShardResult) -> None:
            progress.update(task, advance=result.windows)
            if result.problem:
                progress.console.print(f"note: {result.problem}")

        results = simulate(plan(options), out, workers, show)
    total = sum(result.windows for result in results)
    _console.print(f"{out}: {counted(total, 'window')} in {counted(len(results), 'file')}")
    if total < options.windows:
        _console.print("note: traffic on small nets brought fewer windows than asked for")


@data.command()
def build(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...",
            help="Logs of nuScenes, ScenarioNet, Argoverse 2 or CommonRoad, or folders of runs and sweeps.",
        ),
    ],
    out: Annotated[
        Path, typer.Option(help="Window file (.safetensors) where all drives are on one net, or a folder.")
    ],
    net: Annotated[
        list[str] | None,
        typer.Option(help="Net of the log's map; may be given several times.", show_default="of the run"),
    ] = None,
    convert: Annotated[
        bool, typer.Option("--convert", help="Convert the logs' own maps; the nets go to --out/nets.")
    ] = False,
    split: Annotated[
        str | None,
        typer.Option(
            help="Scenes of a nuScenes split: train, val, train_val, mini_train, mini_val.",
            show_default="all scenes",
        ),
    ] = None,
    challenge: Annotated[
        bool, typer.Option("--challenge", help="The windows of nuScenes' prediction challenge alone.")
    ] = False,
    stride: Annotated[float, typer.Option(min=0.5, help="Seconds between windows.")] = 0.5,
    ego_only: Annotated[
        bool, typer.Option("--ego-only", help="Windows around the recording vehicle alone.")
    ] = False,
    map_view: _MapView = "near",
) -> None:
    """Cut driving logs into training windows, each drive on the net of its map.

    advdiff-sumo data build nuscenes --convert --out windows/nuscenes

    advdiff-sumo data build runs/downtown-IDM-sumo-s0 --out windows/runs
    """
    from advdiff_sumo.data import open_log  # late, as above
    from advdiff_sumo.maps import RoadMap
    from advdiff_sumo.maps.shipped_nets import find_net
    from advdiff_sumo.sim.training_windows.log_nets import LogNets
    from advdiff_sumo.sim.training_windows.log_windows import BuildOptions
    from advdiff_sumo.sim.training_windows.log_windows import build as build_windows

    is_file = _is_window_file(out)
    if abs(2.0 * stride - round(2.0 * stride)) > 1e-9:
        raise ConfigError(f"--stride {stride:g}: windows are spaced by multiples of 0.5 s")
    readers = [(path, open_log(path)) for path in logs]
    converted = (out.parent if is_file else out) / "nets" if convert else None
    nets = LogNets(tuple(RoadMap.read(find_net(name)) for name in net or ()), converted)
    options = BuildOptions(stride, not ego_only, split, challenge, map_view)
    with progress_bar(terminal(stderr=True), transient=True) as progress:
        task = progress.add_task("drives", total=None)
        counts = build_windows(readers, nets, options, out, lambda *_: progress.update(task, advance=1))
        progress.update(task, total=progress.tasks[task].completed)
    _print_counts(counts)


def _is_window_file(out: Path) -> bool:
    """Return whether *out* names a window file; otherwise it names a folder.

    Raises:
        ConfigError: *out* names a file but is a folder, or vice versa.
    """
    is_file = out.suffix == ".safetensors"
    if out.is_dir() if is_file else out.is_file():
        raise ConfigError(f"--out {out} is a {'folder' if is_file else 'file'}; name another place")
    return is_file


def _print_counts(counts: Built) -> None:
    """Print how many windows were made, and which drives have none and why."""
    for path, count in counts.files.items():
        _console.print(f"{path}: {counted(count, 'window')}")
    left_out: dict[str, list[str]] = {}
    for skipped in counts.skipped:
        left_out.setdefault(skipped.reason, []).append(skipped.drive)
    for reason, drives in left_out.items():
        names = ", ".join(drives[:_LISTED_DRIVES]) + (", …" if len(drives) > _LISTED_DRIVES else "")
        _console.print(f"note: no windows of {counted(len(drives), 'drive')} ({names}): {reason}")


@data.command()
def stats(
    places: Annotated[list[Path], typer.Argument(metavar="PLACE...", help="Window files or folders.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Print what is in window files: counts, classes, speeds, accelerations, curvatures, gaps.

    advdiff-sumo data stats windows
    """
    from advdiff_sumo.data.stats import window_stats
    from advdiff_sumo.data.window_files import read_windows, window_paths  # late, as above

    statistics = window_stats(read_windows(path) for path in window_paths(places))
    if as_json:
        typer.echo(json.dumps(statistics, indent=1))
        return
    table = Table(show_header=False)
    for name, value in statistics.items():
        parts = value if isinstance(value, dict) else {"": value}
        text = "  ".join(f"{key} {part:g}".strip() for key, part in parts.items())
        table.add_row(name.replace("_", " "), text)
    terminal().print(table)
