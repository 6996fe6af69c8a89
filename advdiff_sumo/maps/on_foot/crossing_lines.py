"""Converts painted crossings into lines from kerb to kerb over one junction each, as SUMO models crossings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import shapely
from shapely.geometry import LineString, Point, Polygon

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.on_foot.carriageway import Carriageway, Strip

REACH_M = 8.0  # a kerb is sought up to this distance beyond the painted ends
CLEAR_M = 0.3  # a crossing ends this far beyond the kerb
LEAST_SINE = 0.5  # a path that meets the crossing at less than 30° runs along it
LEAST_WIDTH_M, MOST_WIDTH_M = 2.0, 8.0
LONGEST_M = 100.0
_OVERLAP_M = 0.5  # shortest overlap of paint and carriageway for the crossing to lead over it
MOST_OVERLAP = 0.25  # share of a crossing that may overlap another one
_STEP_M = 0.5  # distance over which directions of lines are measured

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
    """The part of a crossing that leads over one carriageway.

    Attributes:
        ends_m: (2, 2) end points, at the kerbs.
        width_m: width of the crossing.
        junction: the junction that it lies on.
        strips: internal lanes of the junction that it leads over.
        follows_island: whether the previous part of the crossing ends at an island at which this one begins.
    """

    ends_m: FloatArray
    width_m: float
    junction: str
    strips: tuple[Strip, ...]
    follows_island: bool = False

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
    """A painted crossing as a straight band.

    Attributes:
        middle_m: (2,) centre.
        along: (2,) walking direction, as a unit vector.
        half_m: half the length in that direction.
        width_m: width across it.
    """

    middle_m: FloatArray
    along: FloatArray
    half_m: float
    width_m: float

    def line(self, beyond_m: float = 0.0) -> LineString:
        """Return the centre line, extended by *beyond_m* at both ends."""
        reach = (self.half_m + beyond_m) * self.along
        return LineString((self.middle_m - reach, self.middle_m + reach))


def band_of(area: Polygon, lines: Iterable[LineString]) -> Band | None:
    """Return *area* as a band that leads across *lines*; None if it intersects none of them."""
    headings = [heading for line in lines if (heading := direction_where_met(line, area)) is not None]
    box = shapely.minimum_rotated_rectangle(area)
    if not headings or not isinstance(box, Polygon):
        return None
    corners = shapely.get_coordinates(box)[:4]
    sides = np.diff(corners[:3], axis=0)
    lengths_m = np.hypot(*sides.T)
    directions = sides / lengths_m[:, None]
    sines = [sum(abs(float(_cross(side, heading))) for heading in headings) for side in directions]
    along = int(np.argmax(sines))  # the side that is most perpendicular to the lines
    width_m = float(np.clip(lengths_m[1 - along], LEAST_WIDTH_M, MOST_WIDTH_M))
    return Band(corners.mean(axis=0), directions[along], 0.5 * float(lengths_m[along]), width_m)


def crossing_lines(area: Polygon, road: Carriageway) -> list[CrossingLine] | str:
    """Return the parts of the painted crossing *area*, one for each carriageway; or why it cannot be converted."""
    band = band_of(area, [strip.line for strip in road.crossed_by(area)])
    if band is None:
        return NO_LANE
    if 2.0 * band.half_m > LONGEST_M:
        return TOO_LARGE
    parts: list[CrossingLine] = []
    for start, end in carriageways(band, road):
        if max(abs(start), abs(end)) >= band.half_m + REACH_M - CLEAR_M:
            return NO_KERB
        ends_m = band.middle_m + np.outer((start - CLEAR_M, end + CLEAR_M), band.along)
        part = _part(LineString(ends_m), ends_m, band.width_m, road)
        if isinstance(part, str):
            return part
        parts.append(replace(part, follows_island=bool(parts)))
    return parts or NO_LANE


def carriageways(band: Band, road: Carriageway) -> list[tuple[float, float]]:
    """Return the start and end of each carriageway along *band*, in m from the middle of the band."""
    on_lanes = band.line(REACH_M).intersection(road.lanes_area)
    spans = []
    for part in shapely.get_parts(on_lanes):
        if not isinstance(part, LineString) or part.is_empty:
            continue
        first, last = sorted(((np.asarray(part.coords) - band.middle_m) @ band.along)[[0, -1]].tolist())
        overlap = min(last, band.half_m) - max(first, -band.half_m)
        if overlap >= _OVERLAP_M and road.crossed_by(part):
            spans.append((first, last))
    return _to_painted_ends(sorted(spans), band.half_m)


def _to_painted_ends(spans: list[tuple[float, float]], half_m: float) -> list[tuple[float, float]]:
    """Return *spans*, extended at both outer ends to the ends of the paint, if it reaches beyond the lanes."""
    if not spans:
        return []
    spans[0] = (min(spans[0][0], CLEAR_M - half_m), spans[0][1])
    spans[-1] = (spans[-1][0], max(spans[-1][1], half_m - CLEAR_M))
    return spans


def _part(line: LineString, ends_m: FloatArray, width_m: float, road: Carriageway) -> CrossingLine | str:
    """Return the part of a crossing along *line* (from *ends_m*, (2, 2)), or why it cannot be converted."""
    strips = road.crossed_by(line)
    if any(not strip.junction for strip in strips):
        return ON_LANES
    if len({strip.junction for strip in strips}) > 1:
        return TWO_JUNCTIONS
    along = (ends_m[1] - ends_m[0]) / np.hypot(*(ends_m[1] - ends_m[0]))
    for strip in strips:
        heading = direction_where_met(strip.line, line)
        if heading is None or abs(float(_cross(along, heading))) < LEAST_SINE:
            return ALONG
    return CrossingLine(ends_m, width_m, strips[0].junction, tuple(strips))


def overlaps(lines: Sequence[CrossingLine], others: Sequence[CrossingLine]) -> bool:
    """Return whether one of *lines* overlaps one of *others* by more than a quarter of the smaller area."""
    bands = np.array([other.band for other in others], dtype=object)
    areas_m2 = shapely.area(bands)
    for line in lines:
        shared_m2 = shapely.area(shapely.intersection(line.band, bands))
        if (shared_m2 > MOST_OVERLAP * np.minimum(line.band.area, areas_m2)).any():
            return True
    return False


def direction_where_met(
    line: LineString, shape: Polygon | LineString, step_m: float = _STEP_M
) -> FloatArray | None:
    """Return the direction (2,) of *line* where it meets *shape*; None if it does not, or meets a line repeatedly.

    It is that from *step_m* before the place to *step_m* after it.
    """
    shared = line.intersection(shape)
    if shared.is_empty or (isinstance(shape, LineString) and not isinstance(shared, Point)):
        return None
    s = line.project(shared.centroid)
    before, after = (np.asarray(line.interpolate(v).coords[0]) for v in (max(s - step_m, 0.0), s + step_m))
    step = after - before
    length_m = float(np.hypot(*step))
    return None if length_m < 1e-6 else np.asarray(step / length_m)


def _cross(a: FloatArray, b: FloatArray) -> float:
    return float(a[0] * b[1] - a[1] * b[0])
