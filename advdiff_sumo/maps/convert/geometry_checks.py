"""Is each path where its polygon and its neighbours say? What contradicts them is left out, with a sentence each."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import shapely
from shapely.geometry import LineString

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert.sources.map_faults import MapFaults
from advdiff_sumo.maps.convert.sources.source_map import SourceLane, SourceMap

OUTSIDE_M = 1.0  # a centre line farther outside its polygon is not in it
OUTSIDE_SHARE = 0.3  # so much of a centre line outside its polygon contradicts it
MEETS_M = 1.0  # two lanes whose ends lie nearer meet
FAR_LINK_M = 10.0  # a link over a larger gap joins lanes that are not neighbours
BACKWARDS_RAD = 2.4  # a link that turns on the spot by more leads backwards
FULL_TURN_RAD = 1.9 * math.pi


def check_geometry(source: SourceMap) -> SourceMap:
    """Return *source* without paths and links that contradict the rest of it.

    Left out are paths that turn full circle or close on themselves, paths outside their polygon that no neighbour
    confirms (a polygon is left out instead where a neighbour does), links of a lane to itself, over more than
    10 m, or backwards. Each gets a sentence in ``warnings`` (20 of a kind at most) and is counted in ``notes``.
    """
    faults = MapFaults(source.path)
    lanes = [lane for lane in source.lanes if not _is_loop(lane, faults)]
    by_token = {lane.token: lane for lane in lanes}
    links = [
        link for link in source.links if set(link) <= by_token.keys() and _is_sound(by_token, link, faults)
    ]
    lanes = _in_their_polygons(lanes, links, faults)
    known = {lane.token for lane in lanes}
    gone = tuple(lane.token for lane in source.lanes if lane.token not in known)
    return replace(
        source,
        lanes=tuple(lanes),
        links=tuple(link for link in links if set(link) <= known),
        left_out=source.left_out + gone,
        notes=source.notes + faults.notes,
        warnings=source.warnings + faults.sentences(),
    )


def _is_loop(lane: SourceLane, faults: MapFaults) -> bool:
    """Return whether a path turns full circle or ends where it begins."""
    line = lane.centre_m
    yaw = np.unwrap(np.arctan2(*np.diff(line, axis=0).T[::-1]))
    closed = math.dist(line[0], line[-1]) < MEETS_M and line_length_m(line) > 5.0 * MEETS_M
    if not closed and abs(float(yaw[-1] - yaw[0])) < FULL_TURN_RAD:
        return False
    faults.add("paths that run in a circle", f"lane {lane.token!r} runs in a circle and is left out")
    return True


def _is_sound(lanes: dict[str, SourceLane], link: tuple[str, str], faults: MapFaults) -> bool:
    before, after = lanes[link[0]].centre_m, lanes[link[1]].centre_m
    gap = math.dist(before[-1], after[0])
    if link[0] == link[1]:
        faults.add("links of a lane to itself", f"lane {link[0]!r} is linked to itself; the link is left out")
    elif gap > FAR_LINK_M:
        faults.add(
            "links to far lanes",
            f"lane {link[0]!r} ends {gap:.0f} m from the beginning of {link[1]!r}; the link is left out",
        )
    elif _turn(before, after) > BACKWARDS_RAD:
        faults.add(
            "links backwards",
            f"lane {link[1]!r} begins against the direction of {link[0]!r}; the link is left out",
        )
    else:
        return True
    return False


def _turn(before: FloatArray, after: FloatArray) -> float:
    """Return the angle in rad between the end of one line and the beginning of another."""
    last, first = before[-1] - before[-2], after[1] - after[0]
    return abs(math.atan2(last[0] * first[1] - last[1] * first[0], float(last @ first)))


def _in_their_polygons(
    lanes: list[SourceLane], links: list[tuple[str, str]], faults: MapFaults
) -> list[SourceLane]:
    line = {lane.token: lane.centre_m for lane in lanes}
    meeting = {token for a, b in links if math.dist(line[a][-1], line[b][0]) < MEETS_M for token in (a, b)}
    kept = []
    for lane in lanes:
        if not _is_outside(lane):
            kept.append(lane)
        elif lane.token in meeting:
            faults.add(
                "polygons away from their lane",
                f"the polygon of lane {lane.token!r} lies elsewhere than its path, which meets its neighbours; "
                "the polygon is left out",
            )
            kept.append(replace(lane, polygon=None))
        else:
            faults.add(
                "paths away from their polygon",
                f"the path of lane {lane.token!r} lies outside its polygon and meets no neighbour; it is left out",
            )
    return kept


def _is_outside(lane: SourceLane) -> bool:
    if lane.polygon is None:
        return False
    line = LineString(lane.centre_m)
    inside = shapely.intersection(line, lane.polygon.buffer(OUTSIDE_M)).length
    return bool(1.0 - inside / line.length > OUTSIDE_SHARE)
