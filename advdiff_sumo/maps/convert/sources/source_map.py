"""What a map says, whatever file it came from: the input of the converter."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from shapely.geometry import LineString, MultiPolygon, Point, Polygon

from advdiff_sumo.core.arrays import FloatArray


class LaneUse(StrEnum):
    """Who may drive on a lane."""

    CAR = "car"
    BUS = "bus"
    BICYCLE = "bicycle"


@dataclass(frozen=True, eq=False)
class SourceLane:
    """One lane or lane connector of the source map.

    Attributes:
        token: its name in the source, unique.
        is_connector: whether it lies in a junction (joins lanes) rather than on a road.
        centre_m: (N, 2) centre line in driving direction, N ≥ 2, points at least a millimetre apart.
        polygon: its area, or None where the source has none.
        use: who may drive on it.
        speed_mps: speed limit, or None where the source has none.
        width_m: width that the source states, or None (then it is measured on the polygon).
        left_dashed, right_dashed: node names of the dashed divider on that side.
        left_solid, right_solid: whether the divider on that side must not be crossed anywhere.
    """

    token: str
    is_connector: bool
    centre_m: FloatArray
    polygon: Polygon | None = None
    use: LaneUse = LaneUse.CAR
    speed_mps: float | None = None
    width_m: float | None = None
    left_dashed: frozenset[str] = frozenset()
    right_dashed: frozenset[str] = frozenset()
    left_solid: bool = False
    right_solid: bool = False


@dataclass(frozen=True, eq=False)
class StopLine:
    """Where vehicles stop; *kind* as in the source (STOP_SIGN, TRAFFIC_LIGHT, YIELD, …)."""

    token: str
    area: Polygon
    kind: str


@dataclass(frozen=True, eq=False)
class Signal:
    """A traffic light, placed at the line or stop line that it belongs to."""

    token: str
    at: Point


@dataclass(frozen=True, eq=False)
class SourceMap:
    """A whole map in metres (x east, y north), as read; nothing is repaired yet.

    Attributes:
        path: the file, for messages.
        location: name of the place, for example "boston-seaport".
        lanes: lanes and connectors in the order of the file.
        links: ordered pairs (from token, to token) of the source's connectivity.
        intersections: areas that the source calls intersections.
        dashed_dividers: lines that may be crossed to change lane.
        notes: counts of what was mended or left out while reading.
        warnings: one sentence for each thing a user should know.
    """

    path: Path
    location: str
    lanes: tuple[SourceLane, ...]
    links: tuple[tuple[str, str], ...]
    drivable: MultiPolygon = field(default_factory=MultiPolygon)
    intersections: tuple[Polygon, ...] = ()
    crossings: tuple[Polygon, ...] = ()
    walkways: tuple[Polygon, ...] = ()
    carparks: tuple[Polygon, ...] = ()
    stop_lines: tuple[StopLine, ...] = ()
    signals: tuple[Signal, ...] = ()
    dashed_dividers: tuple[LineString, ...] = ()
    notes: Counter[str] = field(default_factory=Counter)
    warnings: tuple[str, ...] = ()
