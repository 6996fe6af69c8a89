"""Convert an HD map of any supported format to a SUMO net and its side-car file."""

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
from advdiff_sumo.maps.convert.lane_widths import width_profile
from advdiff_sumo.maps.convert.layout.cut_crossings import cut_at_crossings
from advdiff_sumo.maps.convert.layout.lane_paths import LaneConnection, find_connections
from advdiff_sumo.maps.convert.layout.lay_out import lay_out
from advdiff_sumo.maps.convert.layout.layout_state import Layout
from advdiff_sumo.maps.convert.layout.neighbours import SideBySide, find_side_by_side
from advdiff_sumo.maps.convert.missed_conflicts import unseen_conflicts, write_conflicts
from advdiff_sumo.maps.convert.netconvert import run_netconvert
from advdiff_sumo.maps.convert.netplan import Ends, NetPlan, Track
from advdiff_sumo.maps.convert.opendrive import write_opendrive
from advdiff_sumo.maps.convert.osm.add_streets import NO_STREETS, Streets, add_streets
from advdiff_sumo.maps.convert.osm.import_streets import PREFIX as STREET_PREFIX
from advdiff_sumo.maps.convert.plain_xml import write_plain_xml
from advdiff_sumo.maps.convert.projection import projection_of
from advdiff_sumo.maps.convert.repair import repair
from advdiff_sumo.maps.convert.rim import ReturnEdge, move_return_edges, return_edges
from advdiff_sumo.maps.convert.side_of_road import with_side_of_the_road
from advdiff_sumo.maps.convert.signals.fixed_times import set_fixed_times
from advdiff_sumo.maps.convert.signals.programs import write_programs
from advdiff_sumo.maps.convert.sources.nuscenes_map import read_nuscenes_map
from advdiff_sumo.maps.convert.sources.source_map import SourceLane, SourceMap
from advdiff_sumo.maps.convert.stop_lines import waiting_turns
from advdiff_sumo.maps.convert.write_sidecar import sidecar_path, write_sidecar
from advdiff_sumo.maps.on_foot.add_paths import FootPaths, add_foot_paths

# Default speed limit by left-hand traffic: 50 km/h (Singapore) if true, 25 mph (Boston) if false.
SPEED_MPS = {True: 13.89, False: 11.18}
Crossings: TypeAlias = Literal["map", "guess", "none"]
"""Pedestrian crossings: those of the map; those, or guessed ones where the map has none; none at all."""


@dataclass(frozen=True, eq=False)
class ConversionResult:
    """Result of a conversion.

    Attributes:
        net: path of the SUMO net.
        sidecar: path of the polygons that belong to it.
        given: the map as read.
        source: the map after repair.
        tracks: its lanes and connectors with their measured widths and speed limits.
        layout: which parts of them became edge lanes.
        plan: the net as planned.
        duplicates: connections left out because SUMO holds only one between the same two lanes.
        counts: how many items of each kind were repaired, cut or left out.
        netconvert_warnings: netconvert's own warnings.
        foot_paths: which crossings the net got; None if none were requested.
        streets: OpenStreetMap streets beyond the rim of the map; None if none were requested.
    """

    net: Path
    sidecar: Path
    given: SourceMap
    source: SourceMap
    tracks: list[Track]
    layout: Layout
    plan: NetPlan
    duplicates: list[LaneConnection]
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
        out_net: path of the net to write, NAME.net.xml.
        lefthand: whether traffic keeps left; None: derived from the map, its location or its lanes.
        guess_signals: add signals at large junctions if the map has none.
        opendrive: also write NAME.xodr.
        crossings: which pedestrian crossings the net gets, with sidewalks between them.

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
    """Convert a map that is already read; see :func:`convert_map` for the other arguments and errors.

    *osm*: OpenStreetMap extract whose streets continue the map (:mod:`.osm.add_streets`); with *close_rim*, edges lead
    from its exits back to its entries (:mod:`.rim`). *cycle_for*: vehicles per hour of fixed-time signals; 0: none.
    """
    if source.projection is None:
        source = replace(source, projection=projection_of(source.location))
    given, source = source, repair(check_geometry(source))
    source = with_side_of_the_road(source) if lefthand is None else source
    keeps_left = source.keeps_left if lefthand is None else lefthand
    tracks = measure_tracks(source, SPEED_MPS[keeps_left])
    layout = _make_layout(source, tracks, crossings)
    layout.counts["lanes without usable width, made 3.5 m wide"] = sum(
        not track.lane.is_connector and not len(track.widths) for track in tracks
    )
    connections, duplicates = find_connections(layout)
    plan = with_control(plan_drivable(tracks, layout, connections, keeps_left), source, guess_signals)
    source = _with_idle_signal_warning(source, plan)
    make_folder(out_net.parent, "choose another output path")
    extended_plan, extension = _extend_rim(plan, source, osm, close_rim, layout.counts)
    prohibitions = [*waiting_turns(plan, source), *extension.streets.first_to_go]
    warnings = _write_net(extended_plan, source, out_net, layout.counts, extension, prohibitions)
    if opendrive:
        _write_opendrive(plan, source, out_net)
    layout.counts["lane shapes put back after netconvert"] = restore_shapes(out_net, extended_plan)
    if extension.returns:
        move_return_edges(out_net, plan, extension.returns)
    annotate_net(out_net, plan)
    layout.counts["pairs of ways with stated conflicts"] = write_conflicts(out_net, extended_plan)
    write_programs(out_net, plan)
    if cycle_for:
        layout.counts["signals timed for traffic"] = set_fixed_times(out_net, cycle_for)
    foot_paths = _add_foot_paths(out_net, source, crossings)
    write_sidecar(source, sidecar_path(out_net))
    return ConversionResult(
        out_net,
        sidecar_path(out_net),
        given,
        source,
        tracks,
        layout,
        plan,
        duplicates,
        source.notes + layout.counts,
        warnings,
        foot_paths,
        extension.streets if osm is not None else None,
    )


def _write_opendrive(plan: NetPlan, source: SourceMap, out_net: Path) -> None:
    """Write the planned net as OpenDRIVE into the folder of *out_net*."""
    xodr = out_net.with_name(out_net.name.removesuffix(".net.xml") + ".xodr")
    write_opendrive(plan, xodr, source.location, source.projection)


@dataclass(frozen=True, eq=False)
class _RimExtension:
    """Return edges and streets beyond the rim of a map."""

    returns: tuple[ReturnEdge, ...]
    streets: Streets


def _extend_rim(
    plan: NetPlan, source: SourceMap, osm: Path | None, close_rim: bool, counts: Counter[str]
) -> tuple[NetPlan, _RimExtension]:
    """Return *plan* with its rim joined to the streets of *osm*, and the streets and return edges beyond the rim."""
    extended_plan, streets = plan, NO_STREETS
    if osm is not None:
        extended_plan, streets = add_streets(plan, source.drivable, osm, source.projection)
    returns, left_open = return_edges(extended_plan, streets.following) if close_rim else ((), [])
    counts["return edges beyond the rim"] = len(returns)
    counts["beginnings on other lanes, without return edge"] = len(left_open)
    return extended_plan, _RimExtension(returns, streets)


def _make_layout(source: SourceMap, tracks: list[Track], crossings: Crossings) -> Layout:
    """Divide *tracks* into edges and junctions; cut edges at pedestrian crossings unless *crossings* is "none"."""
    lines = [track.centre_m for track in tracks]
    connectors = [track.lane.is_connector for track in tracks]
    neighbours = neighbours_of(tracks, dashed_pairs(source))
    layout = lay_out(lines, connectors, _numbered_links(source), neighbours)
    if crossings != "none":
        cut_at_crossings(layout, lines, [track.width_m for track in tracks], source.crossings)
    return layout


def _add_foot_paths(net: Path, source: SourceMap, crossings: Crossings) -> FootPaths | None:
    """Write the pedestrian crossings of *source*, or guessed ones, into *net*; do nothing if *crossings* is "none"."""
    if crossings == "none":
        return None
    return add_foot_paths(
        net,
        source.crossings,
        guess=crossings == "guess",
        drivable=source.drivable,
        walkways=source.walkways,
    )


def _with_idle_signal_warning(source: SourceMap, plan: NetPlan) -> SourceMap:
    """Return *source* with a warning that names the traffic lights that stop no lane, if there are any."""
    if not plan.idle_signals:
        return source
    names = ", ".join(repr(token) for token in plan.idle_signals)
    sentence = (
        f"{source.path.name}: {len(plan.idle_signals)} of {len(source.signals)} traffic lights stop no lane: "
    )
    return replace(source, warnings=(*source.warnings, sentence + names))


def _write_net(
    plan: NetPlan,
    source: SourceMap,
    out_net: Path,
    counts: Counter[str],
    extension: _RimExtension,
    prohibitions: list[tuple[Ends, Ends]],
) -> tuple[str, ...]:
    """Write the net with netconvert and return netconvert's warnings.

    If netconvert misses conflicts between connections that run too close to each other, the net is written again
    with a prohibition for each of them. *prohibitions* are pairs of connections of which the second always yields
    to the first.
    """
    with tempfile.TemporaryDirectory() as folder:

        def write(all_prohibitions: list[tuple[Ends, Ends]]) -> tuple[str, ...]:
            files = write_plain_xml(
                plan,
                Path(folder),
                source.location,
                source.projection,
                all_prohibitions,
                extension.returns,
                extension.streets.rows,
            )
            warnings = run_netconvert(files, out_net, lefthand=plan.lefthand)
            return tuple(line for line in warnings if f"'{STREET_PREFIX}" not in line)

        warnings = write(prohibitions)
        unseen = unseen_conflicts(plan, out_net)
        counts["conflicts in junctions added to netconvert's"] = len(unseen)
        given_pairs = {frozenset(pair) for pair in prohibitions}
        added = [pair for pair in unseen if frozenset(pair) not in given_pairs]
        return write(prohibitions + added) if added else warnings


def measure_tracks(source: SourceMap, default_speed_mps: float) -> list[Track]:
    """Return the lanes of *source* with measured widths; lanes without a speed limit get *default_speed_mps*."""
    return [
        Track(
            lane,
            lane.centre_m,
            _width_profile(lane),
            lane.speed_mps if lane.speed_mps is not None else default_speed_mps,
        )
        for lane in source.lanes
    ]


def _width_profile(lane: SourceLane) -> FloatArray:
    """Return rows (K, 2) of arc length and width of *lane* in m: as stated, else as measured on its polygon."""
    if lane.width_m is not None:
        return np.array([[0.5 * line_length_m(lane.centre_m), lane.width_m]])
    return width_profile(lane.centre_m, lane.polygon)


def neighbours_of(tracks: list[Track], dashed: set[tuple[int, int]]) -> list[SideBySide]:
    """Return the pairs of road lanes (not connectors) that run side by side.

    Args:
        tracks: lanes and connectors.
        dashed: (left, right) lane numbers of pairs that share a dashed divider.
    """
    road_lanes = [number for number, track in enumerate(tracks) if not track.lane.is_connector]
    widths = [tracks[n].width_m for n in road_lanes]
    index = {number: position for position, number in enumerate(road_lanes)}
    known = {(index[a], index[b]) for a, b in dashed if a in index and b in index}
    pairs = find_side_by_side([tracks[n].centre_m for n in road_lanes], widths, known)
    return [SideBySide(road_lanes[p.left], road_lanes[p.right], p.left_m, p.right_m) for p in pairs]


def _numbered_links(source: SourceMap) -> list[tuple[int, int]]:
    """Return the links of *source* as pairs of lane numbers."""
    number = source.number_of
    return [(number[a], number[b]) for a, b in source.links]
