"""Extend the plan of an HD map's net by the junctions at its rim that join it to streets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

from shapely.geometry import LineString, MultiPoint
from shapely.ops import nearest_points

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.layout.lane_paths import LaneConnection
from advdiff_sumo.maps.convert.layout.lane_segments import ROOM_M
from advdiff_sumo.maps.convert.netplan import (
    ConnectionPlan,
    Ends,
    JunctionPlan,
    NetPlan,
    end_bar,
    junction_shape,
    turn_speed,
    way_strip,
)
from advdiff_sumo.maps.convert.osm.cut_streets import StreetStretch
from advdiff_sumo.maps.convert.osm.rim_joints import Joint, RimConnection

JointNames: TypeAlias = dict[tuple[str, bool], str]
"""Names of the junctions at ends of stretches, by stretch id and whether the map leads into the stretch there."""


def joined_plan(
    plan: NetPlan, joints: Sequence[Joint], names: JointNames, stretches: Mapping[str, StreetStretch]
) -> NetPlan:
    """Return *plan* with a junction for each of *joints*; its lanes and other junctions are not changed.

    Args:
        plan: the planned net of the map.
        joints: joints between ends of streets and ends of the map.
        names: names of their junctions.
        stretches: trimmed streets by id.
    """
    node_of = {(rim.edge.id, rim.is_exit): names[j.stretch.id, j.is_exit] for j in joints for rim in j.rims}
    edges = tuple(
        replace(
            edge,
            origin=node_of.get((edge.id, False), edge.origin),
            target=node_of.get((edge.id, True), edge.target),
        )
        for edge in plan.edges
    )
    used = {name for edge in edges for name in (edge.origin, edge.target)}
    added = [_junction(j, names[j.stretch.id, j.is_exit], stretches[j.stretch.id], plan) for j in joints]
    connections = [_connection_plan(way, joint) for joint in joints for way in joint.ways]
    return replace(
        plan,
        edges=edges,
        junctions=(*(junction for junction in plan.junctions if junction.id in used), *added),
        connections=(*plan.connections, *connections),
    )


def _connection_plan(joint_way: RimConnection, joint: Joint) -> ConnectionPlan:
    map_lane, street_lane = (joint_way.edge.id, joint_way.lane), (joint.stretch.id, joint_way.street_lane)
    origin, target = (map_lane, street_lane) if joint.is_exit else (street_lane, map_lane)
    lane = joint_way.edge.lanes[joint_way.lane]
    limit = min(lane.speed_mps, turn_speed(joint_way.shape_m))
    lane_connection = LaneConnection(lane.piece, lane.piece, ())
    passes = joint.is_exit and joint_way.edge.length_m < ROOM_M
    return ConnectionPlan(origin, target, joint_way.shape_m, limit, "", lane_connection, passes)


def first_to_go(joints: Sequence[Joint]) -> list[tuple[Ends, Ends]]:
    """Return pairs of connections from the map into a street; the second yields to the first.

    If the map ends inside a junction, the remaining part of a connector may be too short for a waiting car. Vehicles
    from such a short edge have priority over those from longer edges.
    """
    return [
        ((rim.edge.id, joint.stretch.id), (other.edge.id, joint.stretch.id))
        for joint in joints
        if joint.is_exit
        for rim in joint.rims
        for other in joint.rims
        if rim.edge.length_m < ROOM_M <= other.edge.length_m
    ]


def _junction(joint: Joint, name: str, stretch: StreetStretch, plan: NetPlan) -> JunctionPlan:
    """Return the junction of *joint* with the trimmed *stretch*; its shape covers connections and lane ends."""
    lines = [_away_from_node(lane.shape_m, joint.is_exit) for rim in joint.rims for lane in rim.edge.lanes]
    widths = [lane.width_m for rim in joint.rims for lane in rim.edge.lanes]
    lines += [_away_from_node(line, not joint.is_exit) for line in stretch.lane_lines(plan.lefthand)]
    widths += stretch.street.widths_m
    strips = [way_strip(way.shape_m, way.edge.lanes[way.lane].width_m) for way in joint.ways]
    bars = [end_bar(line, width) for line, width in zip(lines, widths, strict=True)]
    shape = junction_shape(strips, bars, [LineString(line) for line in lines])
    middle = nearest_points(shape, MultiPoint([line[0] for line in lines]).centroid)[0]
    return JunctionPlan(name, (middle.x, middle.y), shape, "priority")


def _away_from_node(line_m: FloatArray, ends_at_node: bool) -> FloatArray:
    return line_m[::-1] if ends_at_node else line_m
