"""The plan of an HD map's net with junctions at its rim, where streets begin and end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

from shapely.geometry import LineString, MultiPoint
from shapely.ops import nearest_points

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.layout.lane_paths import LaneConnection
from advdiff_sumo.maps.convert.layout.lane_segments import ROOM_M
from advdiff_sumo.maps.convert.narrow import Ends
from advdiff_sumo.maps.convert.netplan import (
    WIDEST_WAY_M,
    ConnectionPlan,
    JunctionPlan,
    NetPlan,
    end_bar,
    junction_shape,
    turn_speed,
)
from advdiff_sumo.maps.convert.osm.cut_streets import StreetStretch
from advdiff_sumo.maps.convert.osm.rim_joints import Joint, JointWay

JointNames: TypeAlias = dict[tuple[str, bool], str]
"""Junction at an end of a stretch, by its name and whether the map leads into it there."""


def joined_plan(
    plan: NetPlan, joints: Sequence[Joint], names: JointNames, stretches: Mapping[str, StreetStretch]
) -> NetPlan:
    """Return *plan* with a junction for each of *joints*; its lanes and other junctions stay as they are.

    Args:
        plan: the net of the map.
        joints: ends of streets with ends of the map.
        names: of their junctions.
        stretches: streets by name, without what gave way to the joints.
    """
    node_of = {(rim.edge.id, rim.leaves): names[j.stretch.id, j.leaves] for j in joints for rim in j.rims}
    edges = tuple(
        replace(
            edge,
            origin=node_of.get((edge.id, False), edge.origin),
            target=node_of.get((edge.id, True), edge.target),
        )
        for edge in plan.edges
    )
    used = {name for edge in edges for name in (edge.origin, edge.target)}
    added = [_junction(j, names[j.stretch.id, j.leaves], stretches[j.stretch.id], plan) for j in joints]
    ways = [_connection(way, joint) for joint in joints for way in joint.ways]
    return replace(
        plan,
        edges=edges,
        junctions=(*(junction for junction in plan.junctions if junction.id in used), *added),
        connections=(*plan.connections, *ways),
    )


def _connection(way: JointWay, joint: Joint) -> ConnectionPlan:
    lane, street = (way.edge.id, way.lane), (joint.stretch.id, way.street_lane)
    origin, target = (lane, street) if joint.leaves else (street, lane)
    piece = way.edge.lanes[way.lane].piece
    limit = min(way.edge.lanes[way.lane].speed_mps, turn_speed(way.shape_m))
    passes = joint.leaves and way.edge.length_m < ROOM_M
    return ConnectionPlan(origin, target, way.shape_m, limit, "", LaneConnection(piece, piece, ()), passes)


def first_to_go(joints: Sequence[Joint]) -> list[tuple[Ends, Ends]]:
    """Return pairs of ways into a street of which the first goes first.

    Where the map ends inside a junction, what is left of a connector has no room for a car that waits: who comes from
    there passes, in the order in which that junction let him go.
    """
    return [
        ((rim.edge.id, joint.stretch.id), (other.edge.id, joint.stretch.id))
        for joint in joints
        if joint.leaves
        for rim in joint.rims
        for other in joint.rims
        if rim.edge.length_m < ROOM_M <= other.edge.length_m
    ]


def _junction(joint: Joint, name: str, stretch: StreetStretch, plan: NetPlan) -> JunctionPlan:
    """Return the junction of *joint* with the trimmed *stretch*: its shape covers ways and ends of lanes."""
    ends = [_from_node(lane.shape_m, joint.leaves) for rim in joint.rims for lane in rim.edge.lanes]
    widths = [lane.width_m for rim in joint.rims for lane in rim.edge.lanes]
    ends += [_from_node(line, not joint.leaves) for line in stretch.lane_lines(plan.lefthand)]
    widths += stretch.street.widths_m
    strips = [
        LineString(way.shape_m).buffer(
            0.5 * min(way.edge.lanes[way.lane].width_m, WIDEST_WAY_M), cap_style="flat"
        )
        for way in joint.ways
    ]
    bars = [end_bar(line, width) for line, width in zip(ends, widths, strict=True)]
    shape = junction_shape(strips, bars, [LineString(line) for line in ends])
    middle = nearest_points(shape, MultiPoint([line[0] for line in ends]).centroid)[0]
    return JunctionPlan(name, (middle.x, middle.y), shape, "priority")


def _from_node(line_m: FloatArray, ends_there: bool) -> FloatArray:
    return line_m[::-1] if ends_there else line_m
