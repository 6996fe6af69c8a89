"""Read the JSON of the nuScenes map expansion (v1.3)."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.geometry import LineString, MultiPolygon, Point, Polygon

from advdiff_sumo.core.errors import MapError
from advdiff_sumo.maps.convert.sources.arcline import drop_repeats, sample_path
from advdiff_sumo.maps.convert.sources.source_map import LaneUse, Signal, SourceLane, SourceMap, StopLine

MAX_FILE_BYTES = 600_000_000  # the largest genuine file has about a tenth of that
NEEDED = ("polygon", "node", "lane", "lane_connector", "arcline_path_3", "connectivity")
TABLES = (
    "polygon",
    "line",
    "node",
    "drivable_area",
    "road_segment",
    "lane",
    "lane_connector",
    "ped_crossing",
    "walkway",
    "carpark_area",
    "stop_line",
    "lane_divider",
    "traffic_light",
)
USES = {"CAR": LaneUse.CAR, "BUS": LaneUse.BUS, "BIKE": LaneUse.BICYCLE, "BICYCLE": LaneUse.BICYCLE}
Row = Mapping[str, Any]


def read_nuscenes_map(path: Path) -> SourceMap:
    """Read a map expansion file.

    Raises:
        MapError: not such a file, an older expansion, a needed layer is absent, or nothing in it is usable.
    """
    return _Reader(path, load_json(path)).read()


def load_json(path: Path) -> dict[str, Any]:
    """Return the object in *path*, checked to be a map expansion with the layers that conversion needs."""
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise MapError(
                path, f"{size / 1e6:.0f} MB is more than any map expansion has", "give a city's JSON file"
            )
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MapError(
            path, f"cannot be read ({error.strerror})", "give the path of an existing JSON file"
        ) from None
    except (ValueError, RecursionError) as error:
        raise MapError(path, f"is no JSON text ({error})", "give a file of maps/expansion") from None
    _check_layers(path, data)
    checked: dict[str, Any] = data
    return checked


def _check_layers(path: Path, data: object) -> None:
    remedy = "download the map expansion v1.3 from nuscenes.org"
    if not isinstance(data, dict) or not ({"lane", "node", "polygon"} & set(data)):
        raise MapError(path, "is JSON of another format, not a nuScenes map expansion", remedy)
    if "arcline_path_3" not in data:
        raise MapError(path, "layer 'arcline_path_3' is missing (an expansion older than v1.2)", remedy)
    version = str(data.get("version", "1.0"))
    if version.split(".")[:2] < ["1", "3"]:
        raise MapError(path, f"is map expansion v{version}, older than v1.3", remedy)
    for layer in NEEDED:
        kind: type = dict if layer in ("arcline_path_3", "connectivity") else list
        if not isinstance(data.get(layer), kind):
            raise MapError(path, f"layer '{layer}' is missing or malformed", remedy)
    if not data["lane"] and not data["lane_connector"]:
        raise MapError(path, "holds no lane", "give the map of a city, not an empty one")
    if not data["arcline_path_3"]:
        raise MapError(path, "layer 'arcline_path_3' is empty, so no lane has a centre line", remedy)


class _Reader:
    """Turns the tables into a SourceMap, counting what it leaves out."""

    def __init__(self, path: Path, data: dict[str, Any]) -> None:
        self.path, self.data = path, data
        self.notes: Counter[str] = Counter()
        self.warnings: list[str] = []
        self.nodes = self._nodes()
        self.polygon_rows = self._by_token("polygon")
        self.line_rows = self._by_token("line")

    def read(self) -> SourceMap:
        lanes = self._lanes("lane", False) + self._lanes("lane_connector", True)
        if not lanes:
            raise MapError(self.path, "no lane has a usable centre line", "see arcline_path_3 of the file")
        known = {lane.token for lane in lanes}
        return SourceMap(
            path=self.path,
            location=self.path.stem,
            lanes=tuple(lanes),
            links=tuple(self._links(known)),
            drivable=self._drivable(),
            intersections=tuple(self._areas("road_segment", lambda row: bool(row.get("is_intersection")))),
            crossings=tuple(self._areas("ped_crossing")),
            walkways=tuple(self._areas("walkway")),
            carparks=tuple(self._areas("carpark_area")),
            stop_lines=tuple(self._stop_lines()),
            signals=tuple(self._signals()),
            dashed_dividers=tuple(self._dashed()),
            notes=self.notes,
            warnings=tuple(self.warnings),
        )

    def warn(self, kind: str, sentence: str) -> None:
        """Count *kind* and keep the first sentence of its sort."""
        if not self.notes[kind]:
            self.warnings.append(f"{self.path.name}: {sentence}")
        self.notes[kind] += 1

    def _rows(self, layer: str) -> list[Row]:
        rows = self.data.get(layer) or []
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise MapError(
                self.path, f"layer '{layer}' is no list of records", "give an unchanged expansion file"
            )
        return rows

    def _list(self, row: Row, key: str) -> list[Any]:
        """Return the list *key* of a record; an absent one is empty."""
        value = row.get(key)
        if not isinstance(value, list | None):
            place = f"record {row.get('token')!r}" if "token" in row else "a record"
            raise MapError(self.path, f"'{key}' of {place} is no list", "give an unchanged expansion file")
        return value or []

    def _records(self, row: Row, key: str) -> list[Row]:
        """Return the list *key* of a record, whose items must be records too."""
        items = self._list(row, key)
        if not all(isinstance(item, dict) for item in items):
            place = f"record {row.get('token')!r}" if "token" in row else "a record"
            raise MapError(
                self.path, f"'{key}' of {place} is no list of records", "give an unchanged expansion file"
            )
        return items

    def _by_token(self, layer: str) -> dict[str, Row]:
        table: dict[str, Row] = {}
        for row in self._rows(layer):
            token = row.get("token")
            if token is None:
                self.notes[f"{layer} without token"] += 1
            elif str(token) in table:
                self.warn(
                    f"duplicate {layer} token", f"{layer} token {token!r} occurs twice; the first one is used"
                )
            else:
                table[str(token)] = row
        return table

    def _nodes(self) -> dict[str, tuple[float, float]]:
        nodes: dict[str, tuple[float, float]] = {}
        for row in self._rows("node"):
            token, x, y = row.get("token"), row.get("x"), row.get("y")
            if not _finite(x, y):
                self.warn(
                    "node not finite",
                    f"node {token!r} has no finite x and y; polygons that use it are left out",
                )
            elif token is not None:
                nodes[str(token)] = (float(x), float(y))  # type: ignore[arg-type]  # checked by _finite
        return nodes

    def _points(self, tokens: Iterable[Any], what: str) -> list[tuple[float, float]] | None:
        names = [str(token) for token in tokens]
        missing = next((name for name in names if name not in self.nodes), None)
        if missing is not None:
            self.warn("unknown node", f"{what} names node {missing!r}, which is not usable; it is left out")
            return None
        return [self.nodes[name] for name in names]

    def _polygon(self, token: Any) -> Polygon | None:
        """Return the polygon named *token*, mended where it crosses itself, or None."""
        row = self.polygon_rows.get(str(token))
        if row is None:
            self.warn("unknown polygon", f"polygon {token!r} does not exist")
            return None
        outer = self._points(self._list(row, "exterior_node_tokens"), f"polygon {token!r}")
        if outer is None or len(outer) < 3:
            self.notes["polygon with under three nodes"] += outer is not None
            return None
        rings = [
            self._points(self._list(hole, "node_tokens"), f"polygon {token!r}")
            for hole in self._records(row, "holes")
        ]
        polygon = Polygon(outer, [ring for ring in rings if ring is not None and len(ring) >= 3])
        return self._mended(polygon, token)

    def _mended(self, polygon: Polygon, token: Any) -> Polygon | None:
        if polygon.is_valid:
            return polygon if polygon.area > 0 else None
        self.warn(
            "polygon crosses itself", f"polygon {token!r} crosses itself; its largest valid part is used"
        )
        parts = [p for p in shapely.get_parts(shapely.make_valid(polygon)) if isinstance(p, Polygon)]
        parts += [
            q
            for p in shapely.get_parts(shapely.make_valid(polygon))
            for q in getattr(p, "geoms", [])
            if isinstance(q, Polygon)
        ]
        return max(parts, key=lambda part: part.area, default=None)

    def _lanes(self, layer: str, is_connector: bool) -> list[SourceLane]:
        found: dict[str, SourceLane] = {}
        for row in self._rows(layer):
            token = row.get("token")
            if token is None or str(token) in found:
                self.warn(
                    f"{layer} token unusable", f"{layer} token {token!r} is null or occurs twice; left out"
                )
                continue
            lane = self._lane(str(token), row, is_connector)
            if lane is not None:
                found[lane.token] = lane
        return list(found.values())

    def _lane(self, token: str, row: Row, is_connector: bool) -> SourceLane | None:
        pieces = self.data["arcline_path_3"].get(token)
        if not pieces:
            self.warn("lane without arc line", f"lane {token!r} has no arc line and is left out")
            return None
        try:
            centre = drop_repeats(sample_path(_records_only(pieces)))
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
            polygon=self._polygon(row["polygon_token"]) if row.get("polygon_token") else None,
            use=USES.get(str(row.get("lane_type", "CAR")).upper(), LaneUse.CAR),
            left_dashed=_dashed_nodes(self._records(row, "left_lane_divider_segments")),
            right_dashed=_dashed_nodes(self._records(row, "right_lane_divider_segments")),
            left_solid=_is_solid(row.get("left_lane_divider_segments")),
            right_solid=_is_solid(row.get("right_lane_divider_segments")),
        )

    def _links(self, known: set[str]) -> list[tuple[str, str]]:
        """Return each pair of the connectivity once, whichever side states it."""
        links: dict[tuple[str, str], None] = {}
        for token, sides in self.data["connectivity"].items():
            sides = sides if isinstance(sides, dict) else {}
            pairs = [(str(other), token) for other in self._list(sides, "incoming")]
            pairs += [(token, str(other)) for other in self._list(sides, "outgoing")]
            for pair in pairs:
                if pair[0] in known and pair[1] in known:
                    links[pair] = None
                else:
                    lost = pair[0] if pair[0] not in known else pair[1]
                    self.warn(
                        "link to unknown lane",
                        f"connectivity of {token!r} names lane {lost!r}, which is not usable",
                    )
        return list(links)

    def _areas(self, layer: str, wanted: Any = lambda _row: True) -> list[Polygon]:
        found = [
            self._polygon(row["polygon_token"])
            for row in self._rows(layer)
            if wanted(row) and row.get("polygon_token")
        ]
        return [polygon for polygon in found if polygon is not None]

    def _drivable(self) -> MultiPolygon:
        tokens = [token for row in self._rows("drivable_area") for token in self._list(row, "polygon_tokens")]
        parts = [part for part in map(self._polygon, tokens) if part is not None]
        return as_multi(shapely.union_all(parts)) if parts else MultiPolygon()

    def _stop_lines(self) -> list[StopLine]:
        found = []
        for row in self._rows("stop_line"):
            area = self._polygon(row["polygon_token"]) if row.get("polygon_token") else None
            if area is not None:
                found.append(StopLine(str(row.get("token")), area, str(row.get("stop_line_type", ""))))
        return found

    def _signals(self) -> list[Signal]:
        """Place lights by the stop line that lists them, else by their line (poses are zero in one city)."""
        stop_of = {
            str(light): row
            for row in self._rows("stop_line")
            for light in self._list(row, "traffic_light_tokens")
        }
        found = []
        for row in self._rows("traffic_light"):
            at = self._signal_place(row, stop_of.get(str(row.get("token"))))
            if at is None:
                self.warn(
                    "traffic light without place",
                    f"traffic light {row.get('token')!r} has neither stop line nor line",
                )
            else:
                found.append(Signal(str(row.get("token")), at))
        return found

    def _signal_place(self, row: Row, stop: Row | None) -> Point | None:
        if stop is not None and stop.get("polygon_token"):
            area = self._polygon(stop["polygon_token"])
            if area is not None:
                return Point(area.centroid)
        line = self.line_rows.get(str(row.get("line_token")))
        points = self._points(self._list(line, "node_tokens"), "a traffic light") if line else None
        return Point(np.mean(points, axis=0)) if points else None

    def _dashed(self) -> list[LineString]:
        lines: list[LineString] = []
        for row in self._rows("lane_divider"):
            segments = self._records(row, "lane_divider_segments")
            run: list[Any] = []
            for segment in [*segments, None]:
                if segment is not None and "DASHED" in str(segment.get("segment_type")):
                    run.append(segment.get("node_token"))
                    continue
                points = self._points(run, "a lane divider") if len(run) > 1 else None
                lines += [LineString(points)] if points else []
                run = []
        return lines


def as_multi(shape: shapely.Geometry) -> MultiPolygon:
    """Return the polygons of any geometry as one MultiPolygon."""
    parts = [part for part in shapely.get_parts(shape) if isinstance(part, Polygon) and part.area > 0]
    return MultiPolygon(parts)


def _dashed_nodes(rows: Sequence[Row]) -> frozenset[str]:
    """Return the node names of the dashed part of a divider; the solid part may not be crossed."""
    return frozenset(str(row.get("node_token")) for row in rows if "DASHED" in str(row.get("segment_type")))


def _is_solid(segments: Sequence[Row] | None) -> bool:
    """Return whether a divider is named solid and nowhere dashed."""
    kinds = [str(row.get("segment_type")) for row in segments or []]
    return any("SOLID" in kind for kind in kinds) and not any("DASHED" in kind for kind in kinds)


def _records_only(pieces: object) -> list[Row]:
    if not isinstance(pieces, list) or not all(isinstance(piece, dict) for piece in pieces):
        raise ValueError("it is no list of arc-line pieces")
    return pieces


def _finite(*values: object) -> bool:
    return all(isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in values)
