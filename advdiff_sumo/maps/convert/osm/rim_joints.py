"""Join streets to the rim of an HD map: choose the lanes to connect and draw curves between them."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import LineString

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.netplan import EdgePlan, NetPlan, turn_speed
from advdiff_sumo.maps.convert.osm.cut_streets import StreetStretch
from advdiff_sumo.maps.convert.osm.rim_ends import HEADING_M, RimEnd, rim_offsets_m

RADIUS_M = 30.0  # intended radius of the curves between map and street
SHORTEST_M = 6.0  # shortest curve between map and street
TIGHTEST_MPS = 4.0  # smallest speed on a curve (4 m/s at 2.5 m/s² lateral acceleration: radius 6.4 m)
SHORTEST_STREET_M = 1.0  # shortest street between junctions
LEFT_OVER_M = 5.0  # shortest rest of a stretch after trimming
CURVE_POINTS = 16  # points of a curve


@dataclass(frozen=True, eq=False)
class RimConnection:
    """A connection between a lane of a map edge and a lane of a street: both lane indices, and line (N, 2) in m."""

    edge: EdgePlan
    lane: int
    street_lane: int
    shape_m: FloatArray


@dataclass(frozen=True, eq=False)
class Joint:
    """One end of a stretch joined to the rim of the map.

    Attributes:
        stretch: the stretch.
        is_exit: whether the stretch begins at exits of the map; otherwise it ends at entries.
        rims: the exits or entries.
        ways: the connections between their lanes and those of the stretch.
        trim_m: length of the stretch at this end that the connections replace.
    """

    stretch: StreetStretch
    is_exit: bool
    rims: tuple[RimEnd, ...]
    ways: tuple[RimConnection, ...]
    trim_m: float


def build_joints(
    plan: NetPlan, fits: Mapping[RimEnd, Sequence[StreetStretch]], allowed: Collection[str]
) -> list[Joint]:
    """Return a joint for each end of an *allowed* stretch that fits some exit or entry of the map best."""
    rims_of: dict[tuple[str, bool], list[RimEnd]] = defaultdict(list)
    stretch_of: dict[str, StreetStretch] = {}
    for rim, stretches in fits.items():
        best_fit = next((stretch for stretch in stretches if stretch.id in allowed), None)
        if best_fit is not None:
            rims_of[best_fit.id, rim.is_exit].append(rim)
            stretch_of[best_fit.id] = best_fit
    lines = _MapLines(plan)
    joined_at_both_ends = {name for name, is_exit in rims_of if (name, not is_exit) in rims_of}
    joints = (
        _build_joint(stretch_of[name], is_exit, rims, lines, plan.lefthand, name in joined_at_both_ends)
        for (name, is_exit), rims in rims_of.items()
    )
    return [joint for joint in joints if joint is not None]


class _MapLines:
    """Index of the centre lines of the map's lanes and connections, to find those that a line crosses."""

    def __init__(self, plan: NetPlan) -> None:
        lanes = [(edge.id, lane.shape_m) for edge in plan.edges for lane in edge.lanes]
        connections = [("", connection.shape_m) for connection in plan.connections]
        self._names = [name for name, _ in (*lanes, *connections)]
        self._lines = [LineString(line) for _, line in (*lanes, *connections)]
        self._tree = shapely.STRtree(self._lines)

    def are_crossed(self, line_m: FloatArray, except_edges: Collection[str]) -> bool:
        """Return whether a line (N, 2) meets a lane or connection of the map other than lanes of *except_edges*."""
        line = LineString(line_m)
        numbers = self._tree.query(line, predicate="intersects").tolist()
        return any(self._names[number] not in except_edges for number in numbers)


def _build_joint(
    stretch: StreetStretch,
    is_exit: bool,
    rims: list[RimEnd],
    lines: _MapLines,
    lefthand: bool,
    both_ends: bool,
) -> Joint | None:
    """Return the joint of one end of *stretch* with *rims*, or None if none is possible.

    Exits and entries are left out if their connections would be too tight or cross other lanes of the map. With
    *both_ends*, the stretch gets a joint at either end, and each may trim half of it.
    """
    line = stretch.middle_m if is_exit else stretch.middle_m[::-1]
    if stretch.clear_m < SHORTEST_STREET_M:
        return None
    longest_trim_m = max(stretch.clear_m - LEFT_OVER_M, 0.0) * (0.5 if both_ends else 1.0)
    trim_m = float(np.clip(max(_bend_length_m(rim, line) for rim in rims), 0.0, longest_trim_m))
    lanes = _street_lanes(stretch, is_exit, trim_m, lefthand)
    joined_edges = {rim.edge.id for rim in rims}
    ways: list[RimConnection] = []
    kept = []
    for rim, pairs in _paired(rims, lanes, every_street_lane=not is_exit).items():
        rim_ways = [_curve(rim, lane, street_lane, lanes) for lane, street_lane in pairs]
        if not any(
            turn_speed(way.shape_m) < TIGHTEST_MPS or lines.are_crossed(way.shape_m, joined_edges)
            for way in rim_ways
        ):
            ways += rim_ways
            kept.append(rim)
    return Joint(stretch, is_exit, tuple(kept), tuple(ways), trim_m) if kept else None


def _bend_length_m(rim: RimEnd, line_m: FloatArray) -> float:
    """Return the length in m of a street's end that a curve of radius :data:`RADIUS_M` from *rim* has to replace.

    A cubic between parallel straight lines at distance *y*, over the length *x*, has radius x² / 6 y at its ends.
    """
    ahead, aside = rim_offsets_m(rim, line_m[0])
    return max(SHORTEST_M, math.sqrt(6.0 * RADIUS_M * float(aside))) - float(ahead)


@dataclass(frozen=True, eq=False)
class StreetLanes:
    """Lanes for cars at one end of a stretch: indices, positions (L, 2) in m, and unit vector of driving direction."""

    numbers: tuple[int, ...]
    at_m: FloatArray
    along: FloatArray


def _street_lanes(stretch: StreetStretch, is_exit: bool, trim_m: float, lefthand: bool) -> StreetLanes:
    s = trim_m if is_exit else stretch.length_m - trim_m
    at = polyline.at(stretch.middle_m, s)
    reach = np.clip([s - HEADING_M, s + HEADING_M], 0.0, stretch.length_m)
    along = polyline.direction(*polyline.at(stretch.middle_m, reach))
    left = polyline.left_of(along)
    numbers = tuple(index for index, open_ in enumerate(stretch.street.for_cars) if open_)
    offsets = stretch.street.lane_offsets_m(lefthand)
    return StreetLanes(numbers, at + np.array([offsets[n] for n in numbers])[:, None] * left, along)


def _paired(
    rims: Sequence[RimEnd], lanes: StreetLanes, *, every_street_lane: bool
) -> dict[RimEnd, list[tuple[int, int]]]:
    """Return for each exit or entry the pairs (number among its lanes, number among the street's lanes) to connect.

    All map lanes are shifted by a common lateral offset, chosen so that they lie as close to street lanes as possible.
    Then each takes the nearest street lane, so that neighbours stay neighbours. With *every_street_lane*, street lanes
    that are left take the nearest map lane.
    """
    left = polyline.left_of(lanes.along)
    street_offsets = lanes.at_m @ left
    rim_lanes = [(rim, k) for rim in rims for k in range(len(rim.lanes))]
    map_offsets = np.concatenate([rim.at_m @ left for rim in rims])
    shifts = (street_offsets - map_offsets[:, None]).ravel()
    gaps = np.abs(map_offsets[:, None] + shifts[:, None, None] - street_offsets)  # (shift, lane, street lane)
    shift = shifts[np.argmin(gaps.min(axis=2).sum(axis=1) + 0.01 * np.abs(shifts))]
    gap = np.abs(map_offsets[:, None] + shift - street_offsets)
    chosen = {(lane, int(gap[lane].argmin())) for lane in range(len(map_offsets))}
    if every_street_lane:
        used = {street_lane for _, street_lane in chosen}
        chosen |= {(int(gap[:, n].argmin()), n) for n in range(len(street_offsets)) if n not in used}
    pairs: dict[RimEnd, list[tuple[int, int]]] = {rim: [] for rim in rims}
    for lane, street_lane in sorted(chosen):
        rim, k = rim_lanes[lane]
        pairs[rim].append((k, street_lane))
    return pairs


def _curve(rim: RimEnd, lane: int, street_lane: int, lanes: StreetLanes) -> RimConnection:
    """Return the connection of two lanes: a cubic that has the headings of both lanes at its ends."""
    ends = [(rim.at_m[lane], rim.along), (lanes.at_m[street_lane], lanes.along)]
    (start, along0), (end, along1) = ends if rim.is_exit else ends[::-1]
    reach = float(np.hypot(*(end - start)))
    t = np.linspace(0.0, 1.0, CURVE_POINTS)[:, None]
    bend = (t**3 - 2.0 * t**2 + t) * along0 + (t**3 - t**2) * along1
    shape = start + (3.0 * t**2 - 2.0 * t**3) * (end - start) + reach * bend
    return RimConnection(rim.edge, rim.lanes[lane], lanes.numbers[street_lane], shape)
