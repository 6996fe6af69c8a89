"""Defines the map for planners in separate processes: plain values, without the libraries that read nets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, read_only


@dataclass(frozen=True, eq=False)
class KitLane:
    """A lane; its attributes have the names of those of ``advdiff_sumo.maps.lanes.Lane``.

    Attributes:
        id: SUMO's id.
        edge_id: the edge it belongs to.
        index: number in its edge, counted from the kerb.
        centre_xy_m: (P, 2) centre line in driving direction.
        width_m: width.
        speed_mps: speed limit.
        length_m: length of the centre line.
        is_internal: whether it lies on a junction.
        allows: vehicle classes that may use it.
        left_id: neighbour to the driver's left on the same edge; None without one.
        right_id: neighbour to the driver's right on the same edge; None without one.
        successors: connections from its end.
    """

    id: str
    edge_id: str
    index: int
    centre_xy_m: FloatArray
    width_m: float
    speed_mps: float
    length_m: float
    is_internal: bool
    allows: frozenset[str]
    left_id: str | None
    right_id: str | None
    successors: tuple[KitLink, ...]


@dataclass(frozen=True)
class KitLink:
    """A connection of two lanes; its attributes have the names of those of ``advdiff_sumo.maps.lanes.Link``."""

    from_lane: str
    to_lane: str
    via: tuple[str, ...]
    direction: str
    tls_id: str | None
    tls_index: int | None
    state: str
    junction_id: str
    request_index: int


@dataclass(frozen=True, eq=False)
class KitRoad:
    """A net as plain values; its arrays are read-only.

    Attributes:
        net_path: path of the net file on the machine that simulates.
        lefthand: whether traffic drives on the left.
        lanes: lane id → lane.
        drivable_area: polygons, each with the rings (K, 2) of its outline and of its holes.
        message: the ``Map`` message; it contains the right of way at each junction too.
    """

    net_path: str
    lefthand: bool
    lanes: Mapping[str, KitLane]
    drivable_area: tuple[tuple[FloatArray, ...], ...]
    message: Any

    def __getattr__(self, name: str) -> NoReturn:
        """Raise an AttributeError that says how a planner can get a ``RoadMap``, whose methods this class lacks."""
        raise AttributeError(
            f"'KitRoad' has no '{name}', it holds plain values; for a RoadMap install advdiff_sumo as a whole and "
            "serve with read_road=RoadMap.read or --read-road advdiff_sumo.maps:RoadMap.read"
        )


def road_of(message: Any) -> KitRoad:
    """Return the map in *message*."""
    links: dict[str, list[KitLink]] = {}
    for link in message.links:
        links.setdefault(link.from_lane, []).append(_link(link))
    lanes = {lane.id: _lane(lane, tuple(links.get(lane.id, ()))) for lane in message.lanes}
    area = tuple(
        tuple(_ring(r) for r in (polygon.outline, *polygon.holes)) for polygon in message.drivable_area
    )
    return KitRoad(message.net_path, message.lefthand, lanes, area, message)


def _lane(lane: Any, successors: tuple[KitLink, ...]) -> KitLane:
    return KitLane(
        id=lane.id,
        edge_id=lane.edge_id,
        index=lane.index,
        centre_xy_m=_ring(lane),
        width_m=lane.width_m,
        speed_mps=lane.speed_limit_mps,
        length_m=lane.length_m,
        is_internal=lane.internal,
        allows=frozenset(lane.allows),
        left_id=lane.left_id or None,
        right_id=lane.right_id or None,
        successors=successors,
    )


def _link(link: Any) -> KitLink:
    return KitLink(
        from_lane=link.from_lane,
        to_lane=link.to_lane,
        via=tuple(link.via),
        direction=link.direction,
        tls_id=link.signal_id or None,
        tls_index=link.signal_index if link.signal_id else None,
        state=link.state,
        junction_id=link.junction_id,
        request_index=link.request,
    )


def _ring(message: Any) -> FloatArray:
    """Return the points (K, 2) of a message with ``x_m`` and ``y_m``."""
    return read_only(
        np.stack((np.array(message.x_m, dtype=np.float64), np.array(message.y_m, dtype=np.float64)), axis=-1)
    )
