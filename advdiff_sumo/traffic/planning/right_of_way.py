"""Who must yield to whom at the junction that they are on or come to next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from advdiff_sumo.core.arrays import BoolArray
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead


def right_of_way(road: RoadMap, lanes: Sequence[LaneAhead | None]) -> BoolArray:
    """Return (N, N) whether the first must yield to the second by the net's rows, on the lanes that each follows.

    Args:
        road: the map.
        lanes: N lanes that each would follow.
    """
    out = np.zeros((len(lanes), len(lanes)), dtype=np.bool_)
    links = {row: link for row, lane in enumerate(lanes) if (link := _link_ahead(road, lane)) is not None}
    for row, link in links.items():
        for other, theirs in links.items():
            out[row, other] = row != other and road.must_yield(link, theirs)
    return out


def _link_ahead(road: RoadMap, lane: LaneAhead | None) -> Link | None:
    """Return the connection over the junction that *lane* is on or leads to."""
    inner = next((part.id for part in lane.lanes if part.is_internal), None) if lane is not None else None
    return None if inner is None else road.link_over.get(inner)
