"""Tells which vehicles must yield to which at the junction that they are on or approach."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from advdiff_sumo.core.arrays import BoolArray
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead


def right_of_way(road: RoadMap, lanes: Sequence[LaneAhead | None]) -> BoolArray:
    """Return (N, N) whether the first vehicle must yield to the second by the net's right-of-way rules.

    Args:
        road: the map.
        lanes: lanes that each of N vehicles would follow.
    """
    must_yield = np.zeros((len(lanes), len(lanes)), dtype=np.bool_)
    links = {row: link for row, lane in enumerate(lanes) if (link := _link_ahead(road, lane)) is not None}
    for row, link in links.items():
        for other_row, other_link in links.items():
            must_yield[row, other_row] = row != other_row and road.must_yield(link, other_link)
    return must_yield


def _link_ahead(road: RoadMap, lane: LaneAhead | None) -> Link | None:
    """Return the link over the junction that *lane* is on or leads to."""
    internal = next((part.id for part in lane.lanes if part.is_internal), None) if lane is not None else None
    return None if internal is None else road.link_of_internal_lane.get(internal)
