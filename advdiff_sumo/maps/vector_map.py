"""The map as a table of short pieces with features, from which every agent takes its nearest ones."""

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
"""Longest piece where traffic is slow; longer lines are cut into equal parts."""
_SHORTEST_M = 0.05
# "R" and "U" SUMO itself does not write
_SIGNAL_CODES = dict.fromkeys(RED | {"R", "U"}, 1) | dict.fromkeys(YELLOW, 2) | dict.fromkeys(GREEN, 3)


@dataclass(frozen=True)
class ViewLimits:
    """What of a map an agent sees.

    Attributes:
        lanes: lane pieces, at most.
        edges: pieces of road edges, at most.
        radius_m: distance of the farthest point of a piece that is seen by who stands.
        reach_s: seconds at the agent's speed that are added to that, ahead and around.
        narrow_m: what lies at the end of that reach ahead counts as near as what lies so far aside.
        piece_s: longest piece in seconds at the lane's limit, where that is more than ``PIECE_M``.
        edge_piece_m: longest piece of a road edge.
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
        """K: pieces an agent sees."""
        return self.lanes + self.edges


VIEWS: Mapping[MapView, ViewLimits] = {
    "near": ViewLimits(*MAP_PIECES["near"], 60.0, 0.0, 24.0, 0.0, PIECE_M),
    "far": ViewLimits(*MAP_PIECES["far"], 60.0, 6.5, 24.0, 2.0, 40.0),
}


class Feature(IntEnum):
    """Columns of :attr:`PieceTable.features`, raw SI."""

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
        signal: (M,) index into :attr:`signal_links`, −1 where no signal counts.
        signal_links: G pairs of traffic light id and index in its state string.
        limits: of the view that it was cut for.
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
        """Return the pieces (S, K) that agents see, −1 padded.

        The first columns hold lanes, the others road edges, each nearest first, with a point within reach. What lies
        ahead counts as nearer than it is, so that a driver in a dense junction still sees the lane it will be on in
        6 s.

        Args:
            xy_m: (S, 2) places.
            yaw_rad: (S,) headings.
            speed_mps: (S,) speeds.
        """
        xy, yaw = np.asarray(xy_m, dtype=np.float64), np.asarray(yaw_rad, dtype=np.float64)
        limits = self.limits
        reach = limits.radius_m + limits.reach_s * np.maximum(np.asarray(speed_mps, dtype=np.float64), 0.0)
        out = np.full((len(xy), limits.pieces), -1, dtype=np.int32)
        if len(xy):
            self._fill(out[:, : limits.lanes], self._lanes, xy, yaw, reach)
            self._fill(out[:, limits.lanes :], self._edges, xy, yaw, reach)
        return out

    def signal_states(self, signals: Mapping[str, str]) -> NDArray[np.uint8]:
        """Return the state (G,) of each signalled link: 0 unknown or off, 1 red, 2 yellow, 3 green.

        Args:
            signals: id of each traffic light → its state string as SUMO writes it.
        """
        states = np.zeros(len(self.signal_links), dtype=np.uint8)
        for row, (name, index) in enumerate(self.signal_links):
            text = signals.get(name, "")
            states[row] = _SIGNAL_CODES.get(text[index], 0) if index < len(text) else 0
        return states

    @cached_property
    def _lanes(self) -> _Search:
        return _Search.of(self.xy_m, self.features[:, Feature.IS_LANE] > 0.0)

    @cached_property
    def _edges(self) -> _Search:
        return _Search.of(self.xy_m, self.features[:, Feature.IS_ROAD_EDGE] > 0.0)

    def _fill(
        self, out: NDArray[np.int32], search: _Search, xy: FloatArray, yaw: FloatArray, reach: FloatArray
    ) -> None:
        agent, piece = search.candidates(xy, reach)
        shrunk = self.limits.narrow_m / reach
        ahead = np.stack((np.cos(yaw), np.sin(yaw)))
        distance, cost = _distances(self.xy_m[piece], xy[agent], ahead[:, agent], shrunk[agent])
        near = distance <= reach[agent]
        agent, piece, cost = agent[near], piece[near], cost[near]
        order = np.lexsort((piece, cost, agent))
        agent, piece = agent[order], piece[order]
        rank = np.arange(len(agent)) - np.searchsorted(agent, agent)
        kept = rank < out.shape[1]
        out[agent[kept], rank[kept]] = piece[kept]


@dataclass(frozen=True)
class _Search:
    """A search tree over the middles of some pieces."""

    rows: IntArray
    reach_m: float
    tree: cKDTree | None

    @staticmethod
    def of(xy_m: FloatArray, wanted: BoolArray) -> _Search:
        rows = np.flatnonzero(wanted)
        if len(rows) == 0:
            return _Search(rows, 0.0, None)
        points = xy_m[rows]
        middle = 0.5 * (points.min(axis=1) + points.max(axis=1))
        reach = float(np.linalg.norm(points - middle[:, None], axis=-1).max())
        return _Search(rows, reach, cKDTree(middle))

    def candidates(self, xy_m: FloatArray, reach_m: FloatArray) -> tuple[IntArray, IntArray]:
        """Return pairs (C,), (C,) of agent and piece that may be within reach."""
        none = np.zeros(0, dtype=np.int64)
        if self.tree is None:
            return none, none
        nearby = self.tree.query_ball_point(xy_m, reach_m + self.reach_m, return_sorted=False)
        counts = np.array([len(rows) for rows in nearby])
        if counts.sum() == 0:
            return none, none
        picked = np.fromiter(chain.from_iterable(nearby), np.int64, counts.sum())
        return np.repeat(np.arange(len(xy_m)), counts), self.rows[picked]


def _distances(
    points: FloatArray, xy: FloatArray, ahead: FloatArray, shrunk: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the distance (C,) of each agent to the points (C, N, 2) of a piece, and with what is ahead *shrunk*.

    *ahead* (2, C) is a unit vector along each agent. Points come first below: NumPy is slow over short last axes.
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
        lanes: all lanes; those for pedestrians or rails alone are left out.
        links: connections between non-internal lanes.
        junctions: for who yields to whom under a signal.
        rings: closed boundaries (P, 2) of the drivable area, area on the left.
        lefthand: whether traffic keeps left, and turns round to the right.
        view: what it is cut for.
    """
    links, limits = list(links), VIEWS[view]
    signal_links = tuple(
        sorted({(x.tls_id, x.tls_index) for x in links if x.tls_id is not None and x.tls_index is not None})
    )
    marks = _Marks(junctions, {pair: row for row, pair in enumerate(signal_links)}, lefthand)
    through = {name: link for link in reversed(links) for name in link.via}
    xy: list[FloatArray] = []
    rows: list[list[float]] = []
    signal: list[int] = []
    for lane in _shown(lanes):
        pieces = _cut(lane.line, max(PIECE_M, limits.piece_s * lane.speed_mps))
        link = through.get(lane.id) if lane.is_internal else _representative(lane.successors)
        for number in range(len(pieces)):
            marking = link if lane.is_internal or number == len(pieces) - 1 else None
            rows.append(marks.lane(lane, marking))
            signal.append(marks.signal(marking))
        xy += pieces
    for ring in rings:
        pieces = _cut(Polyline.of(ring), limits.edge_piece_m) if len(without_repeats(ring)) > 2 else []
        xy += pieces
        rows += [_EDGE_ROW] * len(pieces)
        signal += [-1] * len(pieces)
    return PieceTable(
        np.array(xy, dtype=np.float64).reshape(-1, POINTS, 2),
        np.array(rows, dtype=np.float64).reshape(-1, len(Feature)),
        np.array(signal, dtype=np.int64),
        signal_links,
        limits,
    )


_EDGE_ROW = [1.0 if column == Feature.IS_ROAD_EDGE else 0.0 for column in Feature]


@dataclass(frozen=True)
class _Marks:
    """What signs, arrows and signals say about pieces."""

    junctions: Mapping[str, Junction]
    signal_rows: Mapping[tuple[str, int], int]
    lefthand: bool

    def lane(self, lane: Lane, link: Link | None) -> list[float]:
        """Return the features of a piece of *lane* at which *link* counts."""
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
        """Return the row of the signal of *link*, or −1."""
        if link is None or link.tls_id is None or link.tls_index is None:
            return -1
        return self.signal_rows[link.tls_id, link.tls_index]

    def _turn(self, link: Link) -> float:
        around = -1.0 if self.lefthand else 1.0
        return {"l": 1.0, "L": 1.0, "r": -1.0, "R": -1.0, "t": around, "T": around}.get(link.direction, 0.0)

    def _yields(self, link: Link) -> bool:
        junction = self.junctions.get(link.junction_id)
        if link.tls_id is None or junction is None:
            return link.yields
        return bool(junction.yields_to(link))  # a turn that goes with the opposite green


def _shown(lanes: Mapping[str, Lane]) -> Iterator[Lane]:
    roads = {lane.edge_id for lane in lanes.values() if lane.is_drivable}
    for lane in lanes.values():
        if lane.is_drivable or (lane.edge_id in roads and "bicycle" in lane.allows):
            yield lane


def _representative(links: tuple[Link, ...]) -> Link | None:
    """Return the straight link, else the first, else None."""
    return next((link for link in links if link.direction == "s"), links[0] if links else None)


def _cut(line: Polyline, piece_m: float) -> list[FloatArray]:
    """Return *line* in equal parts of at most *piece_m*, each as N evenly spaced points."""
    if line.length_m < _SHORTEST_M:
        return []
    parts = max(1, int(np.ceil(line.length_m / piece_m - 1e-9)))
    share = np.linspace(0.0, 1.0, POINTS)
    return list(line.at((np.arange(parts)[:, None] + share) * (line.length_m / parts))[0])
