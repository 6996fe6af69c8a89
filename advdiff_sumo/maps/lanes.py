"""The values a road map is made of: lanes, links, edges, junctions, poses on lanes; arrays are read-only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from sumolib.net.lane import SUMO_ROAD_MOTOR_CLASSES

from advdiff_sumo.core.arrays import FloatArray, read_only
from advdiff_sumo.core.polylines import Polyline


@dataclass(frozen=True)
class Link:
    """One connection of two lanes over a junction.

    Attributes:
        from_lane: where it begins; an internal lane when this is the second half of a connection.
        to_lane: the lane beyond the junction, never internal.
        via: internal lanes in driving order: none, one, or two when there is a waiting position.
        direction: SUMO's letter: s straight, l left, r right, L and R partly so, t turn-round (T where one drives on
            the left).
        tls_id: traffic light that controls it.
        tls_index: position in that light's state string.
        state: SUMO's letter: M major, m minor, = equal, s stop, w all-way stop, Z zipper, o and O light off.
        junction_id: where.
        request_index: row of the junction's right-of-way matrix; −1 when the net has none for it.
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
        """Whether it leads back."""
        return self.direction in ("t", "T")

    @property
    def yields(self) -> bool:
        """Whether the sign says to give way (minor road, stop, all-way stop, equal roads)."""
        return self.state in "mws="

    @property
    def must_wait(self) -> bool:
        """Whether the sign says to give way whoever comes, not only to some by the rule of the junction."""
        return self.yields and self.state != "="

    def signal(self, signals: Mapping[str, str]) -> str:
        """Return the letter of its light in *signals* (traffic light → states); "" without one or when unknown."""
        states = signals.get(self.tls_id, "") if self.tls_id is not None else ""
        index = self.tls_index
        return states[index] if index is not None and index < len(states) else ""


@dataclass(frozen=True, eq=False)
class Lane:
    """One lane, internal lanes of junctions included (their id starts with a colon).

    Attributes:
        id: SUMO's id.
        edge_id: the edge it belongs to.
        index: number in its edge, from the rightmost in right-hand nets, from the leftmost in left-hand nets.
        centre_xy_m: (P, 2) centre line in driving direction, P ≥ 2 distinct points.
        width_m: width.
        speed_mps: speed limit.
        length_m: length of the centre line.
        sumo_length_m: length that SUMO drives, which the net may set apart from the drawn one.
        is_internal: whether it lies on a junction.
        allows: vehicle classes that may use it.
        left_id: neighbour to the driver's left on the same edge.
        right_id: neighbour to the driver's right.
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
        """Return whether *vclass* may drive here; None asks for any road motor vehicle."""
        if vclass is None:
            return self.is_drivable
        return vclass in self.allows

    @cached_property
    def is_drivable(self) -> bool:
        """Whether some road motor vehicle may drive here."""
        return not self.allows.isdisjoint(SUMO_ROAD_MOTOR_CLASSES)

    @cached_property
    def line(self) -> Polyline:
        """The centre line with arc length."""
        return Polyline.of(self.centre_xy_m)


@dataclass(frozen=True)
class Edge:
    """Lanes side by side.

    Attributes:
        id: SUMO's id.
        lane_ids: lanes by index.
        from_junction: where it begins; for an internal edge, the junction it lies on.
        to_junction: where it ends.
        length_m: mean length of its centre lines.
        speed_mps: highest speed limit of its lanes.
        is_internal: whether it lies on a junction.
        priority: SUMO's priority, higher goes first.
        successors: edges that some lane leads to, without internal ones.
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
    """A node of the net with its right-of-way matrix.

    Attributes:
        id: SUMO's id.
        type: SUMO's word: priority, traffic_light, right_before_left, allway_stop, dead_end, …
        xy_m: (2,) position.
        shape_xy_m: (K, 2) outline; empty for dead ends without one.
        foes: request index → requests whose paths cross or merge.
        response: request index → requests that it must yield to.
        incoming_lanes: lanes that end here, and walking areas before a crossing, which `LaneGraph.lanes` has not.
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
        """Return the requests that who takes *link* must yield to by the net's rows; signals may say otherwise."""
        return self.response.get(link.request_index, frozenset())


@dataclass(frozen=True)
class LanePose:
    """A pose relative to a lane.

    Attributes:
        lane_id: the lane.
        s_m: distance along its centre line.
        d_m: distance to the left of the centre line.
        yaw_error_rad: heading minus the lane's heading, in (−π, π]; 0 when no heading was given.
    """

    lane_id: str
    s_m: float
    d_m: float
    yaw_error_rad: float
