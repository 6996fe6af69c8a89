"""Draws film strips of an episode, as in the paper's figures (AdvDiffuser, illustration of accident-prone scenarios).

Original trajectories are pale; those of the episode are linked circles. Boxes show all road users at the panel's time,
the target in green, the attacker in orange.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.boxes import corners
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.report.drawing import (
    COLOURS,
    GROUND,
    IMPACT,
    check_ending,
    draw_streets,
    frame_axes,
    save_figure,
)
from advdiff_sumo.report.layer import NetWindow
from advdiff_sumo.report.scene_picture import Role
from advdiff_sumo.report.selection import ChosenEpisode, poses_at

#: Default duration of a strip, and spacing of its circles: the model's step.
STRIP_S, CIRCLES_S = 6.0, 0.5
_MOST_PANELS = 8
_PANEL_IN, _LEGEND_IN = 3.1, 0.34
_PALE = "#ffffff"
_WIDEST_COMMON_VIEW_M = 90.0
"""If the common view of all panels is wider, each panel has a view of its own, so that cars stay visible."""


def film_strip(
    folder: Path,
    episode: int | None,
    path: Path,
    panels: int = 4,
    start_s: float | None = None,
    end_s: float | None = None,
) -> Path:
    """Write :func:`strip_figure` to *path* (.svg or .png) and return *path*.

    The same run gives the same bytes.

    Raises:
        FileError: as there, or the ending is another, or *path* cannot be written.
        ConfigError: as there.
    """
    check_ending(path, (".svg", ".png"))
    save_figure(strip_figure(folder, episode, panels, start_s, end_s), path)
    return path


def strip_figure(
    folder: Path, episode: int | None, panels: int, start_s: float | None, end_s: float | None
) -> Figure:
    """Return *panels* moments of an episode side by side.

    Args:
        folder: of a finished run or sweep.
        episode: its number; None for the worst.
        panels: number of moments, evenly spaced up to the last one.
        start_s: first moment; None for ``STRIP_S`` before the last.
        end_s: last moment; None for the contact, or 1 s after the least distance.

    Raises:
        FileError: the folder lacks the episode.
        ConfigError: there are too many panels, or none, or the span is not in the episode.
    """
    chosen = ChosenEpisode.read(folder, episode)
    start, end = chosen.span_s(start_s, end_s, STRIP_S)
    if not 1 <= panels <= _MOST_PANELS:
        raise ConfigError(f"panels={panels}: give a number from 1 to {_MOST_PANELS}")
    return draw_strip(chosen, np.linspace(start, end, max(panels, 2))[-panels:], start)


def draw_strip(chosen: ChosenEpisode, moments_s: FloatArray, start_s: float) -> Figure:
    """Return the strip as a figure of matplotlib."""
    width, height = _PANEL_IN * len(moments_s), _PANEL_IN + _LEGEND_IN
    fig = Figure(figsize=(width, height), dpi=130, facecolor="white")
    FigureCanvasAgg(fig)
    views = _views(chosen, moments_s.tolist(), start_s)
    for k, (moment, view) in enumerate(zip(moments_s.tolist(), views, strict=True)):
        gap = 0.02 / len(moments_s)
        left, share = k / len(moments_s) + gap / 2, 1.0 / len(moments_s) - gap
        axes = fig.add_axes((left, _LEGEND_IN / height, share, 1.0 - _LEGEND_IN / height))
        frame_axes(axes, view)
        axes.set_facecolor(GROUND)
        _draw_panel(axes, chosen, view, start_s, moment)
    _draw_legend(fig, chosen)
    return fig


def _views(chosen: ChosenEpisode, moments_s: list[float], start_s: float) -> list[NetWindow]:
    """Return the view of each panel, all at the same scale."""
    common_view = chosen.view(start_s, moments_s[-1], aspect=1.0)
    if common_view.width_m <= _WIDEST_COMMON_VIEW_M:
        return [common_view] * len(moments_s)
    width_m = max(chosen.view_at(moment).width_m for moment in moments_s)
    return [chosen.view_at(moment, width_m) for moment in moments_s]


def _draw_panel(axes: Axes, chosen: ChosenEpisode, view: NetWindow, start_s: float, moment_s: float) -> None:
    tracks, target, attacker = chosen.states.tracks, chosen.states.target, chosen.attacker
    if chosen.layer is not None:
        draw_streets(axes, chosen.layer.streets(view, tolerance_m=0.05), 72.0 * _PANEL_IN / view.width_m)
    if chosen.natural is not None:
        for line in chosen.natural.xy_m:
            axes.plot(*line.T, color="#9aa3aa", linewidth=3.0, zorder=3, solid_capstyle="round")
            axes.plot(*line.T, color=_PALE, linewidth=2.0, zorder=3.1, solid_capstyle="round")
    for row, role in ((attacker, Role.ATTACKER), (target, Role.TARGET)):
        if row is not None:
            _draw_circles(axes, chosen, row, COLOURS[role], start_s, moment_s)
    xy, yaw = poses_at(tracks, moment_s)
    present_rows = np.flatnonzero(np.isfinite(xy).all(axis=1))
    for row in [r for r in present_rows.tolist() if r not in (target, attacker)] + [attacker, target]:
        if row is None or row not in present_rows:
            continue
        role = Role.TARGET if row == target else Role.ATTACKER if row == attacker else Role.OTHER
        outline = corners(xy[row], yaw[row], tracks.size_m[row])
        box = PolyCollection(
            [outline], facecolors=COLOURS[role], edgecolors="white", linewidths=0.8, zorder=5
        )
        axes.add_collection(box)
    if chosen.contact_s is not None and moment_s >= chosen.contact_s - 1e-6 and chosen.impact_m is not None:
        axes.plot(*chosen.impact_m, marker="x", color=IMPACT, markersize=11, markeredgewidth=2.6, zorder=8)
    label = axes.text(
        0.03, 0.97, f"{moment_s:.1f} s", transform=axes.transAxes, va="top", fontsize=10, zorder=9
    )
    label.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 2.0})


def _draw_circles(
    axes: Axes, chosen: ChosenEpisode, row: int, colour: str, start_s: float, moment_s: float
) -> None:
    """Draw an agent's positions every ``CIRCLES_S`` as linked circles, older ones paler."""
    times = np.arange(start_s, moment_s + 1e-6, CIRCLES_S)
    path = np.stack([poses_at(chosen.states.tracks, float(t))[0][row] for t in times])
    axes.plot(*path.T, color=colour, linewidth=1.2, alpha=0.8, zorder=4)
    for k, point in enumerate(path):
        opacity = 0.35 + 0.65 * (k + 1) / len(path)
        axes.plot(*point, "o", color=colour, alpha=opacity, markersize=4.2, mec="white", mew=0.5, zorder=4.5)


def _draw_legend(fig: Figure, chosen: ChosenEpisode) -> None:
    has_collided = chosen.contact_s is not None
    names = {
        Role.TARGET: "target",
        Role.ATTACKER: "collision partner" if chosen.row["collision_partner"] else "nearest vehicle",
        Role.OTHER: "others",
    }
    handles = [
        Line2D([], [], color=COLOURS[role], marker="s", markersize=7, linestyle="", label=name)
        for role, name in names.items()
    ]
    handles.append(
        Line2D([], [], color="#5a646c", marker="o", markersize=4, label=f"driven, every {CIRCLES_S:g} s")
    )
    if chosen.natural is not None:
        handles.append(Line2D([], [], color="#b8c0c6", linewidth=3, label="without attack"))
    if has_collided:
        handles.append(
            Line2D([], [], color=IMPACT, marker="x", linestyle="", markeredgewidth=2.4, label="contact")
        )
    fig.legend(
        handles=handles, loc="lower center", ncols=len(handles), fontsize=9, frameon=False, borderpad=0.2
    )
