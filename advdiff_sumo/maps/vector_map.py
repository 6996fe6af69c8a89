"""Cuts the map into short pieces with features for learned models, and selects those near each agent."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray, read_only
from advdiff_sumo.core.map_view import MAP_PIECES, MapView
from advdiff_sumo.core.polylines import Polyline, without_repeats
from advdiff_sumo.core.signal_letters import GREEN, RED, YELLOW
from advdiff_sumo.maps.lanes import Junction, Lane, Link

POINTS = 6
"""N: points of a piece."""
PIECE_M = 20.0
"""Length limit of lane pieces at low speed limits; longer lines are cut into equal parts."""
_SHORTEST_M = 0.05  # shorter lines are left out
# "R" and "U" occur in other sources; SUMO does not write them
_SIGNAL_CODES = dict.fromkeys(RED | {"R", "U"}, 1) | dict.fromkeys(YELLOW, 2) | dict.fromkeys(GREEN, 3)


@dataclass(frozen=True)
class ViewLimits:
    """Limits of a map view: which pieces an agent sees, and how long they are.

    Attributes:
        lanes: maximum number of lane pieces.
        edges: maximum number of road-edge pieces.
        radius_m: reach of a standing agent; a piece is seen if one of its points is within reach.
        reach_s: the reach grows by the distance driven in this time at the agent's speed.
        narrow_m: pieces are ranked as if distances ahead were scaled from the reach to this length.
        piece_s: length limit of lane pieces in seconds at the lane's speed limit; at least ``PIECE_M``.
        edge_piece_m: length limit of road-edge pieces.
    """

    lanes: int
    edges: int
    radius_m: float
    reach_s: float
    narrow_m: float
    piece_s: float
    edge_piece_m: float

    @property
    def pieces(self) -> int:
        """K: maximum number of pieces that an agent sees."""
        return self.lanes + self.edges


VIEWS: Mapping[MapView, ViewLimits] = {
    "near": ViewLimits(*MAP_PIECES["near"], 60.0, 0.0, 24.0, 0.0, PIECE_M),
    "far": ViewLimits(*MAP_PIECES["far"], 60.0, 6.5, 24.0, 2.0, 40.0),
}


class Feature(IntEnum):
    """Columns of :attr:`PieceTable.features`, in SI units and not normalised."""

    WIDTH_M = 0
    SPEED_MPS = 1
    IS_LANE = 2
    IS_INTERNAL = 3
    IS_ROAD_EDGE = 4
    YIELDS = 5
    TURN = 6
    STOP_SIGN = 7
    FOR_CARS = 8
    RESERVED = 9


@dataclass(frozen=True)
class PieceTable:
    """All pieces of one map: M pieces of N points, G signalled links; lanes come before road edges.

    Attributes:
        xy_m: (M, N, 2) evenly spaced points in driving direction; a road edge has the road on its left.
        features: (M, F) values in the order of :class:`Feature`.
        signal: (M,) index into :attr:`signal_links`; −1 for pieces without a signal.
        signal_links: G pairs of a traffic light id and an index in its state string.
        limits: limits of the view for which the map was cut.
    """

    xy_m: FloatArray
    features: FloatArray
    signal: IntArray
    signal_links: tuple[tuple[str, int], ...]
    limits: ViewLimits = VIEWS["near"]

    def __post_init__(self) -> None:
        for array in (self.xy_m, self.features, self.signal):
            read_only(array)

    def rows_near(self, xy_m: FloatArray, yaw_rad: FloatArray, speed_mps: FloatArray) -> NDArray[np.int32]:
        """Return the rows (S, K) of the pieces that S agents see, padded with −1.

        The first columns hold lanes, the others road edges, each the nearest first. Pieces ahead are ranked as nearer
        than they are, so that a driver in a dense junction still sees the lane that it will be on in 6 s.

        Args:
            xy_m: (S, 2) positions.
            yaw_rad: (S,) headings.
            speed_mps: (S,) speeds.
        """
        xy, yaw = np.asarray(xy_m, dtype=np.float64), np.asarray(yaw_rad, dtype=np.float64)
        limits = self.limits
        reach = limits.radius_m + limits.reach_s * np.maximum(np.asarray(speed_mps, dtype=np.float64), 0.0)
        rows = np.full((len(xy), limits.pieces), -1, dtype=np.int32)
        if len(xy):
            self._fill(rows[:, : limits.lanes], self._lanes, xy, yaw, reach)
            self._fill(rows[:, limits.lanes :], self._edges, xy, yaw, reach)
        return rows

    def signal_states(self, signals: Mapping[str, str]) -> NDArray[np.uint8]:
        """Return the state (G,) of each signalled link: 0 unknown or off, 1 red, 2 yellow, 3 green.

        Args:
            signals: traffic light id → its state string as SUMO writes it.
        """
        states = np.zeros(len(self.signal_links), dtype=np.uint8)
        for row, (tls_id, index) in enumerate(self.signal_links):
            state = signals.get(tls_id, "")
            states[row] = _SIGNAL_CODES.get(state[index], 0) if index < len(state) else 0
        return states

    @cached_property
    def _lanes(self) -> _Search:
        return _Search.of(self.xy_m, self.features[:, Feature.IS_LANE] > 0.0)

    @cached_property
    def _edges(self) -> _Search:
        return _Search.of(self.xy_m, self.features[:, Feature.IS_ROAD_EDGE] > 0.0)

    def _fill(
        self, columns: NDArray[np.int32], search: _Search, xy: FloatArray, yaw: FloatArray, reach: FloatArray
    ) -> None:
        """Write the rows of the best-ranked pieces of *search* within *reach* (S,) into *columns* (S, k)."""
        agent, piece = search.candidates(xy, reach)
        shrunk = self.limits.narrow_m / reach
        ahead = np.stack((np.cos(yaw), np.sin(yaw)))
        distance, cost = _distances(self.xy_m[piece], xy[agent], ahead[:, agent], shrunk[agent])
        is_near = distance <= reach[agent]
        agent, piece, cost = agent[is_near], piece[is_near], cost[is_near]
        order = np.lexsort((piece, cost, agent))
        agent, piece = agent[order], piece[order]
        rank = np.arange(len(agent)) - np.searchsorted(agent, agent)
        is_kept = rank < columns.shape[1]
        columns[agent[is_kept], rank[is_kept]] = piece[is_kept]


@dataclass(frozen=True)
class _Search:
    """A search tree over the centres of the pieces *rows*, whose points are within *reach_m* of the centres."""

    rows: IntArray
    reach_m: float
    tree: cKDTree | None

    @staticmethod
    def of(xy_m: FloatArray, is_included: BoolArray) -> _Search:
        rows = np.flatnonzero(is_included)
        if len(rows) == 0:
            return _Search(rows, 0.0, None)
        points = xy_m[rows]
        centre = 0.5 * (points.min(axis=1) + points.max(axis=1))
        reach = float(np.linalg.norm(points - centre[:, None], axis=-1).max())
        return _Search(rows, reach, cKDTree(centre))

    def candidates(self, xy_m: FloatArray, reach_m: FloatArray) -> tuple[IntArray, IntArray]:
        """Return pairs (C,), (C,) of an agent and a piece that may be within its reach."""
        empty = np.zeros(0, dtype=np.int64)
        if self.tree is None:
            return empty, empty
        nearby = self.tree.query_ball_point(xy_m, reach_m + self.reach_m, return_sorted=False)
        counts = np.array([len(rows) for rows in nearby])
        if counts.sum() == 0:
            return empty, empty
        pieces = np.fromiter(chain.from_iterable(nearby), np.int64, counts.sum())
        return np.repeat(np.arange(len(xy_m)), counts), self.rows[pieces]


def _distances(
    points: FloatArray, xy: FloatArray, ahead: FloatArray, shrunk: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the distance (C,) and the ranking distance (C,) of C pairs of an agent and a piece.

    In the ranking distance, the component ahead of the agent is shortened. Points are the first axis of the arrays
    below, as NumPy is slow over short last axes.

    Args:
        points: (C, N, 2) points of the piece.
        xy: (C, 2) position of the agent.
        ahead: (2, C) unit vector in the direction of the agent's heading.
        shrunk: (C,) factor on distances ahead.
    """
    dx, dy = np.ascontiguousarray(points.T) - xy.T[:, None]  # (N, C) each
    squared = dx**2 + dy**2
    forward = np.maximum(dx * ahead[0] + dy * ahead[1], 0.0)
    cost = squared - (1.0 - shrunk**2) * forward**2
    return np.sqrt(squared.min(axis=0)), np.sqrt(np.maximum(cost.min(axis=0), 0.0))


def build_pieces(
    lanes: Mapping[str, Lane],
    links: Iterable[Link],
    junctions: Mapping[str, Junction],
    rings: Iterable[FloatArray],
    lefthand: bool,
    view: MapView = "near",
) -> PieceTable:
    """Return the table of a map.

    Args:
        lanes: all lanes; those only for pedestrians or rails are left out.
        links: connections between non-internal lanes.
        junctions: their right-of-way matrices say which links yield under a signal.
        rings: closed boundaries (P, 2) of the drivable area, with the area on the left.
        lefthand: whether traffic drives on the left, and so makes U-turns to the right.
        view: the view for which the map is cut.
    """
    links, limits = list(links), VIEWS[view]
    signal_links = tuple(
        sorted({(x.tls_id, x.tls_index) for x in links if x.tls_id is not None and x.tls_index is not None})
    )
    features_of = _PieceFeatures(junctions, {pair: row for row, pair in enumerate(signal_links)}, lefthand)
    link_of_internal = {name: link for link in reversed(links) for name in link.via}
    xy: list[FloatArray] = []
    features: list[list[float]] = []
    signals: list[int] = []
    for lane in _shown(lanes):
        pieces = _cut(lane.line, max(PIECE_M, limits.piece_s * lane.speed_mps))
        link = link_of_internal.get(lane.id) if lane.is_internal else _representative(lane.successors)
        for number in range(len(pieces)):
            piece_link = link if lane.is_internal or number == len(pieces) - 1 else None
            features.append(features_of.lane(lane, piece_link))
            signals.append(features_of.signal(piece_link))
        xy += pieces
    for ring in rings:
        pieces = _cut(Polyline.of(ring), limits.edge_piece_m) if len(without_repeats(ring)) > 2 else []
        xy += pieces
        features += [_EDGE_FEATURES] * len(pieces)
        signals += [-1] * len(pieces)
    return PieceTable(
        np.array(xy, dtype=np.float64).reshape(-1, POINTS, 2),
        np.array(features, dtype=np.float64).reshape(-1, len(Feature)),
        np.array(signals, dtype=np.int64),
        signal_links,
        limits,
    )


_EDGE_FEATURES = [1.0 if column == Feature.IS_ROAD_EDGE else 0.0 for column in Feature]


@dataclass(frozen=True)
class _PieceFeatures:
    """Computes the features and the signal of lane pieces."""

    junctions: Mapping[str, Junction]
    signal_rows: Mapping[tuple[str, int], int]
    lefthand: bool

    def lane(self, lane: Lane, link: Link | None) -> list[float]:
        """Return the features of a piece of *lane* before or on *link*; None: no signs and turns.

        The turn of a piece before a junction is that of all links of the lane; 0 if they differ.
        """
        row = [0.0] * len(Feature)
        row[Feature.WIDTH_M], row[Feature.SPEED_MPS] = lane.width_m, lane.speed_mps
        row[Feature.IS_LANE], row[Feature.IS_INTERNAL] = 1.0, float(lane.is_internal)
        row[Feature.FOR_CARS] = float(lane.permits("passenger"))
        if link is not None:
            turns = {self._turn(x) for x in ((link,) if lane.is_internal else lane.successors)}
            row[Feature.TURN] = turns.pop() if len(turns) == 1 else 0.0
            row[Feature.YIELDS] = float(self._yields(link))
            row[Feature.STOP_SIGN] = float(link.state in "sw")
        return row

    def signal(self, link: Link | None) -> int:
        """Return the row of the signal that controls *link*; −1 without one."""
        if link is None or link.tls_id is None or link.tls_index is None:
            return -1
        return self.signal_rows[link.tls_id, link.tls_index]

    def _turn(self, link: Link) -> float:
        """Return 1 for a left turn, −1 for a right turn, 0 straight on; a U-turn counts as a turn to its side."""
        u_turn = -1.0 if self.lefthand else 1.0
        return {"l": 1.0, "L": 1.0, "r": -1.0, "R": -1.0, "t": u_turn, "T": u_turn}.get(link.direction, 0.0)

    def _yields(self, link: Link) -> bool:
        junction = self.junctions.get(link.junction_id)
        if link.tls_id is None or junction is None:
            return link.yields
        return bool(junction.yields_to(link))  # such as a left turn during oncoming traffic's green


def _shown(lanes: Mapping[str, Lane]) -> Iterator[Lane]:
    """Yield lanes for motor vehicles, and bicycle lanes of edges that have such lanes."""
    road_edges = {lane.edge_id for lane in lanes.values() if lane.is_drivable}
    for lane in lanes.values():
        if lane.is_drivable or (lane.edge_id in road_edges and "bicycle" in lane.allows):
            yield lane


def _representative(links: tuple[Link, ...]) -> Link | None:
    """Return the first link that goes straight on, else the first link; None without links."""
    return next((link for link in links if link.direction == "s"), links[0] if links else None)


def _cut(line: Polyline, piece_m: float) -> list[FloatArray]:
    """Return *line*, cut into equal parts of at most *piece_m*, each as N evenly spaced points (N, 2)."""
    if line.length_m < _SHORTEST_M:
        return []
    parts = max(1, int(np.ceil(line.length_m / piece_m - 1e-9)))
    share = np.linspace(0.0, 1.0, POINTS)
    return list(line.at((np.arange(parts)[:, None] + share) * (line.length_m / parts))[0])
