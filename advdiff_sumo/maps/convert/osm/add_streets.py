"""Add OpenStreetMap streets that lead from the exits of an HD map and back to its entries.

1. Import the streets and cut away what overlaps the map.
2. Join streets to the lanes at the rim of the map that they fit, by a junction each.
3. Keep the streets on routes from the map back to the map.
"""

from __future__ import annotations

import tempfile
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import shapely
from shapely.geometry import LineString
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert.netplan import Ends, NetPlan
from advdiff_sumo.maps.convert.osm.cut_streets import StreetStretch, StretchGraph, stretches_outside
from advdiff_sumo.maps.convert.osm.import_streets import import_streets
from advdiff_sumo.maps.convert.osm.joined_plan import JointNames, first_to_go, joined_plan
from advdiff_sumo.maps.convert.osm.rim_ends import RimEnd, candidates, rim_ends
from advdiff_sumo.maps.convert.osm.rim_joints import Joint, build_joints
from advdiff_sumo.maps.convert.osm.street_xml import NO_ROWS, StreetRows, street_rows


@dataclass(frozen=True, eq=False)
class Streets:
    """Streets beyond the rim of a map.

    Attributes:
        rows: the streets as netconvert's plain XML, without the connections between them and the map.
        first_to_go: pairs of connections from the map into a street; the second yields to the first.
        following: the edges that follow each street, including edges of the map.
        left: number of map edges that lead into a street.
        entered: number of map edges that a street leads into.
        open_ends: number of exits and entries of the map without a street.
        edges: number of streets.
        km: their total length.
    """

    rows: StreetRows = NO_ROWS
    first_to_go: Sequence[tuple[Ends, Ends]] = ()
    following: Mapping[str, Sequence[str]] = field(default_factory=dict)
    left: int = 0
    entered: int = 0
    open_ends: int = 0
    edges: int = 0
    km: float = 0.0


NO_STREETS = Streets()


def add_streets(
    plan: NetPlan, drivable: BaseGeometry, osm: Path, projection: str | None
) -> tuple[NetPlan, Streets]:
    """Return *plan* with its rim joined to the streets in *osm*, and these streets.

    Args:
        plan: the planned net of the HD map.
        drivable: the drivable area of the HD map.
        osm: an OpenStreetMap extract.
        projection: PROJ string of the map's frame.

    Raises:
        MapError: the extract cannot be used.
    """
    bounds = np.array([plan.lane_points_m.min(axis=0), plan.lane_points_m.max(axis=0)])
    with tempfile.TemporaryDirectory() as folder:
        net = import_streets(osm, projection, bounds, Path(folder), lefthand=plan.lefthand)
    area = _map_area(plan, drivable)
    stretches = stretches_outside(net, area)
    rims = rim_ends(plan)
    joints, graph = _choose_joints(plan, candidates(rims, stretches, area), StretchGraph(net, stretches))
    kept = [_trimmed(stretch, joints) for stretch in stretches if stretch.id in graph.names]
    names: JointNames = {
        (joint.stretch.id, joint.is_exit): f"j{number}"
        for number, joint in enumerate(joints, max(int(j.id[1:]) for j in plan.junctions) + 1)
    }
    joined_exits = [rim.is_exit for joint in joints for rim in joint.rims]
    streets = Streets(
        street_rows(net, kept, graph, names),
        first_to_go(joints),
        _following(joints, graph),
        sum(joined_exits),
        len(joined_exits) - sum(joined_exits),
        len(rims) - len(joined_exits),
        len(kept),
        sum(stretch.length_m for stretch in kept) / 1000.0,
    )
    return joined_plan(plan, joints, names, {stretch.id: stretch for stretch in kept}), streets


def _map_area(plan: NetPlan, drivable: BaseGeometry) -> BaseGeometry:
    """Return the area of the map: its drivable area, lanes and connections."""
    lanes = [(lane.shape_m, lane.width_m) for edge in plan.edges for lane in edge.lanes]
    connections = [
        (c.shape_m, plan.edge_of[c.origin[0]].lanes[c.origin[1]].width_m) for c in plan.connections
    ]
    strips = [
        LineString(line).buffer(0.5 * width, cap_style="flat")
        for line, width in (*lanes, *connections)
        if line_length_m(line) > 0.0
    ]
    return shapely.union_all([drivable, *strips])


def _choose_joints(
    plan: NetPlan, fits: Mapping[RimEnd, Sequence[StreetStretch]], graph: StretchGraph
) -> tuple[list[Joint], StretchGraph]:
    """Return the joints whose streets lie on a route from the map back to the map, and the graph of these streets.

    Joints without such a route are removed repeatedly, until all have one. *fits* are the stretches that fit each end
    of the map, best first; *graph* holds all stretches.
    """
    entered, left = (
        {stretch.id for rim, fitting in fits.items() if rim.is_exit is is_exit for stretch in fitting}
        for is_exit in (True, False)
    )
    joints = build_joints(plan, fits, graph.between(entered, left))
    while True:
        entered, left = (
            {joint.stretch.id for joint in joints if joint.is_exit is is_exit} for is_exit in (True, False)
        )
        separated = graph.separated(entered, left)
        kept = separated.between(entered, left)
        used = [joint for joint in joints if joint.stretch.id in kept]
        if len(used) == len(joints):
            return joints, separated.only(kept)
        joints = used


def _trimmed(stretch: StreetStretch, joints: Sequence[Joint]) -> StreetStretch:
    """Return *stretch* without the parts that its joints replace by bends."""
    for joint in joints:
        if joint.stretch.id == stretch.id:
            stretch = stretch.shorter(joint.trim_m, at_start=joint.is_exit)
    return stretch


def _following(joints: Sequence[Joint], graph: StretchGraph) -> dict[str, list[str]]:
    """Return the edges that follow each street, including edges of the map."""
    following: dict[str, dict[str, None]] = defaultdict(dict)
    for name in sorted(graph.names):
        following[name] = {}
    for _, a, b in graph.connections:
        following[a.id][b.id] = None
    for joint in joints:
        for rim in () if joint.is_exit else joint.rims:
            following[joint.stretch.id][rim.edge.id] = None
    return {name: list(after) for name, after in following.items()}
