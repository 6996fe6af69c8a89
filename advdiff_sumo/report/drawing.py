"""Draws one episode as an SVG or PNG file by matplotlib."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from matplotlib.patheffects import withStroke

from advdiff_sumo.core.errors import FileError, os_reason
from advdiff_sumo.report.layer import NetWindow, VisibleStreets
from advdiff_sumo.report.scene_picture import Box, Picture, Role, picture_of
from advdiff_sumo.report.selection import ChosenEpisode

COLOURS = {Role.TARGET: "#12824a", Role.ATTACKER: "#d95f02", Role.OTHER: "#8c9ba8"}
GROUND, IMPACT = "#eef2ec", "#c4122f"
_AREA, _MARKING = "#d3d8dc", "#ffffff"
_WIDTH_IN = 9.0
_DPI = 130


def figure(folder: Path, episode: int | None, path: Path) -> Path:
    """Draw an episode of the run in *folder* to *path* (.svg or .png) and return *path*.

    The same run gives the same bytes.

    Args:
        folder: of a finished run or sweep.
        episode: its number; None for the worst.
        path: the file to write.

    Raises:
        FileError: the run lacks the episode or its states, the ending is another, or *path* cannot be written.
    """
    check_ending(path, (".svg", ".png"))
    chosen = ChosenEpisode.read(folder, episode)
    save_figure(draw(picture_of(chosen.states, chosen.row, chosen.collisions, chosen.layer)), path)
    return path


def check_ending(path: Path, endings: tuple[str, ...]) -> str:
    """Return the ending of *path* in lower case.

    Raises:
        FileError: it is none of *endings*.
    """
    ending = path.suffix.lower()
    if ending not in endings:
        raise FileError(path, f"is neither {' nor '.join(endings)}", "choose one of these endings")
    return ending


def unwritable(path: Path, error: OSError) -> FileError:
    """Return the error for a *path* that cannot be written."""
    return FileError(path, f"cannot be written ({os_reason(error)})", "choose another place")


def frame_axes(axes: Axes, view: NetWindow) -> None:
    """Set *axes* to *view*, north up, without ticks."""
    axes.set(xlim=(view.x0_m, view.x1_m), ylim=(view.y0_m, view.y1_m), aspect="equal", xticks=[], yticks=[])


def draw(picture: Picture) -> Figure:
    """Return *picture* as a figure of matplotlib, north up."""
    view = picture.view
    fig = Figure(figsize=(_WIDTH_IN, _WIDTH_IN * view.height_m / view.width_m), dpi=_DPI, facecolor=GROUND)
    FigureCanvasAgg(fig)
    axes = fig.add_axes((0.0, 0.0, 1.0, 1.0))
    frame_axes(axes, view)
    axes.set_axis_off()
    points_per_m = 72.0 * _WIDTH_IN / view.width_m
    if picture.streets is not None:
        draw_streets(axes, picture.streets, points_per_m)
    _draw_traffic(axes, picture)
    _draw_impacts(axes, picture)
    _draw_legend(axes, picture)
    return fig


def draw_streets(axes: Axes, streets: VisibleStreets, points_per_m: float) -> None:
    """Draw the drivable area and its markings; *points_per_m* is the scale, a point being 1/72 inch."""
    if streets.areas:
        outline = Outline.make_compound_path(*(Outline(ring, closed=True) for ring in streets.areas))
        axes.add_patch(PathPatch(outline, facecolor=_AREA, linewidth=0.0, zorder=1))
    width = max(0.5, 0.14 * points_per_m)
    dash = max(1.0, 3.0 * points_per_m / width)
    axes.add_collection(LineCollection(list(streets.solid), colors=_MARKING, linewidths=width, zorder=2))
    axes.add_collection(
        LineCollection(
            list(streets.dashed), colors=_MARKING, linewidths=width, linestyles=[(0, (dash, dash))], zorder=2
        )
    )


def _draw_traffic(axes: Axes, picture: Picture) -> None:
    for order, trail in enumerate(picture.trails):
        opacity = 0.5 if trail.role is Role.OTHER else 0.85
        axes.plot(
            *trail.xy_m.T, color=COLOURS[trail.role], linewidth=1.4, alpha=opacity, zorder=3 + order * 1e-3
        )
    for box in picture.boxes:
        colour, past = COLOURS[box.role], box.age > 0.0
        alpha = 1.0 - 0.6 * box.age
        face, edge = (colour, 0.35 * alpha) if past else (colour, alpha), (colour if past else "white", alpha)
        outline = PolyCollection([box.corners_m], facecolors=face, edgecolors=edge, linewidths=0.8, zorder=4)
        axes.add_collection(outline)
        nose = np.stack((box.centre_m, box.corners_m[:2].mean(axis=0)))
        axes.plot(*nose.T, color=edge, linewidth=0.9, zorder=4)
        if box.label:
            _draw_time(axes, picture, box)


def _draw_time(axes: Axes, picture: Picture, box: Box) -> None:
    x, y = box.centre_m + (0.5 + 0.017 * picture.view.width_m) * box.label_side
    halo = [withStroke(linewidth=2.5, foreground=GROUND)]
    axes.text(
        x,
        y,
        box.label,
        color=COLOURS[box.role],
        path_effects=halo,
        fontsize=9,
        ha="center",
        va="center",
        clip_on=True,
        zorder=6,
    )


def _draw_impacts(axes: Axes, picture: Picture) -> None:
    for point in picture.other_impacts_m:
        axes.plot(*point, marker="x", color=IMPACT, markersize=6, markeredgewidth=1.2, zorder=7)
    if picture.impact_m is not None:
        axes.plot(*picture.impact_m, marker="x", color=IMPACT, markersize=12, markeredgewidth=3.0, zorder=8)


def _draw_legend(axes: Axes, picture: Picture) -> None:
    attacker = "collision partner" if picture.partner else "nearest vehicle"
    names = {Role.TARGET: "target, a box a second", Role.ATTACKER: attacker, Role.OTHER: "other traffic"}
    roles = [role for role in names if any(trail.role is role for trail in picture.trails)]
    handles = [Line2D([], [], color=COLOURS[role], linewidth=5, label=names[role]) for role in roles]
    if picture.impact_m is not None:
        cross = Line2D([], [], color=IMPACT, linestyle="", marker="x", markersize=9, markeredgewidth=2.5)
        cross.set_label("impact")
        handles.append(cross)
    axes.legend(handles=handles, loc="upper right", fontsize=9, framealpha=0.9)


def save_figure(fig: Figure, path: Path) -> None:
    """Write *fig* to *path* (.svg or .png), without dates.

    Raises:
        FileError: *path* cannot be written.
    """
    kind = path.suffix.lower()[1:]
    metadata = {"Date": None, "Creator": None} if kind == "svg" else {"Software": None}
    try:
        with mpl.rc_context({"svg.hashsalt": "advdiff-sumo", "svg.fonttype": "none"}):
            fig.savefig(path, format=kind, metadata=metadata, facecolor=fig.get_facecolor(), dpi=_DPI)
    except OSError as error:
        raise unwritable(path, error) from None
