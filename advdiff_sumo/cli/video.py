"""``advdiff-sumo video``: film an episode."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def video(
    run: Annotated[Path, typer.Argument(help="Folder of a run or sweep.", show_default=False)],
    out: Annotated[Path, typer.Argument(help="Film to write: .mp4 or .gif.", show_default=False)],
    episode: Annotated[
        int | None, typer.Option(help="Number of the episode.", show_default="the worst")
    ] = None,
    speed: Annotated[
        float, typer.Option(min=0.05, max=20.0, help="Seconds of the episode in a second of film.")
    ] = 1.0,
    start: Annotated[
        float | None, typer.Option(help="First moment, in seconds.", show_default="30 s before the last")
    ] = None,
    end: Annotated[
        float | None, typer.Option(help="Last moment, in seconds.", show_default="the episode's end")
    ] = None,
) -> None:
    r"""Film an episode from above.

    advdiff-sumo video runs/first --episode 3 episode.mp4

    GIF needs nothing more; MP4 needs pip install 'advdiff-sumo\[video]'. The same run gives the same bytes.
    """
    from advdiff_sumo.experiments.folder_rows import put_together  # late: --help needs no plots
    from advdiff_sumo.report.video import video as film

    put_together(run)
    film(run, episode, out, speed, start, end)
    typer.echo(str(out))
