"""``advdiff-sumo data``: training windows out of simulations and driving logs, and what is in them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from advdiff_sumo.core.errors import ConfigError

if TYPE_CHECKING:
    from advdiff_sumo.sim.simulate import ShardResult

data = typer.Typer(
    name="data",
    help="Make training windows (2 s of past, 6 s of future, 2 Hz) and see what is in them.",
    no_args_is_help=True,
)
_say = Console(highlight=False, soft_wrap=True)


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
        float, typer.Option(min=0.0, max=1.0, help="Share of the windows on nets made up for them.")
    ] = 0.5,
    seed: Annotated[int, typer.Option(help="Same seed, same bytes.")] = 0,
    workers: Annotated[int, typer.Option(min=1, max=256, help="Processes.")] = 2,
) -> None:
    """Record natural SUMO traffic with varied drivers, vehicles and nets as training windows.

    Complete files in --out are kept, so the same command goes on after an interrupt. Example:

    advdiff-sumo data simulate --out windows --windows 20000 --seed 1
    """
    from advdiff_sumo.maps.shipped import SHIPPED_NETS  # late: --help needs no SUMO
    from advdiff_sumo.sim.simulate import SimulateOptions
    from advdiff_sumo.sim.simulate import simulate as simulated

    options = SimulateOptions.parse(
        {
            "windows": windows,
            "nets": tuple(net or SHIPPED_NETS),
            "random_share": random_share,
            "seed": seed,
            "workers": workers,
        }
    )
    if out.exists() and not out.is_dir():
        raise ConfigError(f"--out {out} is a file; name a folder")
    with _progress() as progress:
        task = progress.add_task("windows", total=windows)

        def tell(result: ShardResult) -> None:
            progress.update(task, advance=result.windows)
            if result.problem:
                progress.console.print(f"note: {result.problem}", markup=False)

        results = simulated(options, out, tell)
    made = sum(result.windows for result in results)
    _say.print(f"{out}: {made} windows in {len(results)} files", markup=False)


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
    )
