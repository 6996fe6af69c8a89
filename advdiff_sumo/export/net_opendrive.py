"""Writes any SUMO net as OpenDRIVE with exact centre lines, by the writer of the map converter."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from shapely.geometry import Polygon

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.export.lane_use import LaneKind, lane_kind
from advdiff_sumo.maps import Lane, Link, RoadMap
from advdiff_sumo.maps.convert.layout.lane_paths import LaneConnection
from advdiff_sumo.maps.convert.layout.lane_segments import Piece
from advdiff_sumo.maps.convert.netplan import ConnectionPlan, EdgePlan, JunctionPlan, LanePlan, NetPlan
from advdiff_sumo.maps.convert.opendrive import write_opendrive
from advdiff_sumo.maps.convert.sources.arcline import drop_repeats
from advdiff_sumo.maps.convert.sources.source_map import LaneUse

_USES = {LaneKind.CAR: LaneUse.CAR, LaneKind.BUS: LaneUse.BUS, LaneKind.BICYCLE: LaneUse.BICYCLE}
_SHORTEST_M = 0.01  # connections of less extent are left out
SAME_M = 0.02  # nearer points are equal, as nets are written to the centimetre


def write_net_opendrive(road: RoadMap, path: Path) -> None:
    """Write *road* to *path* as OpenDRIVE 1.7; lanes for rails or pedestrians are left out."""
    write_opendrive(plan_of(road), path, road.name, road.projection.proj4)


def plan_of(road: RoadMap) -> NetPlan:
    """Return the plan of *road* for the writer; the remaining lanes of an edge are numbered in SUMO's order."""
    edge_lanes = {
        edge.id: [road.lanes[name] for name in edge.lane_ids if lane_kind(road.lanes[name]) in _USES]
        for edge in road.edges.values()
        if not edge.is_internal
    }
    indices = {
        lane.id: (edge, index) for edge, lanes in edge_lanes.items() for index, lane in enumerate(lanes)
    }
    pieces = {name: Piece(number, 0.0, road.lanes[name].length_m) for number, name in enumerate(indices)}
    edges = [
        EdgePlan(
            edge,
            road.edges[edge].from_junction,
            road.edges[edge].to_junction,
            tuple(_lane(lane, pieces[lane.id]) for lane in lanes),
            road.edges[edge].priority,
        )
        for edge, lanes in edge_lanes.items()
        if lanes
    ]
    connections = [
        ConnectionPlan(
            indices[link.from_lane], indices[link.to_lane], shape, _limit_mps(road, link), "", joint
        )
        for link in road.links.values()
        if link.from_lane in indices and link.to_lane in indices
        for shape in (_shape(road, link),)
        for joint in (LaneConnection(pieces[link.from_lane], pieces[link.to_lane], ()),)
        if float(np.ptp(shape, axis=0).max()) > _SHORTEST_M
    ]
    junctions = [
        JunctionPlan(x.id, (float(x.xy_m[0]), float(x.xy_m[1])), Polygon(), x.type)
        for x in road.junctions.values()
    ]
    return NetPlan(tuple(edges), tuple(junctions), tuple(connections), road.lefthand)


def _lane(lane: Lane, piece: Piece) -> LanePlan:
    empty = np.empty((0, 2))
    return LanePlan(
        piece, lane.centre_xy_m, lane.width_m, lane.speed_mps, _USES[lane_kind(lane)], lane.id, empty
    )


def _shape(road: RoadMap, link: Link) -> FloatArray:
    """Return the centre line (P, 2) of *link* over the junction; straight in nets without internal lanes."""
    ends = road.lanes[link.from_lane].centre_xy_m[-1:], road.lanes[link.to_lane].centre_xy_m[:1]
    inside = [road.lanes[name].centre_xy_m for name in link.via]
    return drop_repeats(np.vstack((ends[0], *inside, ends[1])), SAME_M)


def _limit_mps(road: RoadMap, link: Link) -> float:
    return min(road.lanes[name].speed_mps for name in (*link.via, link.to_lane))
