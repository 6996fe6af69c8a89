"""Make paved wedges where a lane begins or ends beside one that continues."""

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
    """Yield wedges (m) that narrow the paved area gradually.

    Args:
        net: sumolib net, read with internal lanes.
        margin_m: node → width of the strip between the outermost lane and the edge of the paved area there.
    """
    for edge in net.getEdges(withInternal=False):
        for onward in (True, False):
            node = edge.getToNode() if onward else edge.getFromNode()
            if _is_seam(node):
                yield from _wedges(edge, onward, margin_m(node))


def _is_seam(node: Any) -> bool:
    """Return whether only the number of lanes of a road changes at a node."""
    return [sum(not e.isSpecial() for e in es) for es in (node.getIncoming(), node.getOutgoing())] == [1, 1]


def _wedges(edge: Any, onward: bool, margin_m: float) -> Iterator[Polygon]:
    lanes = edge.getLanes()
    for lane, neighbour in [*pairwise(lanes), *pairwise(lanes[::-1])]:
        continuations = _continuations(neighbour, edge, onward)
        if continuations and not _continuations(lane, edge, onward):
            yield _wedge(lane, neighbour, continuations[0], onward, margin_m)


def _continuations(lane: Any, edge: Any, onward: bool) -> list[Any]:
    """Return the lanes that follow a lane; if not `onward`, those that lead into it."""
    if onward:
        lanes = [c.getToLane() for c in lane.getOutgoing()]
    else:
        lanes = [c.getFromLane() for cs in edge.getIncoming().values() for c in cs if c.getToLane() == lane]
    return [other for other in lanes if not other.getEdge().isSpecial()]


def _wedge(lane: Any, neighbour: Any, continuation: Any, ends: bool, margin_m: float) -> Polygon:
    """Return the wedge beside `continuation`, on the side of `lane`.

    Args:
        lane: the lane that ends or begins.
        neighbour: the lane beside it that continues.
        continuation: the lane after (or before) `neighbour`.
        ends: whether `lane` ends; else it begins.
        margin_m: width of the strip beside the lanes.
    """
    line = LineString(continuation.getShape())
    length = min(TAPER_S * float(lane.getSpeed()), line.length)
    axis = substring(line, 0, length) if ends else substring(line, line.length - length, line.length)
    points = np.asarray(axis.coords)
    side = _side(neighbour, lane)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))]) / axis.length
    share = 1.0 - along if ends else along
    seam = np.asarray(neighbour.getShape()[-1 if ends else 0])
    points = np.vstack([seam, points]) if ends else np.vstack([points, seam])
    share = np.concatenate([[1.0], share]) if ends else np.concatenate([share, [1.0]])
    normal = normals(points) * side
    half, width = continuation.getWidth() / 2, lane.getWidth()
    outer = points + normal * (half + margin_m + share * width)[:, None]
    return Polygon(np.vstack([points, outer[::-1]]))


def _side(lane: Any, neighbour: Any) -> float:
    """Return +1 if the neighbour lies to the left of a lane, -1 if to the right."""
    points, start = np.asarray(lane.getShape()), np.asarray(neighbour.getShape()[0])
    ahead, across = points[1] - points[0], start - points[0]
    return float(np.sign(ahead[0] * across[1] - ahead[1] * across[0]))
