"""Join streets to the rim of an HD map: lanes are matched by place, heading and direction."""

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
from advdiff_sumo.maps.convert.osm.rim_ends import HEADING_M, RimEnd, away

RADIUS_M = 30.0  # of the bends between map and street
SHORTEST_M, TIGHTEST_MPS = (
    6.0,
    4.0,
)  # of ways between map and street; at 4 m/s 2.5 m/s² sideways are 6.4 m of radius
SHORTEST_STREET_M = 1.0  # between junctions
LEFT_OVER_M = 5.0  # of a stretch, after its end gave way to a bend
CURVE_POINTS = 16


@dataclass(frozen=True, eq=False)
class JointWay:
    """A way between a lane of the map and one of a street: numbers of both lanes, and (N, 2) line in m."""

    edge: EdgePlan
    lane: int
    street_lane: int
    shape_m: FloatArray


@dataclass(frozen=True, eq=False)
class Joint:
    """A stretch that begins where edges of the map end (*leaves*), or ends where they begin.

    Attributes:
        gives_way_m: how much of the stretch's end gives way to bends.
    """

    stretch: StreetStretch
    leaves: bool
    rims: tuple[RimEnd, ...]
    ways: tuple[JointWay, ...]
    gives_way_m: float


def joints(
    plan: NetPlan, fits: Mapping[RimEnd, Sequence[StreetStretch]], allowed: Collection[str]
) -> list[Joint]:
    """Return a joint for each end of a stretch among *allowed* that is the best fit for some end of the map."""
    rims_of: dict[tuple[str, bool], list[RimEnd]] = defaultdict(list)
    stretch_of: dict[str, StreetStretch] = {}
    for rim, stretches in fits.items():
        best = next((stretch for stretch in stretches if stretch.id in allowed), None)
        if best is not None:
            rims_of[best.id, rim.leaves].append(rim)
            stretch_of[best.id] = best
    lines = _Lines(plan)
    both = {name for name, leaves in rims_of if (name, not leaves) in rims_of}
    built = (
        _joint(stretch_of[name], leaves, rims, lines, plan.lefthand, name in both)
        for (name, leaves), rims in rims_of.items()
    )
    return [joint for joint in built if joint is not None]


class _Lines:
    """Centre lines of the map's lanes and ways, to see who would be crossed."""

    def __init__(self, plan: NetPlan) -> None:
        lanes = [(edge.id, lane.shape_m) for edge in plan.edges for lane in edge.lanes]
        ways = [("", connection.shape_m) for connection in plan.connections]
        self._names = [name for name, _ in (*lanes, *ways)]
        self._lines = [LineString(line) for _, line in (*lanes, *ways)]
        self._tree = shapely.STRtree(self._lines)

    def crossed(self, line_m: FloatArray, but: Collection[str]) -> bool:
        """Return whether a line crosses any lane of the map except those of the edges *but*."""
        line = LineString(line_m)
        numbers = self._tree.query(line, predicate="intersects").tolist()
        return any(self._names[number] not in but for number in numbers)


def _joint(
    stretch: StreetStretch, leaves: bool, rims: list[RimEnd], lines: _Lines, lefthand: bool, both: bool
) -> Joint | None:
    """Return the joint of one end of *stretch*; ends of the map that no drivable way leads from are left out."""
    line = stretch.middle_m if leaves else stretch.middle_m[::-1]
    if stretch.clear_m < SHORTEST_STREET_M:
        return None
    room_m = max(stretch.clear_m - LEFT_OVER_M, 0.0) * (0.5 if both else 1.0)
    gives_way_m = float(np.clip(max(_bend_m(rim, line) for rim in rims), 0.0, room_m))
    lanes = _street_lanes(stretch, leaves, gives_way_m, lefthand)
    joined = {rim.edge.id for rim in rims}
    ways: list[JointWay] = []
    kept = []
    for rim, pairs in _paired(rims, lanes, every_street_lane=not leaves).items():
        own = [_way(rim, lane, street_lane, lanes) for lane, street_lane in pairs]
        if not any(
            turn_speed(way.shape_m) < TIGHTEST_MPS or lines.crossed(way.shape_m, joined) for way in own
        ):
            ways += own
            kept.append(rim)
    return Joint(stretch, leaves, tuple(kept), tuple(ways), gives_way_m) if kept else None


def _bend_m(rim: RimEnd, line_m: FloatArray) -> float:
    """Return how much of a street's end has to give way for a bend of :data:`RADIUS_M` from *rim* to it.

    A cubic from one straight line to another one *y* m beside it within *x* m has radius x² / 6 y at its ends.
    """
    ahead, aside = away(rim, line_m[0])
    return max(SHORTEST_M, math.sqrt(6.0 * RADIUS_M * float(aside))) - float(ahead)


@dataclass(frozen=True, eq=False)
class StreetLanes:
    """Lanes for cars at one end of a stretch: numbers, places (L, 2) and unit vector in driving direction."""

    numbers: tuple[int, ...]
    at_m: FloatArray
    along: FloatArray


def _street_lanes(stretch: StreetStretch, leaves: bool, gives_way_m: float, lefthand: bool) -> StreetLanes:
    s = gives_way_m if leaves else stretch.length_m - gives_way_m
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
    """Return for each end of the map its pairs of (position among its lanes, position among the street's).

    Lanes side by side go to lanes side by side: all are moved by the same offset, with which most lie on a lane of
    the street, and take the nearest. With *every_street_lane*, street lanes that are left take the nearest lane.
    """
    left = polyline.left_of(lanes.along)
    street = lanes.at_m @ left
    places = [(rim, k) for rim in rims for k in range(len(rim.lanes))]
    own = np.concatenate([rim.at_m @ left for rim in rims])
    shifts = (street - own[:, None]).ravel()
    gaps = np.abs(own[:, None] + shifts[:, None, None] - street)  # shift, lane, street lane
    best = shifts[np.argmin(gaps.min(axis=2).sum(axis=1) + 0.01 * np.abs(shifts))]
    gap = np.abs(own[:, None] + best - street)
    chosen = {(lane, int(gap[lane].argmin())) for lane in range(len(own))}
    if every_street_lane:
        served = {number for _, number in chosen}
        chosen |= {(int(gap[:, n].argmin()), n) for n in range(len(street)) if n not in served}
    pairs: dict[RimEnd, list[tuple[int, int]]] = {rim: [] for rim in rims}
    for lane, number in sorted(chosen):
        rim, k = places[lane]
        pairs[rim].append((k, number))
    return pairs


def _way(rim: RimEnd, lane: int, street_lane: int, lanes: StreetLanes) -> JointWay:
    """Return a way along a cubic that has the headings of both lanes at its ends."""
    ends = [(rim.at_m[lane], rim.along), (lanes.at_m[street_lane], lanes.along)]
    (start, along0), (end, along1) = ends if rim.leaves else ends[::-1]
    reach = float(np.hypot(*(end - start)))
    t = np.linspace(0.0, 1.0, CURVE_POINTS)[:, None]
    bend = (t**3 - 2.0 * t**2 + t) * along0 + (t**3 - t**2) * along1
    shape = start + (3.0 * t**2 - 2.0 * t**3) * (end - start) + reach * bend
    return JointWay(rim.edge, rim.lanes[lane], lanes.numbers[street_lane], shape)
