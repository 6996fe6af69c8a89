"""Plan a net: edges, lanes, junctions and connections with their geometry, before netconvert writes it."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeAlias

import numpy as np
import shapely
from shapely.geometry import LineString, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry
from shapely.ops import substring

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.lane_widths import width_between
from advdiff_sumo.maps.convert.layout.joints import Joints
from advdiff_sumo.maps.convert.layout.lane_paths import LaneConnection
from advdiff_sumo.maps.convert.layout.lane_segments import Piece
from advdiff_sumo.maps.convert.layout.layout_state import Layout
from advdiff_sumo.maps.convert.sources.source_map import Lamp, LaneUse, SourceLane

LATERAL_MPS2 = 2.5  # comfortable lateral acceleration, which limits the speed in a turn
SLOWEST_MPS = 3.0  # smallest speed limit in a turn
WIDEST_WAY_M = 5.0  # largest width of a connection in the shape of a junction
SLIT_M = 0.02  # half the width of the cut along a lane in the shape of a junction
LIP_M = 0.005  # overlap of a junction's shape with the beginning of a lane
COLLAR_M = 0.3  # width of junction area added around a lane that divides the junction's shape
VARIES_M = 0.2  # a width that varies by more is written as a profile
Ends: TypeAlias = tuple[str, str]  # from edge and to edge of a connection
ConnectionKey: TypeAlias = tuple[str, int, str, int]  # from edge and lane, to edge and lane of a connection


@dataclass(frozen=True, eq=False)
class Track:
    """A repaired source lane or connector with measured widths and speed limit.

    Attributes:
        lane: the source lane.
        centre_m: (N, 2) centre line.
        widths: rows (K, 2) of arc length and width in m.
        speed_mps: speed limit.
    """

    lane: SourceLane
    centre_m: FloatArray
    widths: FloatArray
    speed_mps: float

    @property
    def length_m(self) -> float:
        """Length in m."""
        return line_length_m(self.centre_m)

    @property
    def width_m(self) -> float:
        """Median width in m."""
        return width_between(self.widths, 0.0, self.length_m)


@dataclass(frozen=True, eq=False)
class LanePlan:
    """One lane of an edge.

    Attributes:
        piece: part of a source lane from which it is made.
        shape_m: (N, 2) centre line.
        width_m: median width (a SUMO lane has only one width).
        speed_mps: speed limit.
        use: which vehicles may drive on it.
        source: the same part of the source lane as text, "token:from:to".
        widths: rows (K, 2) of arc length from the lane's beginning and width in m, including both ends, linear
            between them; no rows if the width hardly varies.
        no_change_up: whether changes to the next higher index are forbidden.
        no_change_down: whether changes to the next lower index are forbidden.
        stop_offset_m: distance of the stop line before the end of the lane; 0: at its end.
    """

    piece: Piece
    shape_m: FloatArray
    width_m: float
    speed_mps: float
    use: LaneUse
    source: str
    widths: FloatArray
    no_change_up: bool = False
    no_change_down: bool = False
    stop_offset_m: float = 0.0


@dataclass(frozen=True, eq=False)
class EdgePlan:
    """An edge from junction *origin* to junction *target*; *lanes* in SUMO's order (index 0 outermost)."""

    id: str
    origin: str
    target: str
    lanes: tuple[LanePlan, ...]
    priority: int = 1

    @property
    def length_m(self) -> float:
        """Mean length of the lanes in m, which SUMO uses for all of them."""
        return float(np.mean([line_length_m(lane.shape_m) for lane in self.lanes]))


@dataclass(frozen=True, eq=False)
class ConnectionPlan:
    """A connection: the path through a junction from the end of one edge lane to the beginning of another.

    Attributes:
        origin: edge and lane at which it begins.
        target: edge and lane at which it ends.
        shape_m: (N, 2) centre line of its internal lane.
        speed_mps: speed limit.
        source: parts of source lanes that it consists of, as text.
        lane_connection: the same parts by lane number.
        passes: whether its vehicles yield to no others (SUMO's attribute ``pass``).
    """

    origin: tuple[str, int]
    target: tuple[str, int]
    shape_m: FloatArray
    speed_mps: float
    source: str
    lane_connection: LaneConnection
    passes: bool = False

    @property
    def key(self) -> ConnectionKey:
        """From edge and lane, to edge and lane."""
        return *self.origin, *self.target

    @property
    def ends(self) -> Ends:
        """From edge and to edge."""
        return self.origin[0], self.target[0]


@dataclass(frozen=True, eq=False)
class JunctionPlan:
    """A junction; *kind* is SUMO's type."""

    id: str
    xy_m: tuple[float, float]
    shape: Polygon
    kind: str


@dataclass(frozen=True)
class Ring:
    """A roundabout: the edges round its island in driving direction, and the junctions at which they begin."""

    edges: tuple[str, ...]
    junctions: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class NetPlan:
    """All parts of a net, ready to be written as plain XML.

    Attributes:
        lefthand: whether traffic keeps left.
        lane_of: the edge and lane that each piece of a source lane became.
        rings: roundabouts.
        idle_signals: names of the traffic lights that stop no lane.
        lamps: by edge, the lamps of the lights at its end, if the source lists them.
        lights: by edge, the names of these lights.
        long_conflicts: pairs of connections, by from edge and to edge, that run close to each other over a long
            distance.
    """

    edges: tuple[EdgePlan, ...]
    junctions: tuple[JunctionPlan, ...]
    connections: tuple[ConnectionPlan, ...]
    lefthand: bool
    lane_of: dict[Piece, tuple[str, int]] = field(default_factory=dict)
    rings: tuple[Ring, ...] = ()
    idle_signals: tuple[str, ...] = ()
    lamps: Mapping[str, frozenset[Lamp]] = field(default_factory=dict)
    lights: Mapping[str, frozenset[str]] = field(default_factory=dict)
    long_conflicts: frozenset[frozenset[Ends]] = frozenset()

    @cached_property
    def edge_of(self) -> dict[str, EdgePlan]:
        """Edges by id."""
        return {edge.id: edge for edge in self.edges}

    @cached_property
    def lane_points_m(self) -> FloatArray:
        """(N, 2) points of the centre lines of all edge lanes."""
        return np.vstack([lane.shape_m for edge in self.edges for lane in edge.lanes])

    @cached_property
    def connection_of(self) -> dict[ConnectionKey, ConnectionPlan]:
        """Connections by from edge and lane, to edge and lane."""
        return {connection.key: connection for connection in self.connections}


def plan_net(
    tracks: list[Track], layout: Layout, lane_connections: list[LaneConnection], lefthand: bool
) -> NetPlan:
    """Return the planned net of a layout.

    Args:
        tracks: lanes and connectors, numbered as in *layout*.
        layout: pieces and their groups.
        lane_connections: connections between pieces.
        lefthand: whether traffic keeps left; then lane 0 is the leftmost.
    """
    joints = layout.joints
    names = _junction_names(layout, joints)
    edges, lane_of = [], {}
    for number, group in enumerate(layout.groups):
        ordered = group[::-1] if lefthand else group
        edge = EdgePlan(
            f"e{number}",
            names[joints.find((group[0], 0))],
            names[joints.find((group[0], 1))],
            tuple(_lane_plan(tracks[piece.lane], piece, lefthand) for piece in ordered),
        )
        edges.append(edge)
        lane_of.update({piece: (edge.id, index) for index, piece in enumerate(ordered)})
    connections = [_connection_plan(tracks, lane_of, connection) for connection in lane_connections]
    junctions = _junctions(edges, connections)
    return NetPlan(tuple(edges), tuple(junctions), tuple(connections), lefthand, lane_of)


def _junction_names(layout: Layout, joints: Joints) -> dict[Hashable, str]:
    names: dict[Hashable, str] = {}
    for group in layout.groups:
        for side in (0, 1):
            names.setdefault(joints.find((group[0], side)), f"j{len(names)}")
    return names


def _lane_plan(track: Track, piece: Piece, lefthand: bool) -> LanePlan:
    return LanePlan(
        piece,
        polyline.cut(track.centre_m, piece.from_m, piece.to_m),
        round(width_between(track.widths, piece.from_m, piece.to_m), 2),
        track.speed_mps,
        track.lane.use,
        _source(track, piece),
        _profile(track, piece),
        track.lane.right_solid if lefthand else track.lane.left_solid,
        track.lane.left_solid if lefthand else track.lane.right_solid,
    )


def _profile(track: Track, piece: Piece) -> FloatArray:
    """Return rows (K, 2) of arc length along *piece* and width in m; no rows if the width varies little."""
    s = track.widths[:, 0]
    inside = s[(s > piece.from_m) & (s < piece.to_m)]
    if not len(inside):
        return np.empty((0, 2))
    stations = np.concatenate(([piece.from_m], inside, [piece.to_m]))
    widths = np.interp(stations, s, track.widths[:, 1])
    if float(np.ptp(widths)) <= VARIES_M:
        return np.empty((0, 2))
    return np.stack((stations - piece.from_m, widths), axis=-1)


def _source(track: Track, piece: Piece) -> str:
    return f"{track.lane.token}:{piece.from_m:.3f}:{piece.to_m:.3f}"


def _connection_plan(
    tracks: list[Track], lane_of: dict[Piece, tuple[str, int]], connection: LaneConnection
) -> ConnectionPlan:
    origin, target = connection.origin, connection.target
    parts = [polyline.cut(tracks[p.lane].centre_m, p.from_m, p.to_m) for p in connection.parts]
    if not parts:  # the lanes meet without a part between them
        end = polyline.at(tracks[origin.lane].centre_m, origin.to_m)
        start = polyline.at(tracks[target.lane].centre_m, target.from_m)
        parts = [np.stack((end, start))]
    shape = polyline.join(parts)
    limit = min([tracks[lane].speed_mps for lane in connection.lanes])
    source = " ".join(_source(tracks[part.lane], part) for part in connection.parts)
    return ConnectionPlan(
        lane_of[origin], lane_of[target], shape, min(limit, turn_speed(shape)), source, connection
    )


def turn_speed(shape_m: FloatArray) -> float:
    """Return the speed in m/s at which the sharpest 8 m of a line need the lateral acceleration ``LATERAL_MPS2``.

    It is at least ``SLOWEST_MPS``, and infinite for a straight or very short line.
    """
    total = line_length_m(shape_m)
    span = min(8.0, total)
    if span < 1.0:
        return math.inf
    s = np.linspace(0.0, total, max(2, int(total) + 1))
    yaw = np.unwrap(polyline.heading(shape_m, s))
    later = np.interp(np.minimum(s + span, total), s, yaw)
    sharpest = float(np.abs(later - yaw).max()) / span
    return math.inf if sharpest < 1e-6 else max(SLOWEST_MPS, math.sqrt(LATERAL_MPS2 / sharpest))


def _junctions(edges: list[EdgePlan], connections: list[ConnectionPlan]) -> list[JunctionPlan]:
    """Return the junctions at the ends of *edges*; those without a connection are dead ends."""
    ends: dict[str, list[FloatArray]] = defaultdict(list)
    bars: dict[str, list[Polygon]] = defaultdict(list)
    lines: dict[str, list[LineString]] = defaultdict(list)
    edge_of = {edge.id: edge for edge in edges}
    for edge in edges:
        for lane in edge.lanes:
            for name, shape in ((edge.origin, lane.shape_m), (edge.target, lane.shape_m[::-1])):
                ends[name].append(shape[0])
                bars[name].append(end_bar(shape, lane.width_m))
                lines[name].append(LineString(shape))
    inside: dict[str, list[Polygon]] = defaultdict(list)
    for connection in connections:
        origin = edge_of[connection.origin[0]]
        width = origin.lanes[connection.origin[1]].width_m
        inside[origin.target].append(way_strip(connection.shape_m, width))
    return [
        JunctionPlan(
            name,
            (float(np.mean(ends[name], axis=0)[0]), float(np.mean(ends[name], axis=0)[1])),
            junction_shape(inside[name], bars[name], lines[name]),
            "priority" if inside[name] else "dead_end",
        )
        for name in sorted(ends, key=lambda text: int(text[1:]))
    ]


def way_strip(shape_m: FloatArray, width_m: float) -> Polygon:
    """Return the area of a connection (N, 2) from a lane of this width, at most ``WIDEST_WAY_M`` wide."""
    return LineString(shape_m).buffer(0.5 * min(width_m, WIDEST_WAY_M), cap_style="flat")


def end_bar(shape_m: FloatArray, width_m: float) -> Polygon:
    """Return a strip across the beginning of a lane that covers 0.1 m of the junction and ``LIP_M`` of the lane."""
    along = polyline.direction(shape_m[1], shape_m[0])
    across = 0.5 * width_m * polyline.left_of(along)
    back, front = shape_m[0] + 0.1 * along, shape_m[0] - LIP_M * along
    return Polygon((front - across, front + across, back + across, back - across))


def junction_shape(strips: list[Polygon], bars: list[Polygon], lanes: list[LineString]) -> Polygon:
    """Return one polygon without holes that covers the connections of a junction and the ends of its lanes.

    netconvert moves the beginning of a lane to the last point where the lane crosses the shape of its junction, even
    if the lane has a shape of its own. So the polygon overlaps each beginning by millimetres only. A slit along the
    rest of the centre line prevents that the polygon crosses the lane anywhere else.

    Args:
        strips: areas of the connections.
        bars: areas across the lane ends, see :func:`end_bar`.
        lanes: centre lines of the lanes, drawn away from the junction.
    """
    whole = _closed(shapely.union_all([*strips, *bars])).union(shapely.union_all(bars))
    slits = shapely.union_all([_slit(lane) for lane in lanes])
    # If a lane divides the polygon, extend it around the far end of the lane.
    if isinstance(whole.difference(slits), MultiPolygon):
        whole = shapely.union_all([whole, *(lane.buffer(COLLAR_M) for lane in lanes)])
    parts = [part for part in shapely.get_parts(whole.difference(slits)) if part.area > 0]
    main_part = max(parts, key=lambda part: (sum(part.distance(bar) < SLIT_M for bar in bars), part.area))
    return _without_holes(main_part)


def _slit(lane: LineString) -> Polygon:
    """Return a thin strip along a lane, from ``LIP_M`` after its beginning to a little beyond its end."""
    (x0, y0), (x1, y1) = lane.coords[-2], lane.coords[-1]
    beyond = 0.5 * COLLAR_M / math.hypot(x1 - x0, y1 - y0)
    longer = LineString([*lane.coords, (x1 + beyond * (x1 - x0), y1 + beyond * (y1 - y0))])
    return substring(longer, LIP_M, longer.length).buffer(SLIT_M, cap_style="flat")


def _without_holes(polygon: Polygon) -> Polygon:
    """Return *polygon* with each hole opened to the outside by a cut of some centimetres at the narrowest place."""
    while polygon.interiors:
        cut = shapely.shortest_line(polygon.exterior, polygon.interiors[0]).buffer(SLIT_M, cap_style="square")
        polygon = max(shapely.get_parts(polygon.difference(cut)), key=lambda part: part.area)
    return polygon


def _closed(shape: BaseGeometry) -> Polygon:
    """Return *shape* as one polygon without holes: gaps between its parts are closed, else its convex hull."""
    for gap in (0.0, 0.5, 1.5, 4.0):
        closed = shape.buffer(gap, join_style="mitre").buffer(-gap, join_style="mitre") if gap else shape
        if isinstance(closed, Polygon) and not closed.is_empty:
            return Polygon(shapely.get_exterior_ring(closed.simplify(0.05)))
    return Polygon(shapely.get_exterior_ring(shape.convex_hull.buffer(0.01)))
