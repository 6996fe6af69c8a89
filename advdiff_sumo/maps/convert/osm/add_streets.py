"""Streets of OpenStreetMap that lead on where an HD map ends, and back to where it begins.

What of them overlaps the map is cut away; where one fits to an end of the map, a junction joins them; the streets on
ways from the map back to it are kept.
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
from advdiff_sumo.maps.convert.narrow import Ends
from advdiff_sumo.maps.convert.netplan import NetPlan
from advdiff_sumo.maps.convert.osm.cut_streets import StreetStretch, StretchGraph, stretches_outside
from advdiff_sumo.maps.convert.osm.import_streets import import_streets
from advdiff_sumo.maps.convert.osm.joined_plan import JointNames, first_to_go, joined_plan
from advdiff_sumo.maps.convert.osm.rim_ends import RimEnd, candidates, rim_ends
from advdiff_sumo.maps.convert.osm.rim_joints import Joint, joints
from advdiff_sumo.maps.convert.osm.street_xml import NO_ROWS, StreetRows, street_rows


@dataclass(frozen=True, eq=False)
class Streets:
    """Streets beyond the rim.

    Attributes:
        rows: them as netconvert's plain XML, without the ways between them and the map.
        first_to_go: pairs of ways from the map into a street of which the second yields.
        following: edges that follow each of them, edges of the map among these.
        left: how many edges of the map lead into a street.
        entered: how many a street leads into.
        open_ends: how many ends and beginnings of the map no street fits to.
        edges: how many streets there are.
        km: their length.
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
    """Return *plan* with its rim joined to the streets in *osm*, and these.

    Args:
        plan: the net of the HD map.
        drivable: its drivable area.
        osm: an OpenStreetMap extract.
        projection: PROJ string of the map's frame.

    Raises:
        MapError: the extract cannot be used.
    """
    lines = np.vstack([lane.shape_m for edge in plan.edges for lane in edge.lanes])
    bounds = np.array([lines.min(axis=0), lines.max(axis=0)])
    with tempfile.TemporaryDirectory() as folder:
        net = import_streets(osm, projection, bounds, Path(folder), lefthand=plan.lefthand)
    area = _area(plan, drivable)
    stretches = stretches_outside(net, area)
    rims = rim_ends(plan)
    chosen, graph = _chosen(plan, candidates(rims, stretches, area), StretchGraph(net, stretches))
    kept = [_trimmed(stretch, chosen) for stretch in stretches if stretch.id in graph.names]
    names: JointNames = {
        (joint.stretch.id, joint.leaves): f"j{number}"
        for number, joint in enumerate(chosen, max(int(j.id[1:]) for j in plan.junctions) + 1)
    }
    joined = [rim.leaves for joint in chosen for rim in joint.rims]
    streets = Streets(
        street_rows(net, kept, graph, names),
        first_to_go(chosen),
        _following(chosen, graph),
        sum(joined),
        len(joined) - sum(joined),
        len(rims) - len(joined),
        len(kept),
        sum(stretch.length_m for stretch in kept) / 1000.0,
    )
    return joined_plan(plan, chosen, names, {stretch.id: stretch for stretch in kept}), streets


def _area(plan: NetPlan, drivable: BaseGeometry) -> BaseGeometry:
    """Return the area of the map: what is drivable, its lanes and its ways."""
    width_of = {(edge.id, n): lane.width_m for edge in plan.edges for n, lane in enumerate(edge.lanes)}
    lanes = [(lane.shape_m, lane.width_m) for edge in plan.edges for lane in edge.lanes]
    ways = [(way.shape_m, width_of[way.origin]) for way in plan.connections]
    strips = [
        LineString(line).buffer(0.5 * width, cap_style="flat")
        for line, width in (*lanes, *ways)
        if line_length_m(line) > 0.0
    ]
    return shapely.union_all([drivable, *strips])


def _chosen(
    plan: NetPlan, fits: Mapping[RimEnd, Sequence[StreetStretch]], graph: StretchGraph
) -> tuple[list[Joint], StretchGraph]:
    """Return the joints that streets between them serve, and the graph of these streets."""
    entered, left = (
        {stretch.id for rim, own in fits.items() if rim.leaves is leaves for stretch in own}
        for leaves in (True, False)
    )
    chosen = joints(plan, fits, graph.between(entered, left))
    while True:
        entered, left = (
            {joint.stretch.id for joint in chosen if joint.leaves is leaves} for leaves in (True, False)
        )
        parted = graph.parted(entered, left)
        kept = parted.between(entered, left)
        served = [joint for joint in chosen if joint.stretch.id in kept]
        if len(served) == len(chosen):
            return chosen, parted.only(kept)
        chosen = served


def _trimmed(stretch: StreetStretch, chosen: Sequence[Joint]) -> StreetStretch:
    """Return *stretch* without what gives way to its joints."""
    for joint in chosen:
        if joint.stretch.id == stretch.id:
            stretch = stretch.shorter(joint.gives_way_m, at_start=joint.leaves)
    return stretch


def _following(chosen: Sequence[Joint], graph: StretchGraph) -> dict[str, list[str]]:
    following: dict[str, dict[str, None]] = defaultdict(dict)
    for name in sorted(graph.names):
        following[name] = {}
    for _, a, b in graph.connections:
        following[a.id][b.id] = None
    for joint in chosen:
        for rim in () if joint.leaves else joint.rims:
            following[joint.stretch.id][rim.edge.id] = None
    return {name: list(after) for name, after in following.items()}
