"""Find the exits and entries at the rim of an HD map, and the streets that fit them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from shapely.geometry import LineString
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.netplan import EdgePlan, NetPlan
from advdiff_sumo.maps.convert.osm.cut_streets import StreetStretch
from advdiff_sumo.maps.convert.sources.source_map import LaneUse

# A street fits an exit if it begins at most BEHIND_M before and AHEAD_M beyond it; an entry likewise.
BEHIND_M = 1.0
AHEAD_M = 30.0  # without the part of the gap on the map's own area, where streets are cut away
FARTHEST_M = 100.0  # the same limit including that part
ASIDE_M = 7.0  # largest lateral offset; OpenStreetMap and HD maps differ by at most 5.3 m
TURNED_RAD = math.radians(35.0)  # largest difference of heading
HEADING_M = 2.0  # length over which the heading of a lane is measured


@dataclass(frozen=True, eq=False)
class RimEnd:
    """An exit or entry of the map.

    Attributes:
        edge: the edge there.
        is_exit: whether it is an exit: the edge leads out of the map.
        lanes: indices of its lanes for cars.
        at_m: (L, 2) end points of these lanes at the rim.
        along: (2,) unit vector of their mean driving direction there.
    """

    edge: EdgePlan
    is_exit: bool
    lanes: tuple[int, ...]
    at_m: FloatArray
    along: FloatArray

    @property
    def node(self) -> str:
        """Name of the junction there."""
        return self.edge.target if self.is_exit else self.edge.origin


def rim_ends(plan: NetPlan) -> list[RimEnd]:
    """Return the exits and entries of the map: ends of edges with lanes for cars, at junctions without connections."""
    inner = {plan.edge_of[connection.origin[0]].target for connection in plan.connections}
    return [
        end
        for edge in plan.edges
        for is_exit in (True, False)
        if (edge.target if is_exit else edge.origin) not in inner
        and (end := _rim_end(edge, is_exit)) is not None
    ]


def _rim_end(edge: EdgePlan, is_exit: bool) -> RimEnd | None:
    lanes = tuple(index for index, lane in enumerate(edge.lanes) if lane.use is LaneUse.CAR)
    if not lanes:
        return None
    ends, directions = [], []
    for index in lanes:
        line = edge.lanes[index].shape_m
        length = line_length_m(line)
        span = (max(length - HEADING_M, 0.0), length) if is_exit else (0.0, min(HEADING_M, length))
        before, after = polyline.at(line, np.array(span))
        ends.append(after if is_exit else before)
        directions.append(polyline.direction(before, after))
    along = polyline.direction(np.zeros(2), np.mean(directions, axis=0))
    return RimEnd(edge, is_exit, lanes, np.array(ends), along)


def candidates(
    rims: Sequence[RimEnd], stretches: Sequence[StreetStretch], area: BaseGeometry
) -> dict[RimEnd, list[StreetStretch]]:
    """Return the stretches that fit each exit or entry of the map with this *area*, best first."""
    fits: dict[RimEnd, list[StreetStretch]] = {}
    for is_exit in (True, False):
        open_ends = [s for s in stretches if (s.begins_open if is_exit else s.ends_open)]
        if not open_ends:
            continue
        at = np.array([s.middle_m[0 if is_exit else -1] for s in open_ends])
        along = np.array([s.directions[0 if is_exit else 1] for s in open_ends])
        for rim in rims:
            if rim.is_exit is is_exit:
                cost = _misfits_m(rim, at, along, area)
                fits[rim] = [open_ends[k] for k in np.argsort(cost, kind="stable") if np.isfinite(cost[k])]
    return fits


def _misfits_m(rim: RimEnd, at_m: FloatArray, along: FloatArray, area: BaseGeometry) -> FloatArray:
    """Return the misfit (S,) in m of street ends to *rim*; infinite if they do not fit.

    Args:
        rim: an exit or entry of the map.
        at_m: (S, 2) ends of streets.
        along: (S, 2) unit vectors of their directions.
        area: area of the map.
    """
    ahead, aside = rim_offsets_m(rim, at_m)
    turned = np.arccos(np.clip(along @ rim.along, -1.0, 1.0))
    fits = (ahead > -BEHIND_M) & (ahead < FARTHEST_M) & (aside < ASIDE_M) & (turned < TURNED_RAD)
    for row in np.flatnonzero(fits & (ahead > AHEAD_M)).tolist():
        gap = LineString((rim.at_m.mean(axis=0), at_m[row]))
        fits[row] = gap.difference(area).length < AHEAD_M
    return np.where(fits, aside + 0.3 * np.maximum(ahead, 0.0) + 5.0 * turned, np.inf)


def rim_offsets_m(rim: RimEnd, at_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the longitudinal offsets (…) of points (…, 2) beyond *rim*, away from the map, and the lateral ones."""
    step = (at_m - rim.at_m.mean(axis=0)) * (1.0 if rim.is_exit else -1.0)
    return np.asarray(step @ rim.along), np.abs(step @ polyline.left_of(rim.along))
