"""Defines the parts of a road map: lanes, links, edges, junctions and poses on lanes; arrays are read-only."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias, get_args

from sumolib.net.lane import SUMO_ROAD_MOTOR_CLASSES

from advdiff_sumo.core.arrays import FloatArray, read_only
from advdiff_sumo.core.polylines import Polyline

Side: TypeAlias = Literal["left", "right"]
"""The driver's left or right."""
SIDES: tuple[Side, ...] = get_args(Side)


def edge_of_lane(lane_id: str) -> str:
    """Return the edge of a lane by its name, for lanes that a :class:`Lane` need not exist for; "" for no name."""
    return lane_id.rpartition("_")[0]


@dataclass(frozen=True)
class Link:
    """A connection of two lanes over a junction.

    Attributes:
        from_lane: lane at which it begins; an internal lane if this is the second half of a connection.
        to_lane: lane beyond the junction; never internal.
        via: internal lanes in driving order: none, one, or two if there is a waiting position inside the junction.
        direction: SUMO's letter: s straight, l left, r right, L partially left, R partially right, t turn-round,
            T turn-round in left-hand traffic.
        tls_id: traffic light that controls it; None without one.
        tls_index: position in that light's state string; None without one.
        state: SUMO's letter: M major, m minor, = equal, s stop, w all-way stop, Z zipper, o and O light off.
        junction_id: the junction.
        request_index: row in the junction's right-of-way matrix; −1 if the net has no row for it.
    """

    from_lane: str
    to_lane: str
    via: tuple[str, ...]
    direction: str
    tls_id: str | None
    tls_index: int | None
    state: str
    junction_id: str
    request_index: int

    @property
    def turns_round(self) -> bool:
        """Whether it is a U-turn."""
        return self.direction in ("t", "T")

    @property
    def yields(self) -> bool:
        """Whether traffic on it must yield by the sign (minor road, stop, all-way stop, equal roads)."""
        return self.state in "mws="

    @property
    def must_wait(self) -> bool:
        """Whether traffic on it must yield to all others by the sign; on equal roads the side decides to whom."""
        return self.yields and self.state != "="

    def signal(self, signals: Mapping[str, str]) -> str:
        """Return the state letter of its traffic light; "" without a light or if its state is unknown.

        Args:
            signals: traffic light id → state string.
        """
        states = signals.get(self.tls_id, "") if self.tls_id is not None else ""
        index = self.tls_index
        return states[index] if index is not None and index < len(states) else ""


@dataclass(frozen=True, eq=False)
class Lane:
    """A lane of an edge, or an internal lane of a junction (whose id starts with a colon).

    Attributes:
        id: SUMO's id.
        edge_id: the edge it belongs to.
        index: number in its edge, counted from the rightmost lane (from the leftmost in left-hand nets).
        centre_xy_m: (P, 2) centre line in driving direction, P ≥ 2 distinct points.
        width_m: width.
        speed_mps: speed limit.
        length_m: length of the centre line.
        sumo_length_m: length that SUMO uses; the net may state one that differs from that of the centre line.
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
    sumo_length_m: float
    is_internal: bool
    allows: frozenset[str]
    left_id: str | None
    right_id: str | None
    successors: tuple[Link, ...]

    def __post_init__(self) -> None:
        read_only(self.centre_xy_m)

    def permits(self, vclass: str | None) -> bool:
        """Return whether the class *vclass* may use the lane; None: whether any road motor vehicle may."""
        if vclass is None:
            return self.is_drivable
        return vclass in self.allows

    @cached_property
    def is_drivable(self) -> bool:
        """Whether at least one class of road motor vehicles may use the lane."""
        return not self.allows.isdisjoint(SUMO_ROAD_MOTOR_CLASSES)

    @cached_property
    def line(self) -> Polyline:
        """The centre line, with arc lengths."""
        return Polyline.of(self.centre_xy_m)


def lanes_beside(lanes: Mapping[str, Lane], lane_id: str, side: Side) -> Iterator[Lane]:
    """Yield the lanes of the same edge on one side of *lane_id*, the nearest first."""
    lane = lanes[lane_id]
    while (name := lane.left_id if side == "left" else lane.right_id) is not None:
        lane = lanes[name]
        yield lane


@dataclass(frozen=True)
class Edge:
    """A street in one direction: parallel lanes between two junctions.

    Attributes:
        id: SUMO's id.
        lane_ids: its lanes, ordered by index.
        from_junction: junction at which it begins; for an internal edge, the junction it lies on.
        to_junction: junction at which it ends; for an internal edge, the junction it lies on.
        length_m: mean length of its centre lines.
        speed_mps: highest speed limit of its lanes.
        is_internal: whether it lies on a junction.
        priority: SUMO's priority; the higher one has the right of way.
        successors: non-internal edges that at least one of its lanes leads to.
    """

    id: str
    lane_ids: tuple[str, ...]
    from_junction: str
    to_junction: str
    length_m: float
    speed_mps: float
    is_internal: bool
    priority: int
    successors: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Junction:
    """A junction with its right-of-way matrix. A request is a row of that matrix and belongs to one link.

    Attributes:
        id: SUMO's id.
        type: SUMO's word: priority, traffic_light, right_before_left, allway_stop, dead_end, …
        xy_m: (2,) position.
        shape_xy_m: (K, 2) outline; empty for dead ends without one.
        foes: request index → requests whose paths cross its path or merge with it.
        response: request index → requests that it must yield to.
        incoming_lanes: lanes that end here. Includes the walking areas before crossings, which `LaneGraph.lanes`
            does not contain.
    """

    id: str
    type: str
    xy_m: FloatArray
    shape_xy_m: FloatArray
    foes: Mapping[int, frozenset[int]]
    response: Mapping[int, frozenset[int]]
    incoming_lanes: tuple[str, ...]

    def __post_init__(self) -> None:
        read_only(self.xy_m)
        read_only(self.shape_xy_m)

    def yields_to(self, link: Link) -> frozenset[int]:
        """Return the requests that traffic on *link* must yield to by the right-of-way matrix, signals ignored."""
        return self.response.get(link.request_index, frozenset())


@dataclass(frozen=True)
class LanePose:
    """A pose relative to a lane.

    Attributes:
        lane_id: the lane.
        s_m: arc length along its centre line, clamped to the lane.
        d_m: lateral offset from the centre line, left positive; beyond an end of the lane, the distance to that end.
        yaw_error_rad: heading minus the lane's heading, in (−π, π]; 0 if no heading was given.
    """

    lane_id: str
    s_m: float
    d_m: float
    yaw_error_rad: float
