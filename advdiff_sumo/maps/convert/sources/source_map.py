"""What a map says, whatever file it came from: the input of the converter."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from shapely.geometry import LineString, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

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
    """Where vehicles stop.

    Attributes:
        token: its name in the source.
        area: the painted line.
        kind: as in the source (STOP_SIGN, TRAFFIC_LIGHT, TURN_STOP, PED_CROSSING, YIELD, …).
        block: the carriageway that it ends, where the source names one.
    """

    token: str
    area: Polygon
    kind: str
    block: Polygon | None = None


class Direction(StrEnum):
    """Where a way through a junction leads."""

    LEFT = "left"
    STRAIGHT = "straight"
    RIGHT = "right"


@dataclass(frozen=True)
class Lamp:
    """What a green lamp of a traffic light lets go.

    Attributes:
        directions: those that it governs.
        protected: whether nobody in their way has green with them, as under an arrow. Under a circular lamp those
            that turn yield to oncoming traffic.
        exclusive: whether a red arrow holds these directions while other lamps are green.
    """

    directions: frozenset[Direction]
    protected: bool
    exclusive: bool = False


CIRCULAR = Lamp(frozenset(Direction), protected=False)


@dataclass(frozen=True, eq=False)
class Signal:
    """A traffic light.

    Attributes:
        token: its name in the source.
        at: the stop line that lists it, else its own line or place; None where neither is known.
        block: the carriageway that it stops, where the source names one.
        lanes: tokens of the lanes that it stops, where the source names them.
        lamps: its green lamps, where the source tells them.
    """

    token: str
    at: BaseGeometry | None
    block: Polygon | None = None
    lanes: tuple[str, ...] = ()
    lamps: frozenset[Lamp] = frozenset()


@dataclass(frozen=True)
class StatedSizes:
    """How much the file states, whether usable or not: *lanes* counts lanes and connectors, *links* their links."""

    lanes: int
    links: int


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
        stated: how much the file states; None: as much as is here.
        left_out: tokens of lanes that the file states and that are not here.
        notes: counts of what was mended or left out while reading.
        warnings: one sentence for each thing a user should know.
        projection: PROJ string whose plane is the frame of the map, where that is known.
        keeps_left: whether the map states that traffic keeps left, and its lanes are read so; of a map that is
            converted, whether it does.
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
    stated: StatedSizes | None = None
    left_out: tuple[str, ...] = ()
    notes: Counter[str] = field(default_factory=Counter)
    warnings: tuple[str, ...] = ()
    projection: str | None = None
    keeps_left: bool = False
