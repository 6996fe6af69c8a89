"""Which traffic over a junction has priority, and which of it comes from ahead."""

from __future__ import annotations

from collections.abc import Mapping

from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.signal_letters import PROTECTED_GREEN, RED
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.maps.roadmap import RoadMap

_HEAD_ON_RAD = 2.2  # least angle between lanes that meet head-on at a junction


def links_over(road: RoadMap, junction_id: str) -> tuple[Link, ...]:
    """Return the links of vehicles over a junction, those of each incoming lane in turn; () if there is no such one."""
    junction = road.junctions.get(junction_id)
    lanes = (road.lanes.get(name) for name in (junction.incoming_lanes if junction is not None else ()))
    incoming = (lane for lane in lanes if lane is not None and lane.is_drivable and not lane.is_internal)
    return tuple(link for lane in incoming for link in lane.successors if link.junction_id == junction_id)


def priority_links(road: RoadMap, link: Link, signals: Mapping[str, str]) -> list[Link]:
    """Return the links that have priority over *link* and may be driven now.

    These have the right of way over *link* or, if that has a red light, a protected green.

    Args:
        road: the net.
        link: a link over a junction.
        signals: state of every traffic light.
    """
    others = links_over(road, link.junction_id)
    if link.signal(signals) in RED:
        foes = road.foes_of(link)
        return [
            other
            for other in others
            if other.request_index in foes and other.signal(signals) == PROTECTED_GREEN
        ]
    return [
        other
        for other in others
        if has_right_of_way(road, other, link) and _may_go(other.signal(signals), other)
    ]


def has_right_of_way(road: RoadMap, link: Link, other: Link) -> bool:
    """Return whether *other* has to yield to *link* of the same junction, and not the other way round."""
    return road.must_yield(other, link) and not road.must_yield(link, other)


def _may_go(signal: str, link: Link) -> bool:
    return signal == PROTECTED_GREEN or (not signal and not link.must_wait)


def come_head_on(road: RoadMap, link: Link, other: Link) -> bool:
    """Return whether vehicles on *link* and on *other* come to the junction head-on."""
    yaw, other_yaw = (float(road.lanes[x.from_lane].line.segment_yaw_rad[-1]) for x in (link, other))
    return abs(float(wrap_angle(yaw - other_yaw))) > _HEAD_ON_RAD
