"""Repair a source map where geometry leaves no doubt, and count each repair."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import replace

import numpy as np
import shapely
from scipy.spatial import cKDTree

from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.sources.source_map import SourceLane, SourceMap

GAP_M = 0.5  # a lane that begins at most this far from the end of another one, in its direction, follows it
SAME_WAY_RAD = 0.35  # largest change of heading between consecutive lanes
TINY_M = 1.0  # netconvert cannot hold shorter edges
SAME_LANE_M = 0.1  # lanes whose centre lines are nowhere farther apart are duplicates
LONGEST_CONNECTOR_M = 80.0  # longer lanes are not taken for connectors


def repair(source: SourceMap) -> SourceMap:
    """Return *source* without duplicate lanes, with missing links added and with connectors marked.

    Connectors are marked by geometry if the source marks none. Each repair is counted in ``notes``.
    """
    notes = Counter(source.notes)
    lanes, links, kept_for = _merge_duplicates(list(source.lanes), list(source.links), notes)
    signals = (replace(s, lanes=tuple(kept_for.get(lane, lane) for lane in s.lanes)) for s in source.signals)
    links = _add_links(lanes, links, notes)
    _count_gaps(lanes, links, notes)
    if not any(lane.is_connector for lane in lanes):
        lanes = _mark_connectors(lanes, links, notes)
    lanes = [_connector_if_tiny(lane, notes) for lane in lanes]
    return replace(source, lanes=tuple(lanes), links=tuple(links), signals=tuple(signals), notes=notes)


def _merge_duplicates(
    lanes: list[SourceLane], links: list[tuple[str, str]], notes: Counter[str]
) -> tuple[list[SourceLane], list[tuple[str, str]], dict[str, str]]:
    """Merge lanes with the same centre line into the first; return lanes, links, and its token by the removed ones."""
    lines = [shapely.LineString(lane.centre_m) for lane in lanes]
    starts = np.array([lane.centre_m[0] for lane in lanes])
    kept_for: dict[str, str] = {}
    for a, b in sorted(cKDTree(starts).query_pairs(SAME_LANE_M)):
        kept, removed = lanes[a], lanes[b]
        if kept.token in kept_for or removed.token in kept_for or kept.is_connector != removed.is_connector:
            continue
        same_end = np.hypot(*(kept.centre_m[-1] - removed.centre_m[-1])) <= SAME_LANE_M
        if same_end and shapely.hausdorff_distance(lines[a], lines[b], densify=0.1) <= SAME_LANE_M:
            kept_for[removed.token] = kept.token
    notes["duplicate lanes merged"] += len(kept_for)
    moved = [(kept_for.get(a, a), kept_for.get(b, b)) for a, b in links]
    return [lane for lane in lanes if lane.token not in kept_for], list(dict.fromkeys(moved)), kept_for


def _add_links(
    lanes: list[SourceLane], links: list[tuple[str, str]], notes: Counter[str]
) -> list[tuple[str, str]]:
    """Add links between lanes (not both connectors) that meet with equal heading, if one of them has no link there."""
    starts = np.array([lane.centre_m[0] for lane in lanes])
    ends = np.array([lane.centre_m[-1] for lane in lanes])
    has_next, has_previous = {a for a, _ in links}, {b for _, b in links}
    known = set(links)
    added = []
    for before_number, near in enumerate(cKDTree(starts).query_ball_point(ends, GAP_M)):
        for after_number in sorted(near):
            before, after = lanes[before_number], lanes[after_number]
            is_open = before.token not in has_next or after.token not in has_previous
            both_connectors = before.is_connector and after.is_connector
            may_link = before_number != after_number and is_open and not both_connectors
            if may_link and abs(polyline.turn_between(before.centre_m, after.centre_m)) <= SAME_WAY_RAD:
                added.append((before.token, after.token))
    new = [link for link in dict.fromkeys(added) if link not in known]
    notes["links added by geometry"] += len(new)
    return links + new


def _count_gaps(lanes: list[SourceLane], links: list[tuple[str, str]], notes: Counter[str]) -> None:
    """Count the links between lanes that do not quite meet."""
    line = {lane.token: lane.centre_m for lane in lanes}
    gaps = [float(np.hypot(*(line[a][-1] - line[b][0]))) for a, b in links]
    notes["gaps under 0.5 m bridged"] += sum(0.01 < gap <= GAP_M for gap in gaps)
    notes["gaps over 0.5 m bridged by a straight line"] += sum(gap > GAP_M for gap in gaps)


def _mark_connectors(
    lanes: list[SourceLane], links: list[tuple[str, str]], notes: Counter[str]
) -> list[SourceLane]:
    """Mark the connectors of a source that marks none: short linked lanes at a fork or merge, or crossed by others."""
    after, before = defaultdict(set), defaultdict(set)
    for a, b in links:
        after[a].add(b)
        before[b].add(a)
    lines = [shapely.LineString(lane.centre_m) for lane in lanes]
    left, _ = shapely.STRtree(lines).query(lines, predicate="crosses")
    crossed = {lanes[int(number)].token for number in left}
    marked = []
    for lane in lanes:
        forks = any(len(after[a]) > 1 for a in before[lane.token]) or any(
            len(before[b]) > 1 for b in after[lane.token]
        )
        is_linked = bool(after[lane.token]) and bool(before[lane.token])
        is_short = line_length_m(lane.centre_m) <= LONGEST_CONNECTOR_M
        marked.append(replace(lane, is_connector=is_linked and is_short and (forks or lane.token in crossed)))
    notes["lanes taken for connectors"] += sum(lane.is_connector for lane in marked)
    return marked


def _connector_if_tiny(lane: SourceLane, notes: Counter[str]) -> SourceLane:
    """Return *lane* as a connector if it is too short for an edge."""
    if lane.is_connector or line_length_m(lane.centre_m) >= TINY_M:
        return lane
    notes["lanes under a metre put inside a junction"] += 1
    return replace(lane, is_connector=True)
