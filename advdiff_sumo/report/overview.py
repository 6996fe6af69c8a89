"""Makes the map at the top of the report: the net, the targets' paths and their collisions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.report.layer import MapLayer, NetWindow
from advdiff_sumo.report.svg import line_data, lines_data, point, view_box

_TRAIL_TOLERANCE = 1e-3  # of the map's width


@dataclass(frozen=True)
class FailurePlace:
    """Where the target collided or left the road.

    Attributes:
        episode: its number.
        x: position in the picture.
        y: position in the picture.
        at_fault: target, other or unclear.
        text: type of the collision.
    """

    episode: int
    x: int
    y: int
    at_fault: str
    text: str


@dataclass(frozen=True)
class Overview:
    """The map for the template, in centimetres.

    Attributes:
        name: of the net.
        view_box: of the whole map.
        area: path data of the drivable area, "" without a net.
        trails: path data of the targets' paths.
        places: of their collisions.
        size: width.
        aspect: width / height.
    """

    name: str
    view_box: str
    area: str
    trails: tuple[str, ...]
    places: tuple[FailurePlace, ...]
    size: int
    aspect: float


def overview_of(
    name: str, layer: MapLayer | None, target_trails: Sequence[FloatArray], rows: Iterable[Mapping[str, Any]]
) -> Overview:
    """Return the overview.

    Args:
        name: of the net.
        layer: the net; None: the driven part is shown without streets.
        target_trails: (K, 2) paths of the targets.
        rows: rows of ``episodes.parquet``.
    """
    view = layer.view if layer is not None else _driven_view(target_trails)
    tolerance = _TRAIL_TOLERANCE * view.width_m
    streets = None if layer is None else layer.streets(view, tolerance_m=0.5 * tolerance, markings=False)
    trails = [xy[np.isfinite(xy).all(axis=1)] for xy in target_trails]
    simplified = [
        shapely.get_coordinates(shapely.simplify(shapely.LineString(xy), tolerance))
        for xy in trails
        if len(xy) > 1
    ]
    return Overview(
        name=name,
        view_box=view_box(view, view),
        area="" if streets is None else lines_data(streets.areas, view, closed=True),
        trails=tuple(line_data(xy, view) for xy in simplified),
        places=tuple(_place(row, view) for row in rows if _is_placed(row)),
        size=round(100.0 * view.width_m),
        aspect=view.width_m / view.height_m,
    )


def _driven_view(trails: Sequence[FloatArray]) -> NetWindow:
    return NetWindow.around(np.concatenate([np.zeros((0, 2)), *trails]), margin_m=20.0, least_width_m=100.0)


def _is_placed(row: Mapping[str, Any]) -> bool:
    return bool(row["target_collision"]) and row["impact_x_m"] is not None


def _place(row: Mapping[str, Any], view: NetWindow) -> FailurePlace:
    x, y = point(np.array([row["impact_x_m"], row["impact_y_m"]]), view)
    return FailurePlace(
        int(row["episode"]), x, y, str(row["at_fault"]), str(row["collision_type"]).replace("_", " ")
    )
