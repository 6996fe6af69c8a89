"""Lane sequences along a route: where each lane leads, which one to be on, what stands along it.

The lane choice follows SUMO's best-lanes idea: a lane is as good as the distance that one can follow the route
on it without changing lanes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import Polyline, kept_points
from advdiff_sumo.maps.lanes import Edge, Lane, Link

_SAME_M = 1e-6


@dataclass(frozen=True)
class LaneOutlook:
    """What a lane is good for on a route.

    Attributes:
        lane_id: the lane.
        follow_edges: how many edges of the route, its own included, can be driven without changing lanes.
        follow_m: how far that is from its start, junctions included.
        offset: lane changes to the nearest lane of its edge that can be followed farthest; positive: to the
            left; 0: stay.
        next_link: the link to take at its end; None at the route's end or when the lane leaves the route.
    """

    lane_id: str
    follow_edges: int
    follow_m: float
    offset: int
    next_link: Link | None


@dataclass(frozen=True)
class PathLink:
    """A link along a path.

    Attributes:
        s_m: where its stop line is, along the path.
        end_s_m: where the junction is left.
        link: the connection.
    """

    s_m: float
    end_s_m: float
    link: Link


@dataclass(frozen=True, eq=False)
class LanePath:
    """What one drives by staying on a lane and following the route; P points.

    Attributes:
        lane_ids: lanes in driving order, internal ones included.
        line: the joined centre line, from the start position on.
        width_m: (P,) lane width at each point of the line.
        speed_mps: (P,) speed limit.
        links: links along the path, the nearest first.
        offset: lane changes from the first lane to the one that follows the route farthest, left positive.
        reaches_m: distance after which the path must be left by a lane change (or the route ends); may lie
            beyond the horizon.
        complete: whether the route can be followed to its end without changing lanes.
    """

    lane_ids: tuple[str, ...]
    line: Polyline
    width_m: FloatArray
    speed_mps: FloatArray
    links: tuple[PathLink, ...]
    offset: int
    reaches_m: float
    complete: bool


class PathFinder:
    """Lane choice along one route for one vehicle class.

    Args:
        lanes: the map's lanes.
        edges: the map's edges.
        route: edges in driving order, no internal ones.
        vclass: vehicle class; None for any road motor vehicle.
    """

    def __init__(
        self, lanes: Mapping[str, Lane], edges: Mapping[str, Edge], route: Sequence[str], vclass: str | None
    ) -> None:
        self._lanes = lanes
        self._edges = edges
        self._route = tuple(route)
        self._vclass = vclass
        self.outlooks: tuple[Mapping[str, LaneOutlook], ...] = self._look_back()

    def _look_back(self) -> tuple[Mapping[str, LaneOutlook], ...]:
        """Return the outlook of every usable lane of every edge of the route, worked from its end."""
        tables: list[dict[str, LaneOutlook]] = []
        ahead: dict[str, LaneOutlook] | None = None
        for edge_id in reversed(self._route):
            open_lanes = [self._lanes[x] for x in self._edges[edge_id].lane_ids]
            bare = {x.id: self._outlook(x, ahead) for x in open_lanes if x.permits(self._vclass)}
            ahead = self._with_offsets(bare)
            tables.append(ahead)
        return tuple(reversed(tables))

    def _outlook(self, lane: Lane, ahead: Mapping[str, LaneOutlook] | None) -> LaneOutlook:
        onward = [link for link in lane.successors if link.to_lane in (ahead or {})]
        if ahead is None or not onward:
            return LaneOutlook(lane.id, 1, lane.length_m, 0, None)
        best = max(onward, key=lambda x: (ahead[x.to_lane].follow_edges, -abs(ahead[x.to_lane].offset)))
        then = ahead[best.to_lane]
        length = lane.length_m + sum(self._lanes[x].length_m for x in best.via) + then.follow_m
        return LaneOutlook(lane.id, 1 + then.follow_edges, length, 0, best)

    def _with_offsets(self, bare: Mapping[str, LaneOutlook]) -> dict[str, LaneOutlook]:
        farthest = max((o.follow_edges for o in bare.values()), default=0)
        good = [name for name, o in bare.items() if o.follow_edges == farthest]
        return {name: replace(o, offset=self._offset(name, good)) for name, o in bare.items()}

    def _offset(self, lane_id: str, good: Sequence[str]) -> int:
        """Return the least signed number of changes (left positive) from *lane_id* to one of *good*."""
        left, right = self._row(lane_id, left=True), self._row(lane_id, left=False)
        for steps in range(max(len(left), len(right))):
            if right[steps : steps + 1] and right[steps] in good:
                return -steps
            if left[steps : steps + 1] and left[steps] in good:
                return steps
        return 0

    def _row(self, lane_id: str, *, left: bool) -> list[str]:
        """Return *lane_id* and the lanes on one side of it, outwards."""
        row: list[str] = []
        here: str | None = lane_id
        while here is not None and here not in row:
            row.append(here)
            here = self._lanes[here].left_id if left else self._lanes[here].right_id
        return row

    def paths(self, start_lane: str, start_s_m: float, horizon_m: float) -> list[LanePath]:
        """Return the path from *start_lane*, and from each other lane of its edge, by number of changes.

        Args:
            start_lane: a lane of the route, or an internal lane between two of its edges (then one path).
            start_s_m: position on it, clamped to the lane; neighbours start beside it.
            horizon_m: length after which paths are cut.
        """
        lane = self._lanes.get(start_lane)
        if lane is None:
            return []
        if lane.is_internal:
            return self._from_internal(lane, start_s_m, horizon_m)
        if lane.edge_id not in self._route:
            return []
        number = self._route.index(lane.edge_id)
        siblings = self._edges[lane.edge_id].lane_ids
        xy = lane.line.at(start_s_m)[0]
        paths_ahead = []
        for name in sorted(siblings, key=lambda x: (abs(self._lanes[x].index - lane.index), x)):
            if name in self.outlooks[number]:
                s = float(np.clip(start_s_m, 0.0, lane.length_m)) if name == lane.id else None
                s = float(self._lanes[name].line.project(xy)[0]) if s is None else s
                paths_ahead.append(self._walk([name], number, s, horizon_m))
        return paths_ahead

    def _from_internal(self, lane: Lane, start_s_m: float, horizon_m: float) -> list[LanePath]:
        for number, outlook in enumerate(self.outlooks[1:], start=1):
            for link in lane.successors:
                if link.to_lane in outlook:
                    s = float(np.clip(start_s_m, 0.0, lane.length_m))
                    return [self._walk([lane.id, *link.via, link.to_lane], number, s, horizon_m)]
        return []

    def _walk(self, lane_ids: list[str], number: int, s_m: float, horizon_m: float) -> LanePath:
        """Follow the best links from the last of *lane_ids*, a lane of edge *number* of the route."""
        first, first_number = self.outlooks[number][lane_ids[-1]], number
        before = sum(self._lanes[x].length_m for x in lane_ids[:-1])
        length = before + self._lanes[lane_ids[-1]].length_m - s_m
        here, links = first, list[tuple[int, Link]]()
        while length < horizon_m and here.next_link is not None:
            link, number = here.next_link, number + 1
            links.append((len(lane_ids), link))
            lane_ids += [*link.via, link.to_lane]
            length += sum(self._lanes[x].length_m for x in (*link.via, link.to_lane))
            here = self.outlooks[number][link.to_lane]
        complete = first_number + first.follow_edges == len(self._route)
        return self._joined(lane_ids, links, s_m, horizon_m, first.offset, before + first.follow_m, complete)

    def _joined(
        self,
        lane_ids: Sequence[str],
        links: Sequence[tuple[int, Link]],
        s_m: float,
        horizon_m: float,
        offset: int,
        follow_m: float,
        complete: bool,
    ) -> LanePath:
        lanes = [self._lanes[x] for x in lane_ids]
        whole, starts = _joined_line(lanes)
        begin = min(s_m, whole.length_m - 0.01)
        line = whole.slice(begin, begin + max(horizon_m, 0.01))
        owner = np.clip(np.searchsorted(starts, line.s_m + begin + _SAME_M, side="right") - 1, 0, None)
        spans = [
            PathLink(float(starts[i] - begin), float(starts[i + len(link.via)] - begin), link)
            for i, link in links
        ]
        return LanePath(
            lane_ids=tuple(lane_ids),
            line=line,
            width_m=np.array([lane.width_m for lane in lanes])[owner],
            speed_mps=np.array([lane.speed_mps for lane in lanes])[owner],
            links=tuple(x for x in spans if x.s_m <= line.length_m),
            offset=offset,
            reaches_m=follow_m - s_m,
            complete=complete,
        )


def _joined_line(lanes: Sequence[Lane]) -> tuple[Polyline, FloatArray]:
    """Return the centre lines end to start as one line, and where on it each lane begins."""
    points = np.vstack([lane.centre_xy_m for lane in lanes])
    keep = kept_points(points)
    first = np.cumsum([0, *(len(lane.centre_xy_m) for lane in lanes[:-1])])
    line = Polyline.of(points[keep])
    return line, line.s_m[np.cumsum(keep)[first] - 1]
