"""Paved wedges where a lane begins or ends beside one that goes on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from shapely import LineString, Polygon
from shapely.ops import substring

from networks_src.curve import normals

TAPER_S = 1.4  # length of a taper, as driving time at the limit


def tapers(net: Any, margin_m: Callable[[Any], float]) -> Iterator[Polygon]:
    """Wedges (m) that narrow the paved area over some metres instead of at once.

    Args:
        net: sumolib net, read with internal lanes.
        margin_m: node → strip between the outermost lane and the edge of the paved area there.
    """
    for edge in net.getEdges(withInternal=False):
        for onward in (True, False):
            node = edge.getToNode() if onward else edge.getFromNode()
            if _is_seam(node):
                yield from _wedges(edge, onward, margin_m(node))


def _is_seam(node: Any) -> bool:
    """Whether one road merely changes its lanes at a node."""
    return [sum(not e.isSpecial() for e in es) for es in (node.getIncoming(), node.getOutgoing())] == [1, 1]


def _wedges(edge: Any, onward: bool, margin_m: float) -> Iterator[Polygon]:
    lanes = edge.getLanes()
    for lane, beside in [*pairwise(lanes), *pairwise(lanes[::-1])]:
        ways = _ways(beside, edge, onward)
        if ways and not _ways(lane, edge, onward):
            yield _wedge(lane, beside, ways[0], onward, margin_m)


def _ways(lane: Any, edge: Any, onward: bool) -> list[Any]:
    """Lanes that carry on with a lane, or lead into it."""
    if onward:
        ways = [c.getToLane() for c in lane.getOutgoing()]
    else:
        ways = [c.getFromLane() for cs in edge.getIncoming().values() for c in cs if c.getToLane() == lane]
    return [way for way in ways if not way.getEdge().isSpecial()]


def _wedge(lane: Any, beside: Any, other: Any, ends: bool, margin_m: float) -> Polygon:
    """The wedge beside lane `other`, which lies ahead of (or behind) `beside`, on the side of `lane`."""
    line = LineString(other.getShape())
    length = min(TAPER_S * float(lane.getSpeed()), line.length)
    axis = substring(line, 0, length) if ends else substring(line, line.length - length, line.length)
    points = np.asarray(axis.coords)
    side = _side(beside, lane)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))]) / axis.length
    share = 1.0 - along if ends else along
    seam = np.asarray(beside.getShape()[-1 if ends else 0])
    points = np.vstack([seam, points]) if ends else np.vstack([points, seam])
    share = np.concatenate([[1.0], share]) if ends else np.concatenate([share, [1.0]])
    normal = normals(points) * side
    half, width = other.getWidth() / 2, lane.getWidth()
    outer = points + normal * (half + margin_m + share * width)[:, None]
    return Polygon(np.vstack([points, outer[::-1]]))


def _side(lane: Any, neighbour: Any) -> float:
    """+1 if the neighbour lies to the left of a lane, -1 if to the right."""
    points, there = np.asarray(lane.getShape()), np.asarray(neighbour.getShape()[0])
    ahead, across = points[1] - points[0], there - points[0]
    return float(np.sign(ahead[0] * across[1] - ahead[1] * across[0]))
