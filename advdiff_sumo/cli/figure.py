"""``advdiff-sumo figure``: draw an episode."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def figure(
    run: Annotated[Path, typer.Argument(help="Folder of a run or sweep.", show_default=False)],
    out: Annotated[Path, typer.Argument(help="Picture to write: .svg or .png.", show_default=False)],
    episode: Annotated[
        int | None, typer.Option(help="Number of the episode.", show_default="the worst")
    ] = None,
    panels: Annotated[
        int, typer.Option(min=0, help="Moments side by side; 0: one picture, a box a second.")
    ] = 4,
    start: Annotated[
        float | None, typer.Option(help="First moment, in seconds.", show_default="6 s before the last")
    ] = None,
    end: Annotated[
        float | None, typer.Option(help="Last moment, in seconds.", show_default="contact, or when nearest")
    ] = None,
) -> None:
    """Draw an episode: moments side by side, natural paths pale, driven ones as linked circles.

    advdiff-sumo figure runs/first --episode 3 episode.svg

    The same run gives the same bytes.
    """
    from advdiff_sumo.core.errors import ConfigError
    from advdiff_sumo.experiments.folder_rows import put_together  # late: --help needs no plots
    from advdiff_sumo.report.drawing import figure as draw_picture
    from advdiff_sumo.report.strip import film_strip

    if panels == 0 and (start is not None or end is not None):
        raise ConfigError("--start and --end go with --panels of 1 or more")
    put_together(run)
    if panels == 0:
        draw_picture(run, episode, out)
    else:
        film_strip(run, episode, out, panels, start, end)
    typer.echo(str(out))
