"""Where the lanes of an HD map lead out of it and into it, and which streets fit there."""

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

BEHIND_M, AHEAD_M = (
    1.0,
    30.0,
)  # a street begins so far beyond the end of a lane, or ends before its beginning,
FARTHEST_M = 100.0  # what of that way lies on the map's own area, where streets are cut away, not counted
ASIDE_M = 7.0  # and lies so far beside it at most: OpenStreetMap and HD maps differ by 5.3 m at worst
TURNED_RAD = math.radians(35.0)
HEADING_M = 2.0  # over which the heading of a lane is taken


@dataclass(frozen=True, eq=False)
class RimEnd:
    """Where the map ends or begins.

    Attributes:
        edge: the edge there.
        leaves: whether the map ends there.
        lanes: numbers of its lanes for cars.
        at_m: (L, 2) ends of these.
        along: (2,) unit vector of their mean direction.
    """

    edge: EdgePlan
    leaves: bool
    lanes: tuple[int, ...]
    at_m: FloatArray
    along: FloatArray

    @property
    def node(self) -> str:
        """Junction there."""
        return self.edge.target if self.leaves else self.edge.origin


def rim_ends(plan: NetPlan) -> list[RimEnd]:
    """Return where lanes for cars lead out of the map or into it, at junctions without any connection."""
    edges = {edge.id: edge for edge in plan.edges}
    inner = {edges[connection.origin[0]].target for connection in plan.connections}
    return [
        end
        for edge in plan.edges
        for leaves in (True, False)
        if (edge.target if leaves else edge.origin) not in inner
        and (end := _rim_end(edge, leaves)) is not None
    ]


def _rim_end(edge: EdgePlan, leaves: bool) -> RimEnd | None:
    lanes = tuple(index for index, lane in enumerate(edge.lanes) if lane.use is LaneUse.CAR)
    if not lanes:
        return None
    ends, directions = [], []
    for index in lanes:
        line = edge.lanes[index].shape_m
        length = line_length_m(line)
        span = (max(length - HEADING_M, 0.0), length) if leaves else (0.0, min(HEADING_M, length))
        before, after = polyline.at(line, np.array(span))
        ends.append(after if leaves else before)
        directions.append(polyline.direction(before, after))
    along = polyline.direction(np.zeros(2), np.mean(directions, axis=0))
    return RimEnd(edge, leaves, lanes, np.array(ends), along)


def candidates(
    rims: Sequence[RimEnd], stretches: Sequence[StreetStretch], area: BaseGeometry
) -> dict[RimEnd, list[StreetStretch]]:
    """Return the stretches that fit to each end of the map of this *area*, best first."""
    fits: dict[RimEnd, list[StreetStretch]] = {}
    for leaves in (True, False):
        open_ends = [s for s in stretches if (s.begins_open if leaves else s.ends_open)]
        if not open_ends:
            continue
        at = np.array([s.middle_m[0 if leaves else -1] for s in open_ends])
        along = np.array([s.directions[0 if leaves else 1] for s in open_ends])
        for rim in rims:
            if rim.leaves is leaves:
                cost = _misfit(rim, at, along, area)
                fits[rim] = [open_ends[k] for k in np.argsort(cost, kind="stable") if np.isfinite(cost[k])]
    return fits


def _misfit(rim: RimEnd, at_m: FloatArray, along: FloatArray, area: BaseGeometry) -> FloatArray:
    """Return how badly ends of streets (S, 2) of directions (S, 2) fit, in m; infinite where they do not."""
    ahead, aside = away(rim, at_m)
    turned = np.arccos(np.clip(along @ rim.along, -1.0, 1.0))
    fits = (ahead > -BEHIND_M) & (ahead < FARTHEST_M) & (aside < ASIDE_M) & (turned < TURNED_RAD)
    for far in np.flatnonzero(fits & (ahead > AHEAD_M)).tolist():
        gap = LineString((rim.at_m.mean(axis=0), at_m[far]))
        fits[far] = gap.difference(area).length < AHEAD_M
    return np.where(fits, aside + 0.3 * np.maximum(ahead, 0.0) + 5.0 * turned, np.inf)


def away(rim: RimEnd, at_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far places (…, 2) lie beyond an end of the map, and beside it."""
    step = (at_m - rim.at_m.mean(axis=0)) * (1.0 if rim.leaves else -1.0)
    return np.asarray(step @ rim.along), np.abs(step @ polyline.left_of(rim.along))
