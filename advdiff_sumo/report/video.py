"""Makes films of an episode: MP4 by ffmpeg, GIF by Pillow; the same run gives the same bytes."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.boxes import corners
from advdiff_sumo.core.errors import FileError, MissingExtraError
from advdiff_sumo.core.whole_file import whole_file
from advdiff_sumo.report.drawing import (
    COLOURS,
    GROUND,
    IMPACT,
    check_ending,
    draw_streets,
    frame_axes,
    unwritable,
)
from advdiff_sumo.report.scene_picture import Role
from advdiff_sumo.report.selection import ChosenEpisode, poses_at
from advdiff_sumo.report.templates import words

#: Frames per second of film.
FRAMES_PER_S = {".mp4": 25, ".gif": 10}
#: Longest span of the episode without a requested start.
FILM_S = 30.0
_LAST_FRAME_S = 1.0
_TRAIL_S = 2.0
_WIDTH_PX, _ASPECT, _DPI = 960, 1.5, 100
_GIF_COLOURS = 64


def video(
    folder: Path,
    episode: int | None,
    path: Path,
    speed: float = 1.0,
    start_s: float | None = None,
    end_s: float | None = None,
) -> Path:
    """Film an episode to *path* (.mp4 or .gif) and return *path*.

    Args:
        folder: of a finished run or sweep.
        episode: its number; None for the worst.
        path: the file to write.
        speed: seconds of the episode per second of film.
        start_s: first moment; None for ``FILM_S`` before the last.
        end_s: last moment; None for the end.

    Raises:
        FileError: the folder lacks the episode, the ending is another, or *path* cannot be written.
        ConfigError: the span is not in the episode.
        MissingExtraError: MP4 without the extra ``video``.
    """
    kind = check_ending(path, tuple(FRAMES_PER_S))
    ffmpeg = _ffmpeg() if kind == ".mp4" else None
    chosen = ChosenEpisode.read(folder, episode)
    last_s = float(chosen.states.tracks.times_s[-1])
    start, end = chosen.span_s(start_s, end_s if end_s is not None else last_s, FILM_S)
    rate = FRAMES_PER_S[kind]
    moments = np.append(np.arange(start, end - 1e-6, speed / rate), np.full(round(_LAST_FRAME_S * rate), end))
    if not path.parent.is_dir():
        raise FileError(path, "cannot be written (its folder is not there)", "choose another place")
    try:
        with whole_file(path, kind) as temporary:
            frames = _frames(chosen, moments, start, end)
            if ffmpeg is None:
                _write_gif(frames, temporary, rate)
            else:
                _write_mp4(frames, temporary, rate, ffmpeg)
    except OSError as error:
        raise unwritable(path, error) from None
    return path


def _ffmpeg() -> Any:
    try:
        return import_module("imageio_ffmpeg")  # late: an extra, without type information
    except ImportError:
        raise MissingExtraError("an MP4 film", "video") from None


def _frames(
    chosen: ChosenEpisode, moments_s: FloatArray, start_s: float, end_s: float
) -> Iterator[NDArray[np.uint8]]:
    """Yield frames (H, W, 3), H and W even; the streets are drawn only once."""
    view = chosen.view(start_s, end_s, _ASPECT)
    fig = Figure(figsize=(_WIDTH_PX / _DPI, _WIDTH_PX / _ASPECT / _DPI), dpi=_DPI, facecolor=GROUND)
    canvas: Any = FigureCanvasAgg(fig)  # matplotlib leaves these methods untyped
    axes = fig.add_axes((0.0, 0.0, 1.0, 1.0))
    frame_axes(axes, view)
    axes.set_axis_off()
    if chosen.layer is not None:
        points_per_m = 72.0 * _WIDTH_PX / _DPI / view.width_m
        draw_streets(axes, chosen.layer.streets(view, tolerance_m=0.05), points_per_m)
    canvas.draw()
    streets = canvas.copy_from_bbox(fig.bbox)
    for moment in moments_s.tolist():
        canvas.restore_region(streets)
        for artist in _artists(axes, chosen, moment):
            axes.draw_artist(artist)
            artist.remove()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _artists(axes: Axes, chosen: ChosenEpisode, moment_s: float) -> list[Any]:
    """Return the artists of one frame: natural paths, trails, boxes, the contact and text."""
    tracks, target, attacker = chosen.states.tracks, chosen.states.target, chosen.attacker
    artists: list[Any] = []
    if chosen.natural is not None:
        artists += [
            axes.plot(*line.T, color="white", linewidth=2.5, alpha=0.7)[0] for line in chosen.natural.xy_m
        ]
    past = chosen.steps(max(0.0, moment_s - _TRAIL_S), moment_s)
    xy, yaw = poses_at(tracks, moment_s)
    present_rows = np.flatnonzero(np.isfinite(xy).all(axis=1)).tolist()
    for role, rows in (
        (Role.OTHER, [row for row in present_rows if row not in (target, attacker)]),
        (Role.ATTACKER, [row for row in present_rows if row == attacker]),
        (Role.TARGET, [row for row in present_rows if row == target]),
    ):
        for row in rows:
            path = np.concatenate((tracks.xy_m[row, past], xy[row][None]))
            artists.append(axes.plot(*path.T, color=COLOURS[role], linewidth=2.0, alpha=0.6)[0])
        outlines = [corners(xy[row], yaw[row], tracks.size_m[row]) for row in rows]
        noses = [
            np.stack((xy[row], outline[:2].mean(axis=0))) for row, outline in zip(rows, outlines, strict=True)
        ]
        boxes = PolyCollection(outlines, facecolors=COLOURS[role], edgecolors="white", linewidths=1.0)
        artists.append(axes.add_collection(boxes))
        artists += [axes.plot(*nose.T, color="white", linewidth=1.2)[0] for nose in noses]
    return artists + _text_artists(axes, chosen, moment_s)


def _text_artists(axes: Axes, chosen: ChosenEpisode, moment_s: float) -> list[Any]:
    tracks, row = chosen.states.tracks, chosen.row
    step = min(round(moment_s / tracks.dt_s), tracks.steps - 1)
    speed = tracks.speed_mps[chosen.states.target, step]
    clock = f"{moment_s:5.1f} s" + (f"   target {speed:.1f} m/s" if np.isfinite(speed) else "")
    text_box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 4.0}
    artists: list[Any] = [
        axes.text(0.015, 0.975, clock, transform=axes.transAxes, va="top", fontsize=13, bbox=text_box)
    ]
    if chosen.contact_s is not None and moment_s >= chosen.contact_s - 1e-6:
        verdict = f"{words(row['collision_type'])}, at fault: {words(row['at_fault'])}"
        artists.append(
            axes.text(
                0.015, 0.03, verdict, transform=axes.transAxes, fontsize=13, color=IMPACT, bbox=text_box
            )
        )
        if chosen.impact_m is not None:
            cross = axes.plot(*chosen.impact_m, marker="x", color=IMPACT, markersize=14, markeredgewidth=3.5)
            artists += cross
    return artists


def _write_gif(frames: Iterator[NDArray[np.uint8]], path: Path, rate: int) -> None:
    """Write a GIF in which all frames use the palette of the last one, which contains all colours."""
    pictures = [Image.fromarray(frame) for frame in frames]
    palette = pictures[-1].quantize(_GIF_COLOURS, method=Image.Quantize.MEDIANCUT)
    indexed = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    duration = round(1000 / rate)
    indexed[0].save(path, save_all=True, append_images=indexed[1:], duration=duration, loop=0, optimize=False)


def _write_mp4(frames: Iterator[NDArray[np.uint8]], path: Path, rate: int, ffmpeg: Any) -> None:
    """Write H.264 that any browser plays; one thread and no dates give the same bytes every time."""
    reproducible = ["-threads", "1", "-fflags", "+bitexact", "-flags:v", "+bitexact", "-map_metadata", "-1"]
    first = next(frames)
    size = (first.shape[1], first.shape[0])
    params = [*reproducible, "-crf", "21"]
    sink = ffmpeg.write_frames(
        str(path), size, fps=rate, codec="libx264", macro_block_size=2, quality=None, output_params=params
    )
    sink.send(None)
    try:
        sink.send(first.tobytes())
        for frame in frames:
            sink.send(frame.tobytes())
    finally:
        sink.close()
