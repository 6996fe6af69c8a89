"""Read the JSON files of the nuScenes map expansion (v1.3)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.geometry import LineString, MultiPolygon, Polygon

from advdiff_sumo.core.errors import MapError
from advdiff_sumo.core.map_files import load_json
from advdiff_sumo.maps.convert.sources.arcline import sample_path
from advdiff_sumo.maps.convert.sources.bounded_lanes import as_multi
from advdiff_sumo.maps.convert.sources.nuscenes_control import signals_of, stop_lines_of
from advdiff_sumo.maps.convert.sources.nuscenes_tables import MapTables, Row, finite
from advdiff_sumo.maps.convert.sources.source_map import LaneUse, SourceLane, SourceMap, StatedSizes

OLDEST = (1, 3)  # version
LANE_LAYERS = ("lane", "lane_connector")
SMALLEST_EXTENT_M = 1000.0  # smaller diagonals of a map count as this long
LONGEST_EXTENTS = 2.0  # longest possible lane, as a multiple of the diagonal of the map
NEEDED = ("polygon", "node", "lane", "lane_connector", "arcline_path_3", "connectivity")
USES = {"CAR": LaneUse.CAR, "BUS": LaneUse.BUS, "BIKE": LaneUse.BICYCLE, "BICYCLE": LaneUse.BICYCLE}


def read_nuscenes_map(path: Path) -> SourceMap:
    """Read a map expansion file; see :func:`nuscenes_map`."""
    return nuscenes_map(load_json(path, "give a file of maps/expansion"), path)


def nuscenes_map(data: object, path: Path) -> SourceMap:
    """Return the map in *data*, the JSON of *path*.

    Raises:
        MapError: the file is no map expansion or an older one, a needed layer is absent, or no lane is usable.
    """
    return _Reader(path, _checked_layers(path, data)).read()


def _checked_layers(path: Path, data: object) -> dict[str, Any]:
    """Return *data* if it is a map expansion with all needed layers; otherwise raise a MapError."""
    remedy = "download the map expansion v1.3 from nuscenes.org"
    if not isinstance(data, dict) or not ({"lane", "node", "polygon"} & set(data)):
        raise MapError(path, "is JSON of another format, not a nuScenes map expansion", remedy)
    if "arcline_path_3" not in data:
        raise MapError(path, "layer 'arcline_path_3' is missing (an expansion older than v1.2)", remedy)
    _check_version(path, data.get("version"), remedy)
    for layer in NEEDED:
        kind: type = dict if layer in ("arcline_path_3", "connectivity") else list
        if not isinstance(data.get(layer), kind):
            raise MapError(path, f"layer '{layer}' is missing or malformed", remedy)
    if not data["lane"] and not data["lane_connector"]:
        raise MapError(path, "holds no lane", "give the map of a city, not an empty one")
    if not data["arcline_path_3"]:
        raise MapError(path, "layer 'arcline_path_3' is empty, so no lane has a centre line", remedy)
    return data


def _check_version(path: Path, version: object, remedy: str) -> None:
    """Raise a MapError if the expansion is older than v1.3 (v1.10 is newer)."""
    if version is None:
        raise MapError(path, "states no version ('version' is missing)", remedy)
    try:
        numbers = tuple(int(part) for part in str(version).split("."))
    except ValueError:
        raise MapError(path, f"states version {version!r}, which is no version number", remedy) from None
    if numbers < OLDEST:
        raise MapError(path, f"is map expansion v{version}, older than v1.3", remedy)


class _Reader(MapTables):
    """Turns the tables into a SourceMap; unusable items are left out and counted."""

    def __init__(self, path: Path, data: dict[str, Any]) -> None:
        super().__init__(path, data)
        self.longest_m = self._longest_m()

    def read(self) -> SourceMap:
        lanes = self._lanes("lane", False) + self._lanes("lane_connector", True)
        if not lanes:
            raise MapError(self.path, "no lane has a usable centre line", "see arcline_path_3 of the file")
        known = {lane.token for lane in lanes}
        links, stated_links = self._links(known)
        return SourceMap(
            path=self.path,
            location=self.path.stem,
            lanes=tuple(lanes),
            links=tuple(links),
            drivable=self._drivable(),
            intersections=tuple(self._areas("road_segment", lambda row: bool(row.get("is_intersection")))),
            crossings=tuple(self._areas("ped_crossing")),
            walkways=tuple(self._areas("walkway")),
            carparks=tuple(self._areas("carpark_area")),
            stop_lines=tuple(stop_lines_of(self)),
            signals=tuple(signals_of(self)),
            dashed_dividers=tuple(self._dashed_lines()),
            stated=StatedSizes(sum(len(self.rows(layer)) for layer in LANE_LAYERS), stated_links),
            left_out=self._left_out(known),
            notes=self.notes,
            warnings=tuple(self.warnings),
        )

    def _left_out(self, known: set[str]) -> tuple[str, ...]:
        tokens = [row.get("token") for layer in LANE_LAYERS for row in self.rows(layer)]
        return tuple(dict.fromkeys(str(token) for token in tokens if str(token) not in known))

    def _longest_m(self) -> float:
        """Return the length in m that no lane exceeds, from the extent of the nodes and that of the canvas."""
        nodes = np.array(list(self.nodes.values())) if self.nodes else np.zeros((1, 2))
        extent = float(np.hypot(*np.ptp(nodes, axis=0)))
        canvas = self.data.get("canvas_edge")
        if isinstance(canvas, list) and canvas and finite(*canvas) and min(canvas) > 0:
            extent = min(extent, math.hypot(*canvas))
        return max(SMALLEST_EXTENT_M, extent) * LONGEST_EXTENTS

    def _lanes(self, layer: str, is_connector: bool) -> list[SourceLane]:
        lanes: dict[str, SourceLane] = {}
        for row in self.rows(layer):
            token = row.get("token")
            if token is None or str(token) in lanes:
                self.warn(
                    f"{layer} token unusable", f"{layer} token {token!r} is null or occurs twice; left out"
                )
                continue
            lane = self._lane(str(token), row, is_connector)
            if lane is not None:
                lanes[lane.token] = lane
        return list(lanes.values())

    def _lane(self, token: str, row: Row, is_connector: bool) -> SourceLane | None:
        pieces = self.data["arcline_path_3"].get(token)
        if not pieces:
            self.warn("lane without arc line", f"lane {token!r} has no arc line and is left out")
            return None
        try:
            centre = sample_path(_records_only(pieces), longest_m=self.longest_m, notes=self.notes)
        except ValueError as error:
            self.warn("lane with unusable arc line", f"lane {token!r} is left out: {error}")
            return None
        if len(centre) < 2:
            self.warn("lane without length", f"lane {token!r} has no length and is left out")
            return None
        return SourceLane(
            token=token,
            is_connector=is_connector,
            centre_m=centre,
            polygon=self.polygon(row["polygon_token"]) if row.get("polygon_token") else None,
            use=USES.get(str(row.get("lane_type", "CAR")).upper(), LaneUse.CAR),
            left_dashed=_dashed_nodes(self.records(row, "left_lane_divider_segments")),
            right_dashed=_dashed_nodes(self.records(row, "right_lane_divider_segments")),
            left_solid=_is_solid(row.get("left_lane_divider_segments")),
            right_solid=_is_solid(row.get("right_lane_divider_segments")),
        )

    def _links(self, known: set[str]) -> tuple[list[tuple[str, str]], int]:
        """Return each usable link of the connectivity once (either lane may state it), and the number stated."""
        links: dict[tuple[str, str], None] = {}
        stated: set[tuple[str, str]] = set()
        for token, sides in self.data["connectivity"].items():
            sides = sides if isinstance(sides, dict) else {}
            pairs = [(str(other), token) for other in self.items(sides, "incoming")]
            pairs += [(token, str(other)) for other in self.items(sides, "outgoing")]
            stated.update(pairs)
            for pair in pairs:
                if pair[0] in known and pair[1] in known:
                    links[pair] = None
                else:
                    lost = pair[0] if pair[0] not in known else pair[1]
                    self.warn(
                        "link to unknown lane",
                        f"connectivity of {token!r} names lane {lost!r}, which is not usable",
                    )
        return list(links), len(stated)

    def _areas(self, layer: str, wanted: Any = lambda _row: True) -> list[Polygon]:
        polygons = []
        for row in filter(wanted, self.rows(layer)):
            if row.get("polygon_token"):
                polygons.append(self.polygon(row["polygon_token"]))
            else:
                self.warn(
                    f"{layer} without polygon", f"{layer} {row.get('token')!r} has no polygon and is left out"
                )
        return [polygon for polygon in polygons if polygon is not None]

    def _drivable(self) -> MultiPolygon:
        tokens = [token for row in self.rows("drivable_area") for token in self.items(row, "polygon_tokens")]
        parts = [part for part in map(self.polygon, tokens) if part is not None]
        return as_multi(shapely.union_all(parts)) if parts else MultiPolygon()

    def _dashed_lines(self) -> list[LineString]:
        lines: list[LineString] = []
        for row in self.rows("lane_divider"):
            segments = self.records(row, "lane_divider_segments")
            run: list[Any] = []
            for segment in [*segments, None]:
                if segment is not None and "DASHED" in str(segment.get("segment_type")):
                    run.append(segment.get("node_token"))
                    continue
                points = self.points(run, "a lane divider") if len(run) > 1 else None
                lines += [LineString(points)] if points else []
                run = []
        return lines


def _dashed_nodes(rows: Sequence[Row]) -> frozenset[str]:
    """Return the node names of the dashed part of a divider; the solid part must not be crossed."""
    return frozenset(str(row.get("node_token")) for row in rows if "DASHED" in str(row.get("segment_type")))


def _is_solid(segments: Sequence[Row] | None) -> bool:
    """Return whether a divider is solid in some part and dashed in none."""
    kinds = [str(row.get("segment_type")) for row in segments or []]
    return any("SOLID" in kind for kind in kinds) and not any("DASHED" in kind for kind in kinds)


def _records_only(pieces: object) -> list[Row]:
    if not isinstance(pieces, list) or not all(isinstance(piece, dict) for piece in pieces):
        raise ValueError("it is no list of arc-line pieces")
    return pieces
