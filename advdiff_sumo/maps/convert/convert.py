"""An HD map of any format that is read → SUMO net, side-car and figures."""

from __future__ import annotations

import tempfile
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.core.whole_file import make_folder
from advdiff_sumo.maps.convert.annotate import annotate_net, restore_shapes
from advdiff_sumo.maps.convert.control import with_control
from advdiff_sumo.maps.convert.dividers import dashed_pairs
from advdiff_sumo.maps.convert.geometry_checks import check_geometry
from advdiff_sumo.maps.convert.lane_routes import plan_drivable
from advdiff_sumo.maps.convert.layout.cut_crossings import cut_at_crossings
from advdiff_sumo.maps.convert.layout.lane_paths import LaneConnection, find_connections
from advdiff_sumo.maps.convert.layout.lay_out import lay_out
from advdiff_sumo.maps.convert.layout.layout_state import Layout
from advdiff_sumo.maps.convert.layout.neighbours import SideBySide, find_side_by_side
from advdiff_sumo.maps.convert.narrow import Ends, unseen_conflicts, write_conflicts
from advdiff_sumo.maps.convert.netconvert import run_netconvert
from advdiff_sumo.maps.convert.netplan import NetPlan, Track
from advdiff_sumo.maps.convert.opendrive import write_opendrive
from advdiff_sumo.maps.convert.osm.add_streets import NO_STREETS, Streets, add_streets
from advdiff_sumo.maps.convert.osm.import_streets import PREFIX as STREET_PREFIX
from advdiff_sumo.maps.convert.plain_xml import write_plain_xml
from advdiff_sumo.maps.convert.projection import projection_of
from advdiff_sumo.maps.convert.repair import repair
from advdiff_sumo.maps.convert.rim import ReturnEdge, put_aside, return_edges
from advdiff_sumo.maps.convert.side_of_road import with_side_of_the_road
from advdiff_sumo.maps.convert.signals.fixed_times import set_fixed_times
from advdiff_sumo.maps.convert.signals.programs import write_programs
from advdiff_sumo.maps.convert.sources.nuscenes_json import read_nuscenes_map
from advdiff_sumo.maps.convert.sources.source_map import SourceLane, SourceMap
from advdiff_sumo.maps.convert.stop_lines import waiting_turns
from advdiff_sumo.maps.convert.widths import width_profile
from advdiff_sumo.maps.convert.write_sidecar import sidecar_path, write_sidecar
from advdiff_sumo.maps.on_foot.add_paths import FootPaths, add_foot_paths

SPEED_MPS = {True: 13.89, False: 11.18}  # by driving on the left: 50 km/h in Singapore, 25 mph in Boston
Crossings: TypeAlias = Literal["map", "guess", "none"]
"""Crossings of the map; those, or guessed ones where it has none; no crossings."""


@dataclass(frozen=True, eq=False)
class ConversionResult:
    """What a conversion made.

    Attributes:
        net: the SUMO net.
        sidecar: polygons beside it.
        given: the map as read.
        source: the map after repair.
        tracks: its lanes and connectors with everything measured on them.
        layout: which parts of them became edge lanes.
        plan: the net as planned.
        doubles: ways that SUMO cannot hold beside another one between the same two lanes.
        counts: everything mended, cut or left out.
        netconvert_warnings: netconvert's own warnings.
        foot_paths: what became of the crossings; None where none were wanted.
        streets: streets beyond the rim; None where none were wanted.
    """

    net: Path
    sidecar: Path
    given: SourceMap
    source: SourceMap
    tracks: list[Track]
    layout: Layout
    plan: NetPlan
    doubles: list[LaneConnection]
    counts: Counter[str]
    netconvert_warnings: tuple[str, ...]
    foot_paths: FootPaths | None = None
    streets: Streets | None = None


def convert_map(
    map_json: Path,
    out_net: Path,
    *,
    lefthand: bool | None = None,
    guess_signals: bool = False,
    opendrive: bool = False,
    crossings: Crossings = "map",
) -> ConversionResult:
    """Convert *map_json* to *out_net* and its side-car NAME.poly.xml.

    Args:
        map_json: nuScenes map expansion v1.3.
        out_net: net to be written, NAME.net.xml.
        lefthand: whether traffic keeps left; None: as the map, its place or its lanes say.
        guess_signals: put signals at large junctions where the map has none.
        opendrive: also write NAME.xodr.
        crossings: which crossings the net gets, with sidewalks between them.

    Raises:
        MapError: the map cannot be used.
        NetError: netconvert refused the plan.
    """
    source = read_nuscenes_map(Path(map_json))
    return convert_source(
        source,
        Path(out_net),
        lefthand=lefthand,
        guess_signals=guess_signals,
        opendrive=opendrive,
        crossings=crossings,
    )


def convert_source(
    source: SourceMap,
    out_net: Path,
    *,
    lefthand: bool | None = None,
    guess_signals: bool = False,
    opendrive: bool = False,
    close_rim: bool = False,
    osm: Path | None = None,
    crossings: Crossings = "map",
    cycle_for: int = 0,
) -> ConversionResult:
    """Convert a map already read; see :func:`convert_map`.

    With *osm*, an OpenStreetMap extract, its streets lead on where the map ends (:mod:`.osm.add_streets`). With
    *close_rim*, return edges beside the map lead from where it then ends to where it begins (:mod:`.rim`). With
    *cycle_for*, signals have fixed times for so many vehicles in the hour (:mod:`.signals.fixed_times`).
    """
    if source.projection is None:
        source = replace(source, projection=projection_of(source.location))
    given, source = source, repair(check_geometry(source))
    if lefthand is None:
        source = with_side_of_the_road(source)
    left = source.keeps_left if lefthand is None else lefthand
    tracks = measure_tracks(source, SPEED_MPS[left])
    layout = _laid_out(source, tracks, crossings)
    layout.counts["lanes without usable width, made 3.5 m wide"] = sum(
        not track.lane.is_connector and not len(track.widths) for track in tracks
    )
    ways, doubles = find_connections(layout)
    plan = with_control(plan_drivable(tracks, layout, ways, left), source, guess_signals)
    source = _with_idle_signals(source, plan)
    make_folder(out_net.parent, "choose another output path")
    joined, beyond = _beyond(plan, source, osm, close_rim, layout.counts)
    waiting = [*waiting_turns(plan, source), *beyond.streets.first_to_go]
    warnings = _build(joined, source, out_net, layout.counts, beyond, waiting)
    if opendrive:
        _write_opendrive(plan, source, out_net)
    layout.counts["lane shapes put back after netconvert"] = restore_shapes(out_net, joined)
    if beyond.returns:
        put_aside(out_net, plan, beyond.returns)
    annotate_net(out_net, plan)
    layout.counts["pairs of ways with stated conflicts"] = write_conflicts(out_net, joined)
    write_programs(out_net, plan)
    if cycle_for:
        layout.counts["signals timed for traffic"] = set_fixed_times(out_net, cycle_for)
    foot_paths = _foot_paths(out_net, source, crossings)
    write_sidecar(source, sidecar_path(out_net))
    return ConversionResult(
        out_net,
        sidecar_path(out_net),
        given,
        source,
        tracks,
        layout,
        plan,
        doubles,
        source.notes + layout.counts,
        warnings,
        foot_paths,
        beyond.streets if osm is not None else None,
    )


def _write_opendrive(plan: NetPlan, source: SourceMap, out_net: Path) -> None:
    """Write the map beside *out_net* as OpenDRIVE."""
    xodr = out_net.with_name(out_net.name.removesuffix(".net.xml") + ".xodr")
    write_opendrive(plan, xodr, source.location, source.projection)


@dataclass(frozen=True, eq=False)
class _Beyond:
    """What lies beyond the rim of a map."""

    returns: tuple[ReturnEdge, ...]
    streets: Streets


def _beyond(
    plan: NetPlan, source: SourceMap, osm: Path | None, close_rim: bool, counts: Counter[str]
) -> tuple[NetPlan, _Beyond]:
    """Return *plan* with what is beyond its rim joined to it, and that."""
    joined, streets = plan, NO_STREETS
    if osm is not None:
        joined, streets = add_streets(plan, source.drivable, osm, source.projection)
    returns, left_open = return_edges(joined, streets.following) if close_rim else ((), [])
    counts["return edges beyond the rim"] = len(returns)
    counts["beginnings on other lanes, without return edge"] = len(left_open)
    return joined, _Beyond(returns, streets)


def _laid_out(source: SourceMap, tracks: list[Track], crossings: Crossings) -> Layout:
    """Return the pieces of edges and junctions that *tracks* fall into, cut where crossings shall lie."""
    lines = [track.centre_m for track in tracks]
    connectors = [track.lane.is_connector for track in tracks]
    neighbours = neighbours_of(tracks, dashed_pairs(source))
    layout = lay_out(lines, connectors, _numbered_links(source), neighbours)
    if crossings != "none":
        cut_at_crossings(layout, lines, [track.width_m for track in tracks], source.crossings)
    return layout


def _foot_paths(net: Path, source: SourceMap, crossings: Crossings) -> FootPaths | None:
    """Write the crossings of *source*, or guessed ones, into *net*."""
    if crossings == "none":
        return None
    return add_foot_paths(
        net,
        source.crossings,
        guess=crossings == "guess",
        drivable=source.drivable,
        walkways=source.walkways,
    )


def _with_idle_signals(source: SourceMap, plan: NetPlan) -> SourceMap:
    """Name the lights that stop nobody."""
    if not plan.idle_signals:
        return source
    names = ", ".join(repr(token) for token in plan.idle_signals)
    sentence = (
        f"{source.path.name}: {len(plan.idle_signals)} of {len(source.signals)} traffic lights stop no lane: "
    )
    return replace(source, warnings=(*source.warnings, sentence + names))


def _build(
    plan: NetPlan,
    source: SourceMap,
    out_net: Path,
    counts: Counter[str],
    beyond: _Beyond,
    waiting: list[tuple[Ends, Ends]],
) -> tuple[str, ...]:
    """Write the net; a second time where netconvert lets ways go together that are too near each other.

    *waiting* tells ways of which the second waits for the first in any case.
    """
    with tempfile.TemporaryDirectory() as folder:

        def build(prohibitions: list[tuple[Ends, Ends]]) -> tuple[str, ...]:
            files = write_plain_xml(
                plan,
                Path(folder),
                source.location,
                source.projection,
                prohibitions,
                beyond.returns,
                beyond.streets.rows,
            )
            warnings = run_netconvert(files, out_net, lefthand=plan.lefthand)
            return tuple(line for line in warnings if f"'{STREET_PREFIX}" not in line)

        warnings = build(waiting)
        unseen = unseen_conflicts(plan, out_net)
        counts["conflicts in junctions added to netconvert's"] = len(unseen)
        settled = {frozenset(pair) for pair in waiting}
        added = [pair for pair in unseen if frozenset(pair) not in settled]
        return build(waiting + added) if added else warnings


def measure_tracks(source: SourceMap, default_speed_mps: float) -> list[Track]:
    """Return the lanes of *source* with widths measured and speeds filled in."""
    return [
        Track(
            lane,
            lane.centre_m,
            _widths(lane),
            lane.speed_mps if lane.speed_mps is not None else default_speed_mps,
        )
        for lane in source.lanes
    ]


def _widths(lane: SourceLane) -> FloatArray:
    """Return the width profile of *lane*: as stated, else as measured on its polygon."""
    if lane.width_m is not None:
        return np.array([[0.5 * line_length_m(lane.centre_m), lane.width_m]])
    return width_profile(lane.centre_m, lane.polygon)


def neighbours_of(tracks: list[Track], dashed: set[tuple[int, int]]) -> list[SideBySide]:
    """Return the pairs of road lanes (no connectors) that run side by side; *dashed* share a divider."""
    road = [number for number, track in enumerate(tracks) if not track.lane.is_connector]
    widths = [tracks[n].width_m for n in road]
    index = {number: position for position, number in enumerate(road)}
    known = {(index[a], index[b]) for a, b in dashed if a in index and b in index}
    pairs = find_side_by_side([tracks[n].centre_m for n in road], widths, known)
    return [SideBySide(road[p.left], road[p.right], p.left_m, p.right_m) for p in pairs]


def _numbered_links(source: SourceMap) -> list[tuple[int, int]]:
    number = {lane.token: index for index, lane in enumerate(source.lanes)}
    return [(number[a], number[b]) for a, b in source.links]
