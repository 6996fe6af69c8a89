"""Chooses lanes along a route, and builds the paths that follow it without changing lanes.

As in SUMO's best lanes, a lane is rated by the distance over which a vehicle can follow the route from it without
changing lanes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import Polyline, kept_points
from advdiff_sumo.maps.lanes import SIDES, Edge, Lane, Link, lanes_beside

_SAME_M = 1e-6  # arc lengths that differ by less are equal
_SHORTEST_M = 0.01  # length of the shortest path


@dataclass(frozen=True)
class LaneReach:
    """How far a vehicle can follow a route from a lane without changing lanes.

    Attributes:
        lane_id: the lane.
        follow_edges: number of edges of the route, that of the lane included, that it can follow.
        follow_m: the distance of that from the lane's start, junctions included.
        offset: number of lane changes to the nearest best lane of the edge, left positive. A best lane is one that
            allows the route to be followed over the most edges. 0: the lane is one of them.
        next_link: the link to take at its end; None at the route's end or if the lane leaves the route.
    """

    lane_id: str
    follow_edges: int
    follow_m: float
    offset: int
    next_link: Link | None


@dataclass(frozen=True)
class PathLink:
    """A link on a path.

    Attributes:
        s_m: arc length of its stop line on the path.
        end_s_m: arc length at which the path leaves the junction.
        link: the link.
    """

    s_m: float
    end_s_m: float
    link: Link


@dataclass(frozen=True, eq=False)
class LanePath:
    """The path of a vehicle that follows its route from a lane without changing lanes; P points.

    Attributes:
        lane_ids: lanes in driving order, internal ones included.
        line: the joined centre lines, from the start position on.
        width_m: (P,) lane width at each point of the line.
        speed_mps: (P,) speed limit at each point of the line.
        links: links on the path, the nearest first.
        offset: number of lane changes from the first lane to the nearest best one, left positive.
        lane_change_after_m: distance after which a lane change is needed to follow the route, or the route ends; may
            be greater than the length of the line.
        complete: whether the route can be followed to its end without changing lanes.
    """

    lane_ids: tuple[str, ...]
    line: Polyline
    width_m: FloatArray
    speed_mps: FloatArray
    links: tuple[PathLink, ...]
    offset: int
    lane_change_after_m: float
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
        self.reaches: tuple[Mapping[str, LaneReach], ...] = self._all_reaches()

    def _all_reaches(self) -> tuple[Mapping[str, LaneReach], ...]:
        """Return the reaches (by lane id) of the permitted lanes of each edge of the route, from its end backwards."""
        reversed_reaches: list[dict[str, LaneReach]] = []
        following: dict[str, LaneReach] | None = None
        for edge_id in reversed(self._route):
            lanes = [self._lanes[x] for x in self._edges[edge_id].lane_ids]
            reaches = {x.id: self._reach(x, following) for x in lanes if x.permits(self._vclass)}
            following = self._with_offsets(reaches)
            reversed_reaches.append(following)
        return tuple(reversed(reversed_reaches))

    def _reach(self, lane: Lane, following: Mapping[str, LaneReach] | None) -> LaneReach:
        """Return the reach of *lane*, without its offset, given those of the *following* edge of the route."""
        links = [link for link in lane.successors if link.to_lane in (following or {})]
        if following is None or not links:
            return LaneReach(lane.id, 1, lane.length_m, 0, None)
        best = max(
            links, key=lambda x: (following[x.to_lane].follow_edges, -abs(following[x.to_lane].offset))
        )
        onward = following[best.to_lane]
        length = lane.length_m + sum(self._lanes[x].length_m for x in best.via) + onward.follow_m
        return LaneReach(lane.id, 1 + onward.follow_edges, length, 0, best)

    def _with_offsets(self, reaches: Mapping[str, LaneReach]) -> dict[str, LaneReach]:
        most_edges = max((o.follow_edges for o in reaches.values()), default=0)
        best_lanes = [name for name, o in reaches.items() if o.follow_edges == most_edges]
        return {name: replace(o, offset=self._offset(name, best_lanes)) for name, o in reaches.items()}

    def _offset(self, lane_id: str, goals: Sequence[str]) -> int:
        """Return the least number of lane changes (left positive) from *lane_id* to one of the lanes *goals*."""
        left, right = (
            [lane_id, *(lane.id for lane in lanes_beside(self._lanes, lane_id, side))] for side in SIDES
        )
        for changes in range(max(len(left), len(right))):
            if right[changes : changes + 1] and right[changes] in goals:
                return -changes
            if left[changes : changes + 1] and left[changes] in goals:
                return changes
        return 0

    def paths(self, start_lane: str, start_s_m: float, horizon_m: float) -> list[LanePath]:
        """Return the paths from *start_lane* and from the other lanes of its edge, by their distance in lanes.

        Args:
            start_lane: a lane of the route, or an internal lane between two of its edges (which gives one path).
            start_s_m: arc length on it, clamped to the lane; paths from other lanes start beside it.
            horizon_m: length after which paths are cut off.
        """
        lane = self._lanes.get(start_lane)
        if lane is None:
            return []
        if lane.is_internal:
            return self._from_internal(lane, start_s_m, horizon_m)
        if lane.edge_id not in self._route:
            return []
        number = self._route.index(lane.edge_id)
        parallel_lanes = self._edges[lane.edge_id].lane_ids
        xy = lane.line.at(start_s_m)[0]
        paths = []
        for name in sorted(parallel_lanes, key=lambda x: (abs(self._lanes[x].index - lane.index), x)):
            if name in self.reaches[number]:
                s = float(np.clip(start_s_m, 0.0, lane.length_m)) if name == lane.id else None
                s = float(self._lanes[name].line.project(xy)[0]) if s is None else s
                paths.append(self._path([name], number, s, horizon_m))
        return paths

    def _from_internal(self, lane: Lane, start_s_m: float, horizon_m: float) -> list[LanePath]:
        for number, edge_reaches in enumerate(self.reaches[1:], start=1):
            for link in lane.successors:
                if link.to_lane in edge_reaches:
                    s = float(np.clip(start_s_m, 0.0, lane.length_m))
                    return [self._path([lane.id, *link.via, link.to_lane], number, s, horizon_m)]
        return []

    def _path(self, lane_ids: list[str], number: int, s_m: float, horizon_m: float) -> LanePath:
        """Return the path that starts with *lane_ids*, the last of which lies on edge *number* of the route.

        *s_m* is the start, from the beginning of the first of these lanes.
        """
        first, first_number = self.reaches[number][lane_ids[-1]], number
        internal_m = sum(self._lanes[x].length_m for x in lane_ids[:-1])
        length_m = internal_m + self._lanes[lane_ids[-1]].length_m - s_m
        reach, links = first, list[tuple[int, Link]]()
        while length_m < horizon_m and reach.next_link is not None:
            link, number = reach.next_link, number + 1
            links.append((len(lane_ids), link))
            lane_ids += [*link.via, link.to_lane]
            length_m += sum(self._lanes[x].length_m for x in (*link.via, link.to_lane))
            reach = self.reaches[number][link.to_lane]
        complete = first_number + first.follow_edges == len(self._route)
        follow_m = internal_m + first.follow_m
        return self._joined(lane_ids, links, s_m, horizon_m, first.offset, follow_m, complete)

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
        """Return the path over *lane_ids*; *links* holds each link with the row of its first lane in *lane_ids*."""
        lanes = [self._lanes[x] for x in lane_ids]
        whole_line, lane_s_m = _joined_line(lanes)
        start_s_m = min(s_m, whole_line.length_m - _SHORTEST_M)
        line = whole_line.slice(start_s_m, start_s_m + max(horizon_m, _SHORTEST_M))
        lane_row = np.searchsorted(lane_s_m, line.s_m + start_s_m + _SAME_M, side="right") - 1
        lane_row = np.clip(lane_row, 0, None)
        path_links = [
            PathLink(float(lane_s_m[i] - start_s_m), float(lane_s_m[i + len(link.via)] - start_s_m), link)
            for i, link in links
        ]
        return LanePath(
            lane_ids=tuple(lane_ids),
            line=line,
            width_m=np.array([lane.width_m for lane in lanes])[lane_row],
            speed_mps=np.array([lane.speed_mps for lane in lanes])[lane_row],
            links=tuple(x for x in path_links if x.s_m <= line.length_m),
            offset=offset,
            lane_change_after_m=follow_m - s_m,
            complete=complete,
        )


def _joined_line(lanes: Sequence[Lane]) -> tuple[Polyline, FloatArray]:
    """Return the joined centre lines of L consecutive lanes, and the arc length (L,) at which each lane begins."""
    points = np.vstack([lane.centre_xy_m for lane in lanes])
    keep = kept_points(points)
    first_row = np.cumsum([0, *(len(lane.centre_xy_m) for lane in lanes[:-1])])
    line = Polyline.of(points[keep])
    return line, line.s_m[np.cumsum(keep)[first_row] - 1]
