"""Read Argoverse 2 vector maps (Wilson et al. 2021, arXiv:2301.00493): ``log_map_archive_*.json``.

Coordinates are those of the city in m, x east, y north. Boundaries run in driving direction.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.geometry import MultiPolygon, Polygon

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import MapError
from advdiff_sumo.maps.convert.projection import ARGOVERSE_CITIES, argoverse_projection
from advdiff_sumo.maps.convert.sources.bounded_lanes import (
    BoundedLane,
    as_multi,
    lane_links,
    largest_part,
    midline_by_length,
    on_earth,
    source_lanes,
)
from advdiff_sumo.maps.convert.sources.map_faults import MapFaults
from advdiff_sumo.maps.convert.sources.source_map import LaneUse, SourceMap, StatedSizes

USES = {"VEHICLE": LaneUse.CAR, "BUS": LaneUse.BUS, "BIKE": LaneUse.BICYCLE}
LAYERS = ("lane_segments", "pedestrian_crossings", "drivable_areas")
CITY = re.compile(rf"_({'|'.join(ARGOVERSE_CITIES)})_city_")
REMEDY = "give an unchanged log_map_archive_*.json"
Row = Mapping[str, Any]


def argoverse2_map(data: object, path: Path) -> SourceMap:
    """Return the map in *data*, the JSON of *path*.

    Lanes with ``is_intersection`` are connectors. The centre line runs midway between the boundaries, as in the
    official API. Lane marks with DASHED in their name may be crossed.

    Raises:
        MapError: a layer is missing or malformed, or no lane is usable.
    """
    layers = _layers(data, path)
    faults = MapFaults(path)
    rows = [
        row for key, value in layers["lane_segments"].items() if (row := _bounded_lane(key, value, faults))
    ]
    lanes = source_lanes(rows, faults)
    if not lanes:
        raise MapError(path, "holds no usable lane in 'lane_segments'", REMEDY)
    known = {lane.token for lane in lanes}
    links, stated = lane_links(rows, lanes, faults)
    return SourceMap(
        path=path,
        location=path.name.removesuffix(".json"),
        lanes=tuple(lanes),
        links=tuple(links),
        drivable=_drivable(layers["drivable_areas"], faults),
        crossings=tuple(_crossings(layers["pedestrian_crossings"], faults)),
        stated=StatedSizes(len(layers["lane_segments"]), stated),
        left_out=tuple(str(key) for key in layers["lane_segments"] if str(key) not in known),
        notes=faults.notes,
        warnings=faults.sentences(),
        projection=_projection(path.name),
    )


def _projection(name: str) -> str | None:
    """Return the projection of the city that a file's *name* holds (sensor and lidar data sets), else None."""
    city = CITY.search(name)
    return argoverse_projection(city[1]) if city else None


def _layers(data: object, path: Path) -> dict[str, dict[str, Any]]:
    """Return the layers of a map; raise a MapError if one is missing or there is no lane."""
    if not isinstance(data, dict):
        raise MapError(path, "is JSON of another format, not an Argoverse 2 map", REMEDY)
    for layer in LAYERS:
        if not isinstance(data.get(layer), dict):
            raise MapError(path, f"layer '{layer}' is missing or malformed", REMEDY)
    if not data["lane_segments"]:
        raise MapError(path, "holds no lane ('lane_segments' is empty)", "give a map that is not empty")
    return {layer: data[layer] for layer in LAYERS}


def _bounded_lane(key: str, row: object, faults: MapFaults) -> BoundedLane | None:
    """Return the lane of a record; None, with a note in *faults*, if the record is malformed."""
    try:
        if not isinstance(row, dict):
            raise TypeError("it is no record")
        left, right = _points_3d(row["left_lane_boundary"]), _points_3d(row["right_lane_boundary"])
        return BoundedLane(
            token=str(key),
            left_m=left[:, :2],
            right_m=right[:, :2],
            centre_m=midline_by_length(left, right) if min(len(left), len(right)) > 1 else None,
            is_connector=bool(row["is_intersection"]),
            use=USES.get(str(row.get("lane_type")), LaneUse.CAR),
            successors=tuple(map(str, row["successors"])),
            predecessors=tuple(map(str, row["predecessors"])),
            left_neighbour=_text(row.get("left_neighbor_id")),
            left_dashed=_dashed(row.get("left_lane_mark_type")),
            right_dashed=_dashed(row.get("right_lane_mark_type")),
        )
    except (KeyError, TypeError, ValueError) as error:
        reason = f"'{error.args[0]}' is missing" if isinstance(error, KeyError) else str(error)
        faults.add("lane malformed", f"lane {key!r} is left out: {reason}")
        return None


def _text(value: object) -> str | None:
    return None if value is None else str(value)


def _dashed(mark: object) -> bool | None:
    """Return whether a lane mark may be crossed; None if there is no mark."""
    return None if mark in (None, "NONE", "UNKNOWN") else "DASHED" in str(mark)


def _points(rows: Sequence[Row]) -> FloatArray:
    points = np.array([[float(row["x"]), float(row["y"])] for row in rows], dtype=np.float64)
    return on_earth(points.reshape(-1, 2))


def _points_3d(rows: Sequence[Row]) -> FloatArray:
    """Return points (N, 3) with heights, as the official API measures lengths of boundaries in 3D."""
    heights = [float(row.get("z", 0.0)) for row in rows]
    return on_earth(np.column_stack((_points(rows), heights)))


def _drivable(rows: Mapping[str, Any], faults: MapFaults) -> MultiPolygon:
    areas = [_area(rows[key], key, faults, "area_boundary") for key in rows]
    return as_multi(shapely.union_all([area for area in areas if area is not None]))


def _crossings(rows: Mapping[str, Any], faults: MapFaults) -> list[Polygon]:
    areas = [_area(rows[key], key, faults, "edge1", "edge2") for key in rows]
    return [area for area in areas if area is not None]


def _area(row: Any, key: str, faults: MapFaults, *sides: str) -> Polygon | None:
    """Return the polygon with one side as its ring, or the polygon between two sides; None if it is unusable."""
    try:
        first, *others = (_points(row[side]) for side in sides)
    except (KeyError, TypeError, ValueError):
        area = None
    else:
        area = largest_part(np.vstack((first, *(line[::-1] for line in others))))
    if area is None:
        faults.add("area unusable", f"the area {key!r} ({sides[0]}) is unusable and left out")
    return area
