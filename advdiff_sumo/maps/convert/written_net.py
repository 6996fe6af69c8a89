"""Read the geometry of a written net with sumolib, for measurements and checks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import sumolib

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.netplan import ConnectionKey
from advdiff_sumo.maps.convert.sources.arcline import drop_repeats
from advdiff_sumo.maps.read_net import BEYOND_TYPE


@dataclass(frozen=True, eq=False)
class WrittenNet:
    """Centre lines and widths of a net, without edges for pedestrians only.

    Attributes:
        lanes: by (edge, lane number) the centre line (N, 2) and the width in m of edge lanes.
        connections: by connection the centre line (N, 2) and the width in m of its internal lanes, joined.
        next_edges: the edges that follow each edge, including return edges and streets beyond the rim.
    """

    lanes: dict[tuple[str, int], tuple[FloatArray, float]]
    connections: dict[ConnectionKey, tuple[FloatArray, float]]
    next_edges: dict[str, list[str]]


def read_net(path: Path) -> WrittenNet:
    """Return the geometry of the net at *path*; edges beyond the rim appear in ``next_edges`` only."""
    net = sumolib.net.readNet(str(path), withInternal=True)
    roads = [
        edge
        for edge in net.getEdges()
        if edge.getFunction() == ""
        and any(lane.getPermissions() - {"pedestrian"} for lane in edge.getLanes())
    ]
    edges = [edge for edge in roads if edge.getType() != BEYOND_TYPE]
    lanes = {
        (lane.getEdge().getID(), lane.getIndex()): (_line(lane.getShape()), float(lane.getWidth()))
        for edge in edges
        for lane in edge.getLanes()
    }
    targets = [(after, group) for edge in edges for after, group in edge.getOutgoing().items()]
    rows = [c for after, group in targets if after.getType() != BEYOND_TYPE for c in group]
    connections = {_key(connection): _internal_line(net, connection) for connection in rows}
    following = {edge.getID(): sorted(after.getID() for after in edge.getOutgoing()) for edge in roads}
    return WrittenNet(lanes, connections, following)


def _key(connection: Any) -> ConnectionKey:
    origin, target = connection.getFromLane(), connection.getToLane()
    return (origin.getEdge().getID(), origin.getIndex(), target.getEdge().getID(), target.getIndex())


def _internal_line(net: Any, connection: Any) -> tuple[FloatArray, float]:
    """Return line (N, 2) and width in m of a connection's internal lanes, joined (a waiting position divides some)."""
    points: list[Any] = []
    width = float(connection.getFromLane().getWidth())
    via = connection.getViaLaneID()
    while via:
        lane = net.getLane(via)
        points += lane.getShape()
        width = float(lane.getWidth())
        following = lane.getOutgoing()
        via = following[0].getViaLaneID() if following else ""
    if not points:
        points = [connection.getFromLane().getShape()[-1], connection.getToLane().getShape()[0]]
    return _line(points), width


def _line(points: Any) -> FloatArray:
    """Return *points* as a line (N, 2) without heights and repeated points."""
    line = np.asarray([point[:2] for point in points], dtype=np.float64)
    kept = drop_repeats(line, 1e-4)
    return kept if len(kept) > 1 else line[[0, -1]]
