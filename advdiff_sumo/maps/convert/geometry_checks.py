"""Leave out lanes, polygons and links of a source map whose geometry contradicts the rest of the map."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import shapely
from shapely.geometry import LineString

from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.sources.map_faults import MapFaults
from advdiff_sumo.maps.convert.sources.source_map import SourceLane, SourceMap

OUTSIDE_M = 1.0  # distance up to which a centre line beside its polygon still counts as inside
OUTSIDE_SHARE = 0.3  # if a larger share of a centre line is outside, it contradicts its polygon
MEETS_M = 1.0  # lane ends at a smaller distance meet
FAR_LINK_M = 10.0  # a link over a larger gap joins lanes that do not follow each other
BACKWARDS_RAD = 2.4  # a link with a larger change of heading leads backwards
FULL_TURN_RAD = 1.9 * math.pi  # a centre line that turns by at least this runs in a circle


def check_geometry(source: SourceMap) -> SourceMap:
    """Return *source* without lanes, polygons and links that contradict the rest of the map.

    Left out are:

    - lanes whose centre line turns full circle or ends where it begins,
    - lanes whose centre line lies outside their polygon and meets no neighbour,
    - the polygon of a lane whose centre line lies outside it but meets a neighbour,
    - links of a lane to itself, over more than 10 m, or backwards.

    Each is counted in ``notes`` and gets a sentence in ``warnings`` (at most 20 of a kind).
    """
    faults = MapFaults(source.path)
    lanes = [lane for lane in source.lanes if not _is_loop(lane, faults)]
    by_token = {lane.token: lane for lane in lanes}
    links = [
        link for link in source.links if set(link) <= by_token.keys() and _is_sound(by_token, link, faults)
    ]
    lanes = _in_their_polygons(lanes, links, faults)
    known = {lane.token for lane in lanes}
    removed = tuple(lane.token for lane in source.lanes if lane.token not in known)
    return replace(
        source,
        lanes=tuple(lanes),
        links=tuple(link for link in links if set(link) <= known),
        left_out=source.left_out + removed,
        notes=source.notes + faults.notes,
        warnings=source.warnings + faults.sentences(),
    )


def _is_loop(lane: SourceLane, faults: MapFaults) -> bool:
    """Return whether a centre line turns full circle or ends where it begins; note it in *faults*."""
    line = lane.centre_m
    yaw = np.unwrap(np.arctan2(*np.diff(line, axis=0).T[::-1]))
    is_closed = math.dist(line[0], line[-1]) < MEETS_M and line_length_m(line) > 5.0 * MEETS_M
    if not is_closed and abs(float(yaw[-1] - yaw[0])) < FULL_TURN_RAD:
        return False
    faults.add("paths that run in a circle", f"lane {lane.token!r} runs in a circle and is left out")
    return True


def _is_sound(lanes: dict[str, SourceLane], link: tuple[str, str], faults: MapFaults) -> bool:
    """Return whether a link joins two lanes that follow each other; otherwise note it in *faults*."""
    before, after = lanes[link[0]].centre_m, lanes[link[1]].centre_m
    gap = math.dist(before[-1], after[0])
    if link[0] == link[1]:
        faults.add("links of a lane to itself", f"lane {link[0]!r} is linked to itself; the link is left out")
    elif gap > FAR_LINK_M:
        faults.add(
            "links to far lanes",
            f"lane {link[0]!r} ends {gap:.0f} m from the beginning of {link[1]!r}; the link is left out",
        )
    elif abs(polyline.turn_between(before, after)) > BACKWARDS_RAD:
        faults.add(
            "links backwards",
            f"lane {link[1]!r} begins against the direction of {link[0]!r}; the link is left out",
        )
    else:
        return True
    return False


def _in_their_polygons(
    lanes: list[SourceLane], links: list[tuple[str, str]], faults: MapFaults
) -> list[SourceLane]:
    """Return *lanes* without those outside their polygon; lanes that meet a neighbour lose the polygon instead."""
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
    """Return whether more than ``OUTSIDE_SHARE`` of a centre line lies outside the lane's polygon."""
    if lane.polygon is None:
        return False
    line = LineString(lane.centre_m)
    inside = shapely.intersection(line, lane.polygon.buffer(OUTSIDE_M)).length
    return bool(1.0 - inside / line.length > OUTSIDE_SHARE)
