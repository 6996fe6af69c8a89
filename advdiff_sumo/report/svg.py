"""Converts pictures to SVG path data: whole centimetres, y down, relative to the picture's upper left corner."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.report.layer import NetWindow
from advdiff_sumo.report.scene_picture import Box, Picture

_CM = 100.0


@dataclass(frozen=True)
class SvgBox:
    """One box: role as class name, whether it is of an earlier moment, opacity, path of outline and heading line."""

    role: str
    past: bool
    opacity: str
    path: str


@dataclass(frozen=True)
class SvgLabel:
    """The time beside a box, in the picture's units."""

    role: str
    x: int
    y: int
    text: str


@dataclass(frozen=True)
class SvgPicture:
    """The picture for the template; all lengths in centimetres.

    Attributes:
        view_box: of the whole picture.
        close_up: view box of the close-up, "" without one.
        area: drivable area, "" without a map.
        solid: lines between directions.
        dashed: lines between lanes.
        trails: (role, path data).
        boxes: from the oldest to the newest.
        labels: times.
        impact: (x, y) of the target's impact, or None.
        other_impacts: (x, y) of impacts between background vehicles.
        size: width of the whole picture.
        close_size: width of the close-up.
    """

    view_box: str
    close_up: str
    area: str
    solid: str
    dashed: str
    trails: tuple[tuple[str, str], ...]
    boxes: tuple[SvgBox, ...]
    labels: tuple[SvgLabel, ...]
    impact: tuple[int, int] | None
    other_impacts: tuple[tuple[int, int], ...]
    size: int
    close_size: int


def svg_picture(picture: Picture) -> SvgPicture:
    """Return *picture* as path data."""
    view, close, streets = picture.view, picture.close_up, picture.streets
    offset = 0.5 + 0.017 * view.width_m
    return SvgPicture(
        view_box=view_box(view, view),
        close_up="" if close is None else view_box(close, view),
        area="" if streets is None else lines_data(streets.areas, view, closed=True),
        solid="" if streets is None else lines_data(streets.solid, view),
        dashed="" if streets is None else lines_data(streets.dashed, view),
        trails=tuple((str(t.role), line_data(t.xy_m, view)) for t in picture.trails),
        boxes=tuple(_box(box, view) for box in picture.boxes),
        labels=tuple(_label(box, view, offset) for box in picture.boxes if box.label),
        impact=None if picture.impact_m is None else point(picture.impact_m, view),
        other_impacts=tuple(point(p, view) for p in picture.other_impacts_m),
        size=round(view.width_m * _CM),
        close_size=0 if close is None else round(close.width_m * _CM),
    )


def view_box(part: NetWindow, whole: NetWindow) -> str:
    """Return the viewBox that shows *part* in the units of *whole*."""
    x, y = point(np.array([part.x0_m, part.y1_m]), whole)
    return f"{x} {y} {round(part.width_m * _CM)} {round(part.height_m * _CM)}"


def point(xy_m: FloatArray, view: NetWindow) -> tuple[int, int]:
    """Return one point (2,) of the net in the units of *view*."""
    return round((float(xy_m[0]) - view.x0_m) * _CM), round((view.y1_m - float(xy_m[1])) * _CM)


def line_data(xy_m: FloatArray, view: NetWindow, *, closed: bool = False) -> str:
    """Return path data of one line (K, 2); in a *closed* ring ``z`` replaces the repeated last point."""
    centimetres = np.rint((xy_m - (view.x0_m, view.y1_m)) * (_CM, -_CM)).astype(np.int64)
    steps = np.diff(centimetres, axis=0)
    steps = steps[np.any(steps != 0, axis=1)]
    steps = steps[:-1] if closed else steps
    start = f"M{centimetres[0, 0]} {centimetres[0, 1]}"
    moves = "l" + " ".join(f"{x} {y}" for x, y in steps) if len(steps) else ""
    return start + moves.replace(" -", "-") + ("z" if closed else "")


def lines_data(lines: Iterable[FloatArray], view: NetWindow, *, closed: bool = False) -> str:
    """Return path data of many lines."""
    return "".join(line_data(line, view, closed=closed) for line in lines)


def _box(box: Box, view: NetWindow) -> SvgBox:
    """Return a box with a line from its middle to the middle of its front."""
    outline = line_data(np.concatenate((box.corners_m, box.corners_m[:1])), view, closed=True)
    nose = line_data(np.stack((box.centre_m, 0.5 * (box.corners_m[0] + box.corners_m[1]))), view)
    return SvgBox(str(box.role), box.age > 0.0, f"{1.0 - 0.6 * box.age:.2f}", outline + nose)


def _label(box: Box, view: NetWindow, offset_m: float) -> SvgLabel:
    """Return the time beside a box."""
    x, y = point(box.centre_m + offset_m * box.label_side, view)
    return SvgLabel(str(box.role), x, y, box.label)
