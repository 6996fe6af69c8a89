"""The OpenDRIVE of any SUMO net, with exact centre lines, through the writer that the map converter has."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from shapely.geometry import Polygon

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.export.lane_use import LaneKind, kind_of
from advdiff_sumo.maps import Lane, Link, RoadMap
from advdiff_sumo.maps.convert.layout.lane_paths import LaneConnection
from advdiff_sumo.maps.convert.layout.lane_segments import Piece
from advdiff_sumo.maps.convert.netplan import ConnectionPlan, EdgePlan, JunctionPlan, LanePlan, NetPlan
from advdiff_sumo.maps.convert.opendrive import write_opendrive
from advdiff_sumo.maps.convert.sources.arcline import drop_repeats
from advdiff_sumo.maps.convert.sources.source_map import LaneUse

_USES = {LaneKind.CAR: LaneUse.CAR, LaneKind.BUS: LaneUse.BUS, LaneKind.BICYCLE: LaneUse.BICYCLE}
_SHORTEST_M = 0.01
SAME_M = 0.02  # nets are written to the centimetre


def write_net_opendrive(road: RoadMap, path: Path) -> None:
    """Write *road* to *path* as OpenDRIVE 1.7; lanes for rails or people on foot are left out."""
    write_opendrive(plan_of(road), path, road.name, road.projection.proj4)


def plan_of(road: RoadMap) -> NetPlan:
    """Return what the writer needs to know of *road*; lanes of an edge are numbered as SUMO does, kept ones only."""
    kept = {
        edge.id: [road.lanes[name] for name in edge.lane_ids if kind_of(road.lanes[name]) in _USES]
        for edge in road.edges.values()
        if not edge.is_internal
    }
    place = {lane.id: (edge, index) for edge, lanes in kept.items() for index, lane in enumerate(lanes)}
    pieces = {name: Piece(number, 0.0, road.lanes[name].length_m) for number, name in enumerate(place)}
    edges = [
        EdgePlan(
            edge,
            road.edges[edge].from_junction,
            road.edges[edge].to_junction,
            tuple(_lane(lane, pieces[lane.id]) for lane in lanes),
            road.edges[edge].priority,
        )
        for edge, lanes in kept.items()
        if lanes
    ]
    ways = [
        ConnectionPlan(place[link.from_lane], place[link.to_lane], shape, _speed(road, link), "", way)
        for link in road.links.values()
        if link.from_lane in place and link.to_lane in place
        for shape in (_shape(road, link),)
        for way in (LaneConnection(pieces[link.from_lane], pieces[link.to_lane], ()),)
        if float(np.ptp(shape, axis=0).max()) > _SHORTEST_M
    ]
    junctions = [
        JunctionPlan(x.id, (float(x.xy_m[0]), float(x.xy_m[1])), Polygon(), x.type)
        for x in road.junctions.values()
    ]
    return NetPlan(tuple(edges), tuple(junctions), tuple(ways), road.lefthand)


def _lane(lane: Lane, piece: Piece) -> LanePlan:
    none = np.empty((0, 2))
    return LanePlan(
        piece, lane.centre_xy_m, lane.width_m, lane.speed_mps, _USES[kind_of(lane)], lane.id, none
    )


def _shape(road: RoadMap, link: Link) -> FloatArray:
    """Return the way through the junction from lane to lane, a straight one in nets without internal lanes."""
    ends = road.lanes[link.from_lane].centre_xy_m[-1:], road.lanes[link.to_lane].centre_xy_m[:1]
    inside = [road.lanes[name].centre_xy_m for name in link.via]
    return drop_repeats(np.vstack((ends[0], *inside, ends[1])), SAME_M)


def _speed(road: RoadMap, link: Link) -> float:
    return min(road.lanes[name].speed_mps for name in (*link.via, link.to_lane))
