"""The road map that the whole package uses: a SUMO net with its drivable area."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property, lru_cache, partial
from pathlib import Path

import numpy as np
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.errors import NetError
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.map_view import MapView
from advdiff_sumo.maps.build_graph import LaneGraph, build_graph
from advdiff_sumo.maps.drivable import DrivableArea, area_of_lanes
from advdiff_sumo.maps.geo import Projection
from advdiff_sumo.maps.lanes import Edge, Junction, Lane, LanePose, Link
from advdiff_sumo.maps.legal_limits import legal_limits_mps
from advdiff_sumo.maps.locate import LaneIndex, poses_of
from advdiff_sumo.maps.matching import RouteMatcher
from advdiff_sumo.maps.paths import LanePath, PathFinder
from advdiff_sumo.maps.read_net import RawNet, base_name, read_raw_net
from advdiff_sumo.maps.routing import EdgeGraph
from advdiff_sumo.maps.sidecar import read_sidecar, sidecar_of
from advdiff_sumo.maps.vector_map import PieceTable, build_pieces

MAX_LANE_DISTANCE_M = 5.0
"""Default of :meth:`RoadMap.locate` for the largest distance of a centre line."""
_KEPT_FINDERS = 256
"""Number of path finders that are cached, one for each route and vehicle class."""


class RoadMap:
    """Lanes, links, junctions, areas and routes of one SUMO net; treat it as immutable.

    Build it with :meth:`read`. Indices and areas are built on first use and cached. Coordinates are in metres in the
    net's frame (x east, y north), headings in radians counter-clockwise from east.

    Attributes:
        path: file of the net.
        name: its name without suffixes.
        lefthand: whether traffic keeps left.
        lanes: lane id → lane, internal lanes included.
        edges: edge id → edge.
        junctions: junction id → junction.
        links: (lane before the junction, lane after it) → link.
        beyond_rim: edges beyond the rim of a clipped map; the other attributes do not contain them.
        pedestrian_shapes: id → shape (K, 2): the centre line of a crossing, the outline of a walking area.
        projection: the net's place on earth.
    """

    def __init__(self, raw: RawNet, graph: LaneGraph, drivable: BaseGeometry | None) -> None:
        self.path: Path = raw.path
        self.name: str = base_name(raw.path)
        self.lefthand: bool = raw.lefthand
        self.lanes: Mapping[str, Lane] = graph.lanes
        self.edges: Mapping[str, Edge] = graph.edges
        self.junctions: Mapping[str, Junction] = graph.junctions
        self.links: Mapping[tuple[str, str], Link] = graph.links
        self.beyond_rim: frozenset[str] = raw.beyond_rim
        self.pedestrian_shapes: Mapping[str, FloatArray] = raw.pedestrian_shapes
        self.projection = Projection(raw.location)
        self._graph = graph
        self._given_area = drivable
        self._edge_graphs: dict[str | None, EdgeGraph] = {}
        self._allowed: dict[str | None, BoolArray] = {}
        self._matchers: dict[str | None, RouteMatcher] = {}
        self._path_finder = lru_cache(maxsize=_KEPT_FINDERS)(partial(PathFinder, self.lanes, self.edges))
        self._piece_tables: dict[MapView, PieceTable] = {}

    @classmethod
    def read(cls, net_path: str | Path, sidecar: str | Path | None = None) -> RoadMap:
        """Read the net at *net_path*, gzipped or not.

        Args:
            net_path: a SUMO net.
            sidecar: file with its drivable area; by default NAME.poly.xml beside NAME.net.xml, if that exists.
                Without a side-car the area is the union of lanes and junctions.

        Raises:
            NetError: a file is missing, truncated or of a wrong kind, or no lane is open to motor vehicles.
        """
        path = Path(net_path)
        raw = read_raw_net(path)
        graph = build_graph(raw)
        area_path = Path(sidecar) if sidecar is not None else sidecar_of(path)
        area = read_sidecar(area_path) if area_path is not None else None
        if sidecar is not None and area is None:
            raise NetError(Path(sidecar), "holds no polygon of type 'drivable_area'")
        return cls(raw, graph, area)

    def __repr__(self) -> str:
        return f"RoadMap({self.name!r}, {len(self.edges)} edges, {len(self.lanes)} lanes)"

    # --- extent and area ---------------------------------------------------------------------------------

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """(xmin, ymin, xmax, ymax) of the drivable area."""
        x0, y0, x1, y1 = self.drivable.bounds
        return float(x0), float(y0), float(x1), float(y1)

    @cached_property
    def area(self) -> DrivableArea:
        """The drivable area with its spatial indices."""
        sidecar_area = self._given_area
        area = area_of_lanes(self.lanes.values(), self.junctions) if sidecar_area is None else sidecar_area
        return DrivableArea(area)

    @property
    def drivable(self) -> BaseGeometry:
        """The drivable area as a prepared shapely (multi)polygon."""
        return self.area.geometry

    def covers(self, xy_m: FloatArray) -> BoolArray:
        """Return (…) whether points (…, 2) lie in the drivable area; False for NaN."""
        return self.area.covers(np.asarray(xy_m, dtype=np.float64))

    def off_road_share(self, corners_m: FloatArray) -> FloatArray:
        """Return the share (N,), 0 to 1, of each box (N, 4, 2) that is off the drivable area; NaN for NaN."""
        return self.area.off_road_share(np.asarray(corners_m, dtype=np.float64))

    def drivable_edge_distance(self, xy_m: FloatArray) -> FloatArray:
        """Return the distance (N,) in metres of points (N, 2) from the road's edge, positive on the road."""
        return self.area.edge_distance_m(np.asarray(xy_m, dtype=np.float64))

    def lonlat(self, xy_m: FloatArray) -> FloatArray | None:
        """Return longitude and latitude (…, 2) in degrees; None if the net has no projection."""
        return self.projection.lonlat(xy_m)

    # --- lanes near poses --------------------------------------------------------------------------------

    @cached_property
    def index(self) -> LaneIndex:
        """Spatial index of all lanes."""
        return LaneIndex(self.lanes)

    def near(self, xy_m: FloatArray, radius_m: float = 30.0) -> list[LanePose]:
        """Return the nearest position on every lane within *radius_m* of a point (2,), the nearest lane first.

        Heading errors are 0. Lanes closed to all motor vehicles are left out.
        """
        candidates = self.index.candidates(_row(xy_m), radius_m)
        candidates = candidates.rows(self._open_to(None)[candidates.lane])
        return poses_of(self.index, candidates.rows(np.argsort(np.abs(candidates.d_m), kind="stable")), None)

    def locate(
        self,
        xy_m: FloatArray,
        yaw_rad: float | None = None,
        *,
        vclass: str | None = None,
        max_distance_m: float = MAX_LANE_DISTANCE_M,
        route: Sequence[str] | None = None,
        internal: bool = True,
    ) -> LanePose | None:
        """Return the most likely lane of a pose and the position on it; None if no lane is near.

        Args:
            xy_m: (2,) point; for a vehicle the centre of its box.
            yaw_rad: its heading, which is compared with the lane's; None: only the distance counts.
            vclass: only lanes open to this class; None: to any road motor vehicle.
            max_distance_m: largest distance of a centre line.
            route: edges that are preferred, with the internal lanes between them; None: no preference.
            internal: whether internal lanes may be returned.
        """
        yaw = None if yaw_rad is None else np.array([yaw_rad], dtype=np.float64)
        on_route = None if route is None else self.index.route_mask(route)
        allowed = self._open_to(vclass)
        allowed = allowed if internal else allowed & ~self.index.is_internal
        best = self.index.best(_row(xy_m), yaw, max_distance_m, allowed, on_route)
        poses = poses_of(self.index, best, yaw)
        return poses[0] if poses else None

    def locate_many(
        self,
        xy_m: FloatArray,
        yaw_rad: FloatArray | None = None,
        *,
        vclass: str | None = None,
        max_distance_m: float = MAX_LANE_DISTANCE_M,
        route: Sequence[str] | None = None,
    ) -> tuple[list[str | None], FloatArray, FloatArray, FloatArray]:
        """Locate N poses at once.

        Args:
            xy_m: (N, 2) points.
            yaw_rad: (N,) headings or None.
            vclass: as in :meth:`locate`.
            max_distance_m: as in :meth:`locate`.
            route: as in :meth:`locate`.

        Returns:
            N lane ids, arc lengths (N,), lateral offsets (N,) and heading errors (N,); None and NaN if no lane is near.
        """
        xy = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
        yaw = None if yaw_rad is None else np.asarray(yaw_rad, dtype=np.float64)
        on_route = None if route is None else self.index.route_mask(route)
        best = self.index.best(xy, yaw, max_distance_m, self._open_to(vclass), on_route)
        ids: list[str | None] = [None] * len(xy)
        s, d, error = (np.full(len(xy), np.nan) for _ in range(3))
        for point, lane in zip(best.point, best.lane, strict=True):
            ids[point] = self.index.lane_ids[lane]
        s[best.point], d[best.point] = best.s_m, best.d_m
        error[best.point] = 0.0 if yaw is None else wrap_angle(yaw[best.point] - best.yaw_rad)
        return ids, s, d, error

    def on_lane(self, xy_m: FloatArray, yaw_rad: FloatArray) -> BoolArray:
        """Return (N,) whether poses (N, 2), (N,) are within the width of the lane that :meth:`locate_many` returns."""
        return self.index.on_lane(xy_m, yaw_rad, MAX_LANE_DISTANCE_M, self._open_to(None))

    def to_world(
        self, lane_id: str, s_m: FloatArray | float, d_m: FloatArray | float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Return points (…, 2) and headings (…,) at arc lengths *s_m* on a lane, offset by *d_m* to its left.

        *s_m* is clamped to the lane. On a straight segment this is the exact inverse of :meth:`locate`. At a corner of
        the centre line, the normal of the next segment is used.
        """
        return self.lanes[lane_id].line.at(s_m, d_m)

    def _open_to(self, vclass: str | None) -> BoolArray:
        if vclass not in self._allowed:
            self._allowed[vclass] = self.index.permits(vclass)
        return self._allowed[vclass]

    @cached_property
    def legal_limits_mps(self) -> Mapping[str, float]:
        """Lane id → legal speed limit; on a junction, at least that of the lanes before and after it."""
        return legal_limits_mps(self.lanes, self.links.values())

    # --- routes ------------------------------------------------------------------------------------------

    def edge_graph(self, vclass: str | None = "passenger") -> EdgeGraph:
        """Return the graph of edges that *vclass* may use (None: that any road motor vehicle may use)."""
        if vclass not in self._edge_graphs:
            self._edge_graphs[vclass] = EdgeGraph.of(self._graph, vclass)
        return self._edge_graphs[vclass]

    @cached_property
    def link_of_internal_lane(self) -> Mapping[str, Link]:
        """Internal lane id → the link that it is part of."""
        return {lane: link for link in self.links.values() for lane in link.via}

    def yields_to(self, link: Link) -> frozenset[int]:
        """Return the requests that traffic on *link* must yield to by the right-of-way matrix, signals ignored."""
        junction = self.junctions.get(link.junction_id)
        return frozenset() if junction is None else junction.yields_to(link)

    def foes_of(self, link: Link) -> frozenset[int]:
        """Return the requests whose paths cross that of *link* or merge with it, by the right-of-way matrix."""
        junction = self.junctions.get(link.junction_id)
        return frozenset() if junction is None else junction.foes.get(link.request_index, frozenset())

    def must_yield(self, link: Link, other: Link) -> bool:
        """Return whether traffic on *link* must yield to traffic on *other*; False for links of different junctions."""
        return link.junction_id == other.junction_id and other.request_index in self.yields_to(link)

    def route(self, from_edge: str, to_edge: str, vclass: str = "passenger") -> tuple[str, ...] | None:
        """Return the fastest route at the speed limits, with both edges; None if there is no route."""
        return self.edge_graph(vclass).fastest(from_edge, to_edge)

    def random_route(
        self, from_edge: str, min_length_m: float, rng: np.random.Generator, vclass: str = "passenger"
    ) -> tuple[str, ...]:
        """Return a random route from *from_edge* that ends at least *min_length_m* beyond it, or at a dead end.

        It is drawn from *rng* only. Returns () if *vclass* may not use *from_edge*.
        """
        return self.edge_graph(vclass).random(from_edge, min_length_m, rng)

    def match_route(
        self, xy_m: FloatArray, yaw_rad: FloatArray, vclass: str | None = None
    ) -> tuple[str, ...] | None:
        """Return the edges that a trajectory drove along, without internal ones; None if it is not on a road.

        Args:
            xy_m: (T, 2) positions in time order; rows with NaN are skipped.
            yaw_rad: (T,) headings.
            vclass: only lanes open to this class; None: to any road motor vehicle.
        """
        if vclass not in self._matchers:
            self._matchers[vclass] = RouteMatcher(self._graph, self.index, self._open_to(vclass))
        xy = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
        return self._matchers[vclass].match(xy, np.asarray(yaw_rad, dtype=np.float64).reshape(-1))

    def lane_path(
        self,
        route: Sequence[str],
        start_lane: str,
        horizon_m: float,
        *,
        start_s_m: float = 0.0,
        vclass: str | None = "passenger",
    ) -> list[LanePath]:
        """Return the paths along *route* without lane changes, from *start_lane* and from the lanes parallel to it.

        The first path is that of *start_lane* itself. Returns [] if *start_lane* is not on the route.

        Args:
            route: edges from the present one on, without internal ones.
            start_lane: lane of the route, or an internal lane between two of its edges.
            horizon_m: length after which paths are cut off.
            start_s_m: arc length on the lane at which the paths begin.
            vclass: vehicle class.

        Raises:
            KeyError: the route contains an edge that the net does not have.
        """
        return self._path_finder(tuple(route), vclass).paths(start_lane, start_s_m, horizon_m)

    # --- pieces ------------------------------------------------------------------------------------------

    def pieces(self, view: MapView = "near") -> PieceTable:
        """Return the map pieces for learned models that use this *view*; built on first use."""
        if view not in self._piece_tables:
            rings, links = self.area.smooth_rings(), self.links.values()
            self._piece_tables[view] = build_pieces(
                self.lanes, links, self.junctions, rings, self.lefthand, view
            )
        return self._piece_tables[view]

    def edge_of(self, lane_id: str) -> str:
        """Return the edge of a lane; for an internal lane, the edge that it leads to."""
        lane = self.lanes[lane_id]
        while lane.is_internal and lane.successors:
            lane = self.lanes[lane.successors[0].to_lane]
        return lane.edge_id

    # --- fringe ------------------------------------------------------------------------------------------

    def source_edges(self) -> tuple[str, ...]:
        """Return the edges at which traffic enters the net."""
        return self.edge_graph().sources()


def _row(xy_m: FloatArray) -> FloatArray:
    return np.asarray(xy_m, dtype=np.float64).reshape(1, 2)
