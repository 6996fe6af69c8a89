"""Read stop lines and traffic lights of a nuScenes map expansion, with the carriageways that they stop."""

from __future__ import annotations

from shapely.geometry import LineString, Point, Polygon
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.maps.convert.sources.nuscenes_tables import MapTables, Row
from advdiff_sumo.maps.convert.sources.source_map import CIRCULAR, Direction, Lamp, Signal, StopLine

ARROWS = {
    "LEFT": Direction.LEFT,
    "RIGHT": Direction.RIGHT,
    "UP": Direction.STRAIGHT,
    "STRAIGHT": Direction.STRAIGHT,
}


def stop_lines_of(tables: MapTables) -> list[StopLine]:
    """Return the stop lines that have an area."""
    blocks = tables.by_token("road_block")
    stop_lines = []
    for row in tables.rows("stop_line"):
        area = tables.polygon(row["polygon_token"]) if row.get("polygon_token") else None
        if area is not None:
            block = _block(tables, blocks, row.get("road_block_token"))
            stop_lines.append(
                StopLine(str(row.get("token")), area, str(row.get("stop_line_type", "")), block)
            )
    return stop_lines


def signals_of(tables: MapTables) -> list[Signal]:
    """Return the traffic lights.

    The position of a light is the stop line that lists it, else its own line (poses are zero in one city). Its
    carriageway is ``from_road_block_token``, else the ``road_block_token`` of that stop line.
    """
    blocks = tables.by_token("road_block")
    stop_of = {
        str(light): row
        for row in tables.rows("stop_line")
        for light in tables.items(row, "traffic_light_tokens")
    }
    signals = []
    for row in tables.rows("traffic_light"):
        stop = stop_of.get(str(row.get("token")))
        block = _block(tables, blocks, row.get("from_road_block_token"))
        if block is None and stop is not None:
            block = _block(tables, blocks, stop.get("road_block_token"))
        signals.append(
            Signal(str(row.get("token")), _position(tables, row, stop), block, lamps=_lamps(row.get("items")))
        )
    return signals


def _lamps(items: object) -> frozenset[Lamp]:
    """Return the green lamps of a light: arrows by their shape, else circular; none if it lists no lamps."""
    rows = [row for row in items if isinstance(row, dict)] if isinstance(items, list) else []
    lamps = [(str(row.get("color", "")).upper(), _directions(str(row.get("shape", "")))) for row in rows]
    red = frozenset[Direction]().union(*(directions for colour, directions in lamps if colour == "RED"))
    return frozenset(
        Lamp(directions, protected=True, exclusive=directions <= red) if directions else CIRCULAR
        for colour, directions in lamps
        if colour == "GREEN"
    )


def _directions(shape: str) -> frozenset[Direction]:
    return frozenset(direction for word, direction in ARROWS.items() if word in shape.upper())


def _block(tables: MapTables, blocks: dict[str, Row], token: object) -> Polygon | None:
    row = blocks.get(str(token)) if token else None
    return tables.polygon(row["polygon_token"]) if row is not None and row.get("polygon_token") else None


def _position(tables: MapTables, row: Row, stop: Row | None) -> BaseGeometry | None:
    """Return the area of a light's stop line, else its own line or point; None if neither is usable."""
    if stop is not None and stop.get("polygon_token"):
        area = tables.polygon(stop["polygon_token"])
        if area is not None:
            return area
    line = tables.line_rows.get(str(row.get("line_token")))
    points = tables.points(tables.items(line, "node_tokens"), "a traffic light") if line else None
    if not points:
        return None
    return LineString(points) if len(set(points)) > 1 else Point(points[0])
