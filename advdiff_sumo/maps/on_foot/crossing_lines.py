"""Painted crossings as lines from kerb to kerb over the ways of one junction, as SUMO has them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import shapely
from shapely.geometry import LineString, Point, Polygon

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.on_foot.carriageway import Carriageway, Strip

REACH_M = 8.0  # a kerb is looked for so far beyond the ends of what is painted
CLEAR_M = 0.3  # a crossing ends so far beyond the kerb
LEAST_SINE = 0.5  # a way that meets the crossing at less than 30° runs along it
LEAST_WIDTH_M, MOST_WIDTH_M = 2.0, 8.0
LONGEST_M = 100.0
_OVERLAP_M = 0.5
MOST_OVERLAP = 0.25  # share of a crossing that may lie over another one

NO_LANE = "no lane leads over it"
ON_LANES = "lies across lanes outside the ways of a junction"
TWO_JUNCTIONS = "lies over ways of several junctions without an island between them"
ALONG = "a way runs along it"
NO_KERB = f"no kerb within {REACH_M:g} m of its end"
TAKEN = "lies over another crossing"
TOO_LARGE = f"longer than {LONGEST_M:g} m"
UNCONTROLLED = "its junction has no right of way"


@dataclass(frozen=True, eq=False)
class CrossingLine:
    """One carriageway's part of a crossing.

    Attributes:
        ends_m: (2, 2) from kerb to kerb.
        width_m: width of the crossing.
        junction: whose ways it lies over.
        ways: those ways.
        goes_on: whether it goes on from another part of its crossing, over an island between them.
    """

    ends_m: FloatArray
    width_m: float
    junction: str
    ways: tuple[Strip, ...]
    goes_on: bool = False

    @property
    def line(self) -> LineString:
        """Its centre line."""
        return LineString(self.ends_m)

    @cached_property
    def band(self) -> Polygon:
        """Its area."""
        return self.line.buffer(0.5 * self.width_m, cap_style="flat")

    @property
    def length_m(self) -> float:
        """Length from kerb to kerb."""
        return float(np.hypot(*(self.ends_m[1] - self.ends_m[0])))


@dataclass(frozen=True, eq=False)
class Band:
    """A painted crossing as a straight band: its middle, the way one walks (unit vector), half length and width."""

    middle_m: FloatArray
    along: FloatArray
    half_m: float
    width_m: float

    def line(self, beyond_m: float = 0.0) -> LineString:
        """Return the centre line, *beyond_m* longer at both ends."""
        reach = (self.half_m + beyond_m) * self.along
        return LineString((self.middle_m - reach, self.middle_m + reach))


def band_of(area: Polygon, lines: Iterable[LineString]) -> Band | None:
    """Return *area* as a band across *lines*; None where it lies on none of them."""
    headings = [heading for line in lines if (heading := _heading(line, area)) is not None]
    box = shapely.minimum_rotated_rectangle(area)
    if not headings or not isinstance(box, Polygon):
        return None
    corners = shapely.get_coordinates(box)[:4]
    sides = np.diff(corners[:3], axis=0)
    lengths = np.hypot(*sides.T)
    units = sides / lengths[:, None]
    across = [sum(abs(float(_cross(unit, heading))) for heading in headings) for unit in units]
    one = int(np.argmax(across))
    width = float(np.clip(lengths[1 - one], LEAST_WIDTH_M, MOST_WIDTH_M))
    return Band(corners.mean(axis=0), units[one], 0.5 * float(lengths[one]), width)


def crossing_lines(area: Polygon, road: Carriageway) -> list[CrossingLine] | str:
    """Return what becomes of the painted crossing *area*: a line for each carriageway, or why there is none."""
    band = band_of(area, [strip.line for strip in road.crossed_by(area)])
    if band is None:
        return NO_LANE
    if 2.0 * band.half_m > LONGEST_M:
        return TOO_LARGE
    parts: list[CrossingLine] = []
    for start, end in carriageways(band, road):
        if max(abs(start), abs(end)) >= band.half_m + REACH_M - CLEAR_M:
            return NO_KERB
        ends = band.middle_m + np.outer((start - CLEAR_M, end + CLEAR_M), band.along)
        part = _part(LineString(ends), ends, band.width_m, road)
        if isinstance(part, str):
            return part
        parts.append(replace(part, goes_on=bool(parts)))
    return parts or NO_LANE


def carriageways(band: Band, road: Carriageway) -> list[tuple[float, float]]:
    """Return where the carriageways under *band* begin and end, in m from its middle."""
    line = band.line(REACH_M)
    inside = line.intersection(road.lanes_area)
    spans = []
    for part in shapely.get_parts(inside):
        if not isinstance(part, LineString) or part.is_empty:
            continue
        first, last = sorted(((np.asarray(part.coords) - band.middle_m) @ band.along)[[0, -1]].tolist())
        overlap = min(last, band.half_m) - max(first, -band.half_m)
        if overlap >= _OVERLAP_M and road.crossed_by(part):
            spans.append((first, last))
    return _to_painted_ends(sorted(spans), band.half_m)


def _to_painted_ends(spans: list[tuple[float, float]], half_m: float) -> list[tuple[float, float]]:
    """Return *spans* with the outermost ends where the paint ends, if it goes on beyond the lanes."""
    if not spans:
        return []
    spans[0] = (min(spans[0][0], CLEAR_M - half_m), spans[0][1])
    spans[-1] = (spans[-1][0], max(spans[-1][1], half_m - CLEAR_M))
    return spans


def _part(line: LineString, ends_m: FloatArray, width_m: float, road: Carriageway) -> CrossingLine | str:
    strips = road.crossed_by(line)
    if any(not strip.junction for strip in strips):
        return ON_LANES
    if len({strip.junction for strip in strips}) > 1:
        return TWO_JUNCTIONS
    along = (ends_m[1] - ends_m[0]) / np.hypot(*(ends_m[1] - ends_m[0]))
    for strip in strips:
        heading = _heading(strip.line, line)
        if heading is None or abs(float(_cross(along, heading))) < LEAST_SINE:
            return ALONG
    return CrossingLine(ends_m, width_m, strips[0].junction, tuple(strips))


def overlaps(lines: Sequence[CrossingLine], others: Sequence[CrossingLine]) -> bool:
    """Return whether one of *lines* lies over one of *others* for more than a quarter; at corners they may meet."""
    bands = np.array([other.band for other in others], dtype=object)
    size = shapely.area(bands)
    for one in lines:
        shared = shapely.area(shapely.intersection(one.band, bands))
        if (shared > MOST_OVERLAP * np.minimum(one.band.area, size)).any():
            return True
    return False


def _heading(line: LineString, shape: Polygon | LineString) -> FloatArray | None:
    """Return the direction (2,) of *line* where it meets *shape*; None where it does not, or several times."""
    meeting = line.intersection(shape)
    if meeting.is_empty or (isinstance(shape, LineString) and not isinstance(meeting, Point)):
        return None
    s = line.project(meeting.centroid)
    before, after = (np.asarray(line.interpolate(v).coords[0]) for v in (max(s - 0.5, 0.0), s + 0.5))
    step = after - before
    size = float(np.hypot(*step))
    return None if size < 1e-6 else np.asarray(step / size)


def _cross(a: FloatArray, b: FloatArray) -> float:
    return float(a[0] * b[1] - a[1] * b[0])
