"""Read the map of a ScenarioNet record (nuScenes, Waymo, …)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.geometry import Polygon

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import MapError
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert.sources.arcline import drop_repeats
from advdiff_sumo.maps.convert.sources.bounded_lanes import as_multi, largest_valid
from advdiff_sumo.maps.convert.sources.source_map import LaneUse, SourceLane, SourceMap, StatedSizes

KMH_MPS = 1.0 / 3.6
MPH_MPS = 0.44704
DEFAULT_WIDTH_M = 3.5
LANE_TYPES = {
    "LANE_SURFACE_STREET": LaneUse.CAR,
    "LANE_SURFACE_UNSTRUCTURE": LaneUse.CAR,
    "LANE_FREEWAY": LaneUse.CAR,
    "LANE_UNKNOWN": LaneUse.CAR,
    "LANE_BIKE_LANE": LaneUse.BICYCLE,
    "LANE_BUS_LANE": LaneUse.BUS,
}
MOVED = ", moved"  # appended to a location whose frame is not that of the place
CONNECTOR_TYPES = frozenset({"LANE_SURFACE_UNSTRUCTURE"})


def read_record_map(
    record: object, path: Path, offset_m: tuple[float, float] | None = (0.0, 0.0)
) -> SourceMap:
    """Return the map of a ScenarioNet record that was loaded from *path*.

    Lanes of type LANE_SURFACE_UNSTRUCTURE are connectors (ScenarioNet writes those of nuScenes so). The drivable
    area is the area of the lanes. Links come from ``entry_lanes`` and ``exit_lanes``.

    Args:
        record: the loaded record.
        path: its file.
        offset_m: vector to add to its points to get coordinates in the frame of the place. None if it is unknown:
            then the map is not moved and has no position on the globe.

    Raises:
        MapError: *record* is no ScenarioNet record, or its map has no usable lane.
    """
    features = record.get("map_features") if isinstance(record, Mapping) else None
    if not isinstance(record, Mapping) or not isinstance(features, Mapping):
        raise MapError(
            path, "is no ScenarioNet record ('map_features' is missing)", "give a record's .pkl file"
        )
    notes: Counter[str] = Counter()
    shift = np.array(offset_m or (0.0, 0.0))
    rows = {str(name): row for name, row in features.items() if _is_lane(row)}
    lanes = [
        lane for name, row in rows.items() if (lane := _source_lane(name, row, shift, notes)) is not None
    ]
    if not lanes:
        raise MapError(path, "holds no lane with a centre line", "give a record with a map")
    known = {lane.token for lane in lanes}
    areas = [_area(lane) for lane in lanes]
    links, stated = _links(rows, known, notes)
    return SourceMap(
        path=path,
        location=_location(record, path) + (MOVED if offset_m is None else ""),
        lanes=tuple(lanes),
        links=tuple(links),
        drivable=as_multi(shapely.union_all(areas)),
        crossings=tuple(_polygons(features, "CROSSWALK", shift)),
        walkways=tuple(_polygons(features, "SIDEWALK", shift)),
        stated=StatedSizes(len(rows), stated),
        left_out=tuple(name for name in rows if name not in known),
        notes=notes,
    )


def _is_lane(row: object) -> bool:
    return isinstance(row, Mapping) and str(row.get("type")) in LANE_TYPES


def _location(record: Mapping[str, Any], path: Path) -> str:
    metadata = record.get("metadata")
    place = metadata.get("map") if isinstance(metadata, Mapping) else None
    return str(place) if place else path.stem


def _source_lane(
    name: str, row: Mapping[str, Any], shift: FloatArray, notes: Counter[str]
) -> SourceLane | None:
    centre = _points(row.get("polyline"), shift)
    if centre is None:
        notes["lane without usable centre line"] += 1
        return None
    return SourceLane(
        token=name,
        is_connector=str(row["type"]) in CONNECTOR_TYPES,
        centre_m=centre,
        polygon=_polygon(row.get("polygon"), shift),
        use=LANE_TYPES[str(row["type"])],
        speed_mps=_speed(row),
        width_m=_width(row.get("width")),
    )


def _points(value: Any, shift: FloatArray) -> FloatArray | None:
    """Return the points (N, 2) of a line, moved by *shift*; None if one is not finite or the line has no length."""
    try:
        line = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    if line.ndim != 2 or len(line) < 2 or line.shape[1] < 2 or not np.isfinite(line[:, :2]).all():
        return None
    line = drop_repeats(line[:, :2] + shift)
    return line if len(line) > 1 and line_length_m(line) > 0.01 else None


def _polygon(value: Any, shift: FloatArray) -> Polygon | None:
    ring = _points(value, shift)
    return None if ring is None or len(ring) < 3 else largest_valid(Polygon(ring))


def _speed(row: Mapping[str, Any]) -> float | None:
    """Return the speed limit in m/s; None if there is none or it is not positive."""
    for key, factor in (("speed_limit_kmh", KMH_MPS), ("speed_limit_mph", MPH_MPS)):
        value = row.get(key)
        if isinstance(value, int | float) and np.isfinite(value) and value > 0:
            return float(value) * factor
    return None


def _width(value: Any) -> float | None:
    """Return the median of the stated widths in m; widths left and right of the centre line are added."""
    if value is None:
        return None
    widths = np.asarray(value, dtype=np.float64)
    total = widths.sum(axis=1) if widths.ndim == 2 and widths.shape[1] == 2 else widths.ravel()
    plausible = total[np.isfinite(total) & (total > 1.0) & (total < 12.0)]
    return float(np.median(plausible)) if len(plausible) else None


def _area(lane: SourceLane) -> shapely.Geometry:
    if lane.polygon is not None:
        return lane.polygon
    return shapely.LineString(lane.centre_m).buffer(0.5 * (lane.width_m or DEFAULT_WIDTH_M), cap_style="flat")


def _links(
    rows: Mapping[str, Mapping[str, Any]], known: set[str], notes: Counter[str]
) -> tuple[list[tuple[str, str]], int]:
    """Return each usable link once (either lane may state it), and the number stated between lanes of the record."""
    stated: dict[tuple[str, str], None] = {}
    for name, row in rows.items():
        pairs = [(str(other), name) for other in row.get("entry_lanes") or []]
        pairs += [(name, str(other)) for other in row.get("exit_lanes") or []]
        stated.update(dict.fromkeys(pairs))
        if unknown := sum(not known.issuperset(pair) for pair in pairs):
            notes["link to unknown lane"] += unknown
    inside = [pair for pair in stated if rows.keys() >= set(pair)]
    return [pair for pair in inside if known.issuperset(pair)], len(inside)


def _polygons(features: Mapping[str, Any], kind: str, shift: FloatArray) -> list[Polygon]:
    rows = [row for row in features.values() if isinstance(row, Mapping) and row.get("type") == kind]
    polygons = [_polygon(row.get("polygon"), shift) for row in rows]
    return [polygon for polygon in polygons if polygon is not None]
