"""Prepares the picture of an episode, in the net's metres; other modules draw it as SVG or by matplotlib."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import shapely

from advdiff_sumo.core.arrays import FloatArray, stretches
from advdiff_sumo.core.boxes import corners
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.report.layer import MapLayer, NetWindow, VisibleStreets
from advdiff_sumo.report.select import attacker_of

#: Of longer episodes, only this duration before their end is drawn.
SHOWN_S = 60.0
#: Spacing of the boxes along the target's and the attacker's path.
BOX_SPACING_S = 1.0
_LABEL_SPACING_M = 9.0
#: The view includes the attacker where it is within this distance of the target.
ATTACKER_NEAR_M = 50.0
#: Target and attacker within this distance and with this lateral offset have their labels on opposite sides.
_LABELS_APART_WITHIN_M, _MIN_LATERAL_M = 12.0, 0.5
_CLOSE_UP_S = 3.0


class Role(StrEnum):
    """The role of a drawn road user."""

    TARGET = "target"
    ATTACKER = "attacker"
    OTHER = "other"


@dataclass(frozen=True)
class Trail:
    """The path of one agent: points (K, 2) in order of time."""

    role: Role
    xy_m: FloatArray


@dataclass(frozen=True)
class Box:
    """One agent at one moment.

    Attributes:
        role: of the agent.
        corners_m: (4, 2), the front ones first.
        age: 0 for the last moment of the picture, up to 1 for its first.
        label: seconds since the episode's start, "" without label.
        centre_m: (2,) centre.
        label_side: unit vector (2,) from the centre towards the label.
    """

    role: Role
    corners_m: FloatArray
    age: float
    label: str
    centre_m: FloatArray
    label_side: FloatArray


@dataclass(frozen=True)
class Picture:
    """One episode, ready to draw.

    Attributes:
        view: area of the picture.
        close_up: view of the last seconds before the contact; None without a collision.
        streets: in the view; None if the net is missing.
        trails: paths, the target's last.
        boxes: from the oldest to the newest, the target's last of each moment.
        impact_m: (2,) impact point of the target, or None.
        other_impacts_m: impact points of collisions between background vehicles.
        start_s: first moment that is drawn.
        end_s: last moment that is drawn.
        attacker: id of the vehicle in the attacker's colour, or None.
        partner: whether it is the target's collision partner; else it is the vehicle that came nearest.
    """

    view: NetWindow
    close_up: NetWindow | None
    streets: VisibleStreets | None
    trails: tuple[Trail, ...]
    boxes: tuple[Box, ...]
    impact_m: FloatArray | None
    other_impacts_m: tuple[FloatArray, ...]
    start_s: float
    end_s: float
    attacker: str | None
    partner: bool


def picture_of(
    states: EpisodeStates,
    row: Mapping[str, Any],
    collisions: Sequence[Mapping[str, Any]],
    layer: MapLayer | None,
    view: NetWindow | None = None,
    attacker: str | None = None,
) -> Picture:
    """Return the picture of one episode.

    Args:
        states: of the episode.
        row: its row of ``episodes.parquet``.
        collisions: its rows of ``collisions.parquet``.
        layer: the net; None: no streets are drawn.
        view: area of the picture; None: the target's path, and the attacker's near it.
        attacker: id of the vehicle in the attacker's colour; None: see :func:`attacker_of`.
    """
    full = states.tracks
    tracks = full.window(max(0, full.steps - 1 - round(SHOWN_S / full.dt_s)), full.steps)
    attacker = attacker or attacker_of(row)
    attacker_row = None if attacker is None else tracks.index.get(attacker)
    impact = impact_of(row) if row["target_collision"] else None
    focus = focus_points(tracks, states.target, attacker_row, impact)
    view = view or NetWindow.around(focus, margin_m=12.0, least_width_m=70.0)
    return Picture(
        view=view,
        close_up=None
        if impact is None
        else _close_up(tracks, states.target, attacker_row, impact, row["collision_time_s"]),
        streets=None if layer is None else layer.streets(view),
        trails=_trails(tracks, states.target, attacker_row, view),
        boxes=_boxes(tracks, states.target, attacker_row, view),
        impact_m=impact,
        other_impacts_m=_other_impacts(collisions),
        start_s=tracks.t0_s,
        end_s=full.t0_s + full.dt_s * (full.steps - 1),
        attacker=None if attacker_row is None else attacker,
        partner=attacker_row is not None and attacker == row["collision_partner"],
    )


def focus_of(states: EpisodeStates, attacker: str | None) -> FloatArray:
    """Return the points (N, 2) that a view of *states* must include: the target's path, the attacker's near it."""
    attacker_row = None if attacker is None else states.tracks.index.get(attacker)
    return focus_points(states.tracks, states.target, attacker_row, None)


def impact_of(row: Mapping[str, Any]) -> FloatArray | None:
    """Return the place (2,) of a collision of *row*, or None."""
    if row["impact_x_m"] is None or row["impact_y_m"] is None:
        return None
    return np.array([row["impact_x_m"], row["impact_y_m"]], dtype=np.float64)


def _other_impacts(collisions: Sequence[Mapping[str, Any]]) -> tuple[FloatArray, ...]:
    points = (impact_of(c) for c in collisions if not c["with_target"] and not c["initial"])
    return tuple(point for point in points if point is not None)


def focus_points(tracks: Tracks, target: int, attacker: int | None, impact: FloatArray | None) -> FloatArray:
    """Return the points (N, 2) that a view must include: the target's path, the attacker's near it, the impact."""
    points = [tracks.xy_m[target]]
    if attacker is not None:
        distance_m = np.linalg.norm(tracks.xy_m[attacker] - tracks.xy_m[target], axis=-1)
        points.append(tracks.xy_m[attacker][distance_m <= ATTACKER_NEAR_M])
    if impact is not None:
        points.append(impact[None])
    return np.concatenate(points)


def _close_up(
    tracks: Tracks, target: int, attacker: int | None, impact: FloatArray, contact_s: float
) -> NetWindow:
    # the first instant at or after the contact
    contact_step = int(np.ceil((contact_s - tracks.t0_s) / tracks.dt_s - 1e-6))
    stop = min(max(contact_step, 0) + 1, tracks.steps)
    last_seconds = tracks.window(max(0, stop - round(_CLOSE_UP_S / tracks.dt_s)), stop)
    focus = focus_points(last_seconds, target, attacker, impact)
    return NetWindow.around(focus, margin_m=4.0, least_width_m=30.0, most_width_m=60.0)


def _trails(tracks: Tracks, target: int, attacker: int | None, view: NetWindow) -> tuple[Trail, ...]:
    trails = []
    for row in _drawing_order(tracks, target, attacker):
        is_present = np.isfinite(tracks.xy_m[row]).all(axis=1)
        for line in (tracks.xy_m[row, a:b] for a, b in stretches(is_present) if b - a > 1):
            clipped = shapely.clip_by_rect(shapely.simplify(shapely.LineString(line), 0.05), *view.rectangle)
            pieces = [p for p in shapely.get_parts(clipped) if p.geom_type == "LineString" and not p.is_empty]
            trails += [Trail(_role(row, target, attacker), shapely.get_coordinates(p)) for p in pieces]
    return tuple(trails)


def _boxes(tracks: Tracks, target: int, attacker: int | None, view: NetWindow) -> tuple[Box, ...]:
    box_stride = max(1, round(BOX_SPACING_S / tracks.dt_s))
    first_step = round(tracks.t0_s / tracks.dt_s)
    last_step = tracks.steps - 1
    box_steps = [k for k in range(last_step) if (first_step + k) % box_stride == 0] + [last_step]
    labelled: dict[int, FloatArray] = {}
    boxes = []
    for k in box_steps:
        for row in _drawing_order(tracks, target, attacker):
            role = _role(row, target, attacker)
            if (
                tracks.valid[row, k]
                and (role is not Role.OTHER or k == last_step)
                and _inside(tracks.xy_m[row, k], view)
            ):
                text = _label(tracks, row, k, labelled) if role is not Role.OTHER else ""
                age = (last_step - k) / max(last_step, 1)
                outline = corners(tracks.xy_m[row, k], tracks.yaw_rad[row, k], tracks.size_m[row])
                side = _label_side(tracks, row, k, target, attacker)
                boxes.append(Box(role, outline, age, text, tracks.xy_m[row, k], side))
    return tuple(boxes)


def _label(tracks: Tracks, row: int, k: int, labelled: dict[int, FloatArray]) -> str:
    """Return the time of a box, "" if the agent's last labelled box is too near."""
    xy_m = tracks.xy_m[row, k]
    if row in labelled and np.linalg.norm(xy_m - labelled[row]) < _LABEL_SPACING_M:
        return ""
    labelled[row] = xy_m
    return f"{tracks.times_s[k]:.1f}".removesuffix(".0")


def _label_side(tracks: Tracks, row: int, k: int, target: int, attacker: int | None) -> FloatArray:
    """Return the direction (2,) from a box to its label.

    The labels of target and attacker that are near each other point away from each other. Otherwise labels are on the
    right, of vehicles in the target's direction on the left.
    """
    yaw = tracks.yaw_rad[row, k]
    right = np.array([np.sin(yaw), -np.cos(yaw)])
    opponent = attacker if row == target else target
    to_opponent = np.full(2, np.nan) if opponent is None else tracks.xy_m[opponent, k] - tracks.xy_m[row, k]
    if abs(to_opponent @ right) > _MIN_LATERAL_M and np.hypot(*to_opponent) < _LABELS_APART_WITHIN_M:
        return right if to_opponent @ right < 0.0 else -right
    same_direction = row != target and np.cos(yaw - tracks.yaw_rad[target, k]) > 0.0
    return right * (-1.0 if same_direction else 1.0)


def _inside(xy_m: FloatArray, view: NetWindow) -> bool:
    return bool(view.x0_m <= xy_m[0] <= view.x1_m and view.y0_m <= xy_m[1] <= view.y1_m)


def _drawing_order(tracks: Tracks, target: int, attacker: int | None) -> list[int]:
    on_top = [row for row in (attacker, target) if row is not None]
    return [row for row in range(tracks.agents) if row not in on_top] + on_top


def _role(row: int, target: int, attacker: int | None) -> Role:
    if row == target:
        return Role.TARGET
    return Role.ATTACKER if row == attacker else Role.OTHER
