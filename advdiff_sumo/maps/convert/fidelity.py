"""Measure how well a written net reproduces the map that it was made from."""

from __future__ import annotations

import itertools
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import shapely

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.convert import ConversionResult
from advdiff_sumo.maps.convert.dividers import dashed_pairs
from advdiff_sumo.maps.convert.lane_routes import graph_of_net, undrivable_routes
from advdiff_sumo.maps.convert.lane_widths import width_between
from advdiff_sumo.maps.convert.netconvert import EXPLAINED
from advdiff_sumo.maps.convert.osm.add_streets import Streets
from advdiff_sumo.maps.convert.routability import routability
from advdiff_sumo.maps.convert.signals.programs import never_red
from advdiff_sumo.maps.convert.written_net import WrittenNet, read_net
from advdiff_sumo.maps.on_foot.add_paths import FootPaths

STEP_M = 0.5  # distance between the points at which lines are compared


@dataclass(frozen=True)
class Fidelity:
    """All figures of a conversion; lengths in m.

    Attributes:
        location: name of the place, as in driving logs.
        figures: nested plain values by topic, ready for JSON.
    """

    location: str
    figures: dict[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"location": self.location, **self.figures}


def measure(result: ConversionResult) -> Fidelity:
    """Measure a conversion on the net as netconvert wrote it and return all figures."""
    net = read_net(result.net)
    lines = _lines_by_lane(result, net)
    lengths = {edge.id: edge.length_m for edge in result.plan.edges}
    return Fidelity(
        result.source.location,
        {
            "source": result.source.path.name,
            "lanes": _lane_counts(result, net, lines),
            "centre_line_error_m": _centre_line_errors(result, net, lines),
            "width_error_m": _width_errors(result, net),
            "connections": _connection_counts(result, net),
            "signals": {
                "given": len(result.source.signals),
                "that_stop_nobody": [*result.plan.idle_signals, *never_red(result.net, result.plan)],
            },
            "crossings": _crossing_counts(result.foot_paths),
            "lane_changes": lane_change_share(result),
            "drivable_area": _overlap(result, net),
            "mended_and_cut": dict(sorted(result.counts.items())),
            "netconvert_warnings": warning_summary(result.netconvert_warnings),
            "warnings": list(result.source.warnings),
            "routes_no_lane_follows": [
                " → ".join(route) for route in undrivable_routes(graph_of_net(result.net))
            ],
            "routability": routability(net.next_edges, lengths),
            **({"streets_beyond_the_rim": _streets(result.streets, net, lengths)} if result.streets else {}),
        },
    )


def _streets(streets: Streets, net: WrittenNet, length_m: Mapping[str, float]) -> dict[str, Any]:
    """Return how many OpenStreetMap streets join the map, and how well the map's edges are connected without them."""
    in_map = {
        name: [n for n in successors if n in length_m]
        for name, successors in net.next_edges.items()
        if name in length_m
    }
    return {
        "edges_that_lead_into_streets": streets.left,
        "edges_that_streets_lead_into": streets.entered,
        "ends_without_street": streets.open_ends,
        "streets": streets.edges,
        "km": round(streets.km, 2),
        "largest_part_share_of_length_without": routability(in_map, length_m)["largest_part_share_of_length"],
    }


def _lines_by_lane(result: ConversionResult, net: WrittenNet) -> dict[int, list[FloatArray]]:
    """Return the lines (N, 2) that represent each source lane in the net: edge lanes and connections on it."""
    lines: dict[int, list[FloatArray]] = defaultdict(list)
    for piece, key in result.plan.lane_of.items():
        if key in net.lanes:
            lines[piece.lane].append(net.lanes[key][0])
    for connection in result.plan.connections:
        written = net.connections.get(connection.key)
        for lane in {part.lane for part in connection.lane_connection.parts} if written else ():
            lines[lane].append(written[0])  # type: ignore[index]  # the loop is empty when it is None
    return lines


def _lane_counts(
    result: ConversionResult, net: WrittenNet, lines: dict[int, list[FloatArray]]
) -> dict[str, Any]:
    """Return how many lanes the source and the net hold, and which are left out or lost."""
    lanes = result.source.lanes
    lost = [lane.token for number, lane in enumerate(lanes) if number not in lines]
    given = result.given.stated.lanes if result.given.stated else len(result.given.lanes)
    return {
        "given": given,
        "held": len(lanes) - len(lost) + result.source.notes["duplicate lanes merged"],
        "left_out": list(result.source.left_out),
        "source_lanes": sum(not lane.is_connector for lane in lanes),
        "source_connectors": sum(lane.is_connector for lane in lanes),
        "edges": len(result.plan.edges),
        "edge_lanes": len(net.lanes),
        "connections": len(net.connections),
        "junctions": len(result.plan.junctions),
        "lost": lost,
    }


def _centre_line_errors(
    result: ConversionResult, net: WrittenNet, lines: dict[int, list[FloatArray]]
) -> dict[str, Any]:
    """Return distances from source lines to net lines (is a lane missing?) and back (is a lane invented?)."""
    source = [lane.centre_m for lane in result.source.lanes]
    to_net = [_distances(line, lines[number]) for number, line in enumerate(source) if number in lines]
    to_source = [
        _distances(shape, [source[n] for n in numbers]) for shape, numbers in _net_lines(result, net)
    ]
    return {"source_to_net": statistics_of(to_net), "net_to_source": statistics_of(to_source)}


def _net_lines(result: ConversionResult, net: WrittenNet) -> Iterable[tuple[FloatArray, list[int]]]:
    """Yield each line (N, 2) of the net with the numbers of the source lanes that it was made from."""
    for piece, key in result.plan.lane_of.items():
        if key in net.lanes:
            yield net.lanes[key][0], [piece.lane]
    for connection in result.plan.connections:
        written = net.connections.get(connection.key)
        if written:
            yield written[0], list(connection.lane_connection.lanes)


def _distances(line: FloatArray, references: Sequence[FloatArray]) -> FloatArray:
    """Return the distances (M,) in m of points every half metre on *line* to the nearest of *references*."""
    points = shapely.points(polyline.resample(line, STEP_M)[0])
    return np.asarray(shapely.distance(points, shapely.MultiLineString(list(references))))


def statistics_of(values: Sequence[FloatArray]) -> dict[str, float | None]:
    """Return median, 95th percentile and maximum of all finite *values* together; None if there is none."""
    known = np.concatenate([np.zeros(0), *values])
    known = known[np.isfinite(known)]
    if not len(known):
        return {"median": None, "p95": None, "max": None}
    return {
        "median": round(float(np.median(known)), 4),
        "p95": round(float(np.percentile(known, 95)), 4),
        "max": round(float(known.max()), 4),
    }


def _width_errors(result: ConversionResult, net: WrittenNet) -> dict[str, Any]:
    """Return |net width − median source width| of each edge lane, and |source width − net width| along the lanes."""
    errors, deviations = [], []
    for piece, key in result.plan.lane_of.items():
        profile = result.tracks[piece.lane].widths
        if key in net.lanes and len(profile):
            errors.append(abs(net.lanes[key][1] - width_between(profile, piece.from_m, piece.to_m)))
            inside = profile[(profile[:, 0] >= piece.from_m) & (profile[:, 0] <= piece.to_m), 1]
            deviations.append(np.abs(inside - net.lanes[key][1]))
    return {
        "of_the_median": statistics_of([np.array(errors)]),
        "along_the_lane": statistics_of(deviations),
    }


def _connection_counts(result: ConversionResult, net: WrittenNet) -> dict[str, Any]:
    """Return which links of the source the net holds; a link is a step from one lane to the next on a connection."""
    held: set[tuple[int, int]] = set()
    for connection in result.plan.connections:
        if connection.key in net.connections:
            held |= set(itertools.pairwise(connection.lane_connection.lanes))
    links = result.layout.links
    number = result.source.number_of
    stated = {(number[a], number[b]) for a, b in result.given.links if a in number and b in number}
    tokens = [lane.token for lane in result.source.lanes]
    given = result.given.stated.links if result.given.stated else len(result.given.links)
    return {
        "given": given,
        "links": len(links),
        "kept": sum(link in held for link in links if link in stated),
        "repaired": sum(link in held for link in links if link not in stated),
        "lost": [[tokens[a], tokens[b]] for a, b in links if (a, b) not in held],
        "invented": sorted(map(list, net.connections.keys() - result.plan.connection_of.keys()), key=str),
        "second_ways_left_out": [[tokens[n] for n in duplicate.lanes] for duplicate in result.duplicates],
        "parts_drawn_by_several_ways": _repeated_parts(result),
    }


def _crossing_counts(paths: FootPaths | None) -> dict[str, Any] | None:
    """Return how many crossings the net holds, and why others are left out; None if none were requested."""
    if paths is None:
        return None
    return {
        "given": paths.given,
        "guessed": paths.guessed,
        "kept": paths.kept,
        "sumo_crossings": paths.crossings,
        "left_out": {reason: list(map(list, places)) for reason, places in sorted(paths.left_out.items())},
        "sidewalk_m": paths.sidewalk_m,
        "share_on_walkways": paths.on_walkways,
    }


def _repeated_parts(result: ConversionResult) -> dict[str, Any]:
    """Return how many lanes have parts that several connections share (before a fork, after a merge), and metres."""
    uses = Counter(part for c in result.plan.connections for part in c.lane_connection.parts)
    repeats = {part: count - 1 for part, count in uses.items() if count > 1}
    metres = sum(part.length_m * count for part, count in repeats.items())
    return {"lanes": len({part.lane for part in repeats}), "metres": round(metres, 1)}


def lane_change_share(result: ConversionResult) -> dict[str, Any]:
    """Return how many pairs of lanes with a dashed divider between them are neighbours in one SUMO edge."""
    neighbours: set[tuple[int, int]] = set()
    for group in result.layout.groups:
        neighbours |= {(left.lane, right.lane) for right, left in itertools.pairwise(group)}
    pairs = dashed_pairs(result.source)
    tokens = [lane.token for lane in result.source.lanes]
    apart = sorted(pair for pair in pairs if pair not in neighbours)
    share = 1.0 - len(apart) / len(pairs) if pairs else None
    return {
        "dashed_pairs": len(pairs),
        "neighbours_in_one_edge": len(pairs) - len(apart),
        "share": share if share is None else round(share, 4),
        "apart": [[tokens[left], tokens[right]] for left, right in apart],
    }


def _overlap(result: ConversionResult, net: WrittenNet) -> dict[str, Any]:
    """Return the area of the net's lanes and its intersection over union with the source's drivable area."""
    strips = [
        shapely.LineString(line).buffer(0.5 * width, cap_style="flat")
        for line, width in (*net.lanes.values(), *net.connections.values())
    ]
    lanes = shapely.union_all(strips) if strips else shapely.MultiPolygon()
    truth = result.source.drivable
    if truth.is_empty:
        return {"iou_of_lanes": None, "net_lanes_m2": round(lanes.area, 1)}
    union = lanes.union(truth).area
    return {
        "iou_of_lanes": round(lanes.intersection(truth).area / union, 4),
        "net_lanes_m2": round(lanes.area, 1),
        "source_m2": round(truth.area, 1),
        "side_car": "the drivable area itself, unchanged",
    }


def warning_summary(warnings: Iterable[str]) -> list[dict[str, Any]]:
    """Return netconvert's warnings by kind, each with its count, an example and its meaning."""
    kinds: Counter[str] = Counter()
    example: dict[str, str] = {}
    for warning in warnings:
        kind = re.sub(r"'[^']*'|-?\d+(\.\d+)?|\S+_\d+->\S+", "#", warning.removeprefix("Warning: "))
        if "total messages of type" in kind:
            continue
        kinds[kind] += 1
        example.setdefault(kind, warning)
    return [
        {
            "kind": kind,
            "count": count,
            "example": example[kind],
            "meaning": next((text for start, text in EXPLAINED.items() if start in kind), "not explained"),
        }
        for kind, count in sorted(kinds.items())
    ]
