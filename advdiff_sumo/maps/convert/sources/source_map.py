"""Format-independent content of a map: the input of the converter."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from pathlib import Path

from shapely.geometry import LineString, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.core.arrays import FloatArray


class LaneUse(StrEnum):
    """Kind of vehicles for which a lane is."""

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
        polygon: its area, or None if the source has none.
        use: kind of vehicles that may drive on it.
        speed_mps: speed limit, or None if the source has none.
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
    """A line at which vehicles stop.

    Attributes:
        token: its name in the source.
        area: area of the painted line.
        kind: kind in the source (STOP_SIGN, TRAFFIC_LIGHT, TURN_STOP, PED_CROSSING, YIELD, …).
        block: the carriageway at whose end it lies, if the source names one.
    """

    token: str
    area: Polygon
    kind: str
    block: Polygon | None = None


class Direction(StrEnum):
    """Direction of a turn through a junction."""

    LEFT = "left"
    STRAIGHT = "straight"
    RIGHT = "right"


@dataclass(frozen=True)
class Lamp:
    """A green lamp of a traffic light.

    Attributes:
        directions: directions of travel that it controls.
        protected: whether no conflicting traffic has green at the same time, as under an arrow. Under a circular
            lamp, turning vehicles yield to oncoming traffic.
        exclusive: whether a red arrow stops these directions while other lamps are green.
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
        at: the stop line that lists it, else its own line or position; None if neither is known.
        block: the carriageway that it stops, if the source names one.
        lanes: tokens of the lanes that it stops, if the source names them.
        lamps: its green lamps, if the source lists them.
    """

    token: str
    at: BaseGeometry | None
    block: Polygon | None = None
    lanes: tuple[str, ...] = ()
    lamps: frozenset[Lamp] = frozenset()


@dataclass(frozen=True)
class StatedSizes:
    """Numbers of lanes (with connectors) and links that the file states, whether usable or not."""

    lanes: int
    links: int


@dataclass(frozen=True, eq=False)
class SourceMap:
    """A whole map in m (x east, y north), as read from a file or after repair.

    Attributes:
        path: the file, for messages.
        location: name of the place, for example "boston-seaport".
        lanes: lanes and connectors in the order of the file.
        links: ordered pairs (from token, to token) of the source's connectivity.
        intersections: areas that the source calls intersections.
        dashed_dividers: dividers that may be crossed to change lane.
        stated: numbers of lanes and links in the file; None: as many as here.
        left_out: tokens of lanes of the file that are not among *lanes*.
        notes: number of items of each kind that were repaired or left out.
        warnings: one sentence for each thing a user should know.
        projection: PROJ string whose plane is the frame of the map, if known.
        keeps_left: whether the map states that traffic keeps left; during conversion, whether traffic keeps left.
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

    @cached_property
    def number_of(self) -> dict[str, int]:
        """Positions in *lanes* by token."""
        return {lane.token: number for number, lane in enumerate(self.lanes)}
