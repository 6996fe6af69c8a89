"""Find the successors of lanes in an OpenDRIVE map, by links of sections, roads and junctions (chapters 9 to 12)."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from typing import TypeAlias
from xml.etree.ElementTree import Element

End: TypeAlias = int  # end of a road or section: 0 where the reference line begins, -1 where it ends
LaneEnd: TypeAlias = tuple[Element, int, int, End]  # road, number of the section, lane id, and its end
SIDES = ("left", "right")
ENDS: dict[str, End] = {"predecessor": 0, "successor": -1}
CONTACTS: dict[str, End] = {"start": 0, "end": -1}


def lane_successors(root: Element) -> dict[str, tuple[str, ...]]:
    """Return the lanes that follow each lane, named ROAD_SECTION_LANE, in driving direction."""
    roads = {road.get("id", ""): road for road in root.iterfind("road")}
    successors: dict[str, dict[str, None]] = defaultdict(dict)
    for first, second in (*_between_roads(roads), *_through_junctions(root, roads)):
        origin, target = (first, second) if _is_exit(first) else (second, first)
        if _is_exit(origin) and not _is_exit(target):
            successors[_token(origin)][_token(target)] = None
    return {token: tuple(following) for token, following in successors.items()}


def _between_roads(roads: dict[str, Element]) -> Iterator[tuple[LaneEnd, LaneEnd]]:
    """Yield the pairs of lane ends that lane links join, within a road and to the next road."""
    for road in roads.values():
        for side in SIDES:
            sections = sections_of(road, side)
            for section, row in (
                (n, lane) for n, own in enumerate(sections) for lane in own.findall(f"{side}/lane")
            ):
                for key, end in ENDS.items():
                    target = _number(row.find(f"link/{key}"), "id")
                    next_section = section + (1 if end else -1)
                    if target is None:
                        continue
                    lane_end = (road, section, _number(row, "id") or 0, end)
                    if 0 <= next_section < len(sections):
                        yield lane_end, (road, next_section, target, -1 - end)
                    elif (linked := _linked_road(road, key, roads)) is not None:
                        yield lane_end, _lane_end(*linked, target)


def _linked_road(road: Element, key: str, roads: dict[str, Element]) -> tuple[Element, End] | None:
    """Return the road that *road* is linked to (*key*: predecessor or successor), and that road's end; else None."""
    row = road.find(f"link/{key}")
    if row is None or row.get("elementType") != "road" or row.get("elementId") not in roads:
        return None
    contact = CONTACTS.get(row.get("contactPoint", ""))
    return None if contact is None else (roads[row.get("elementId", "")], contact)


def _through_junctions(root: Element, roads: dict[str, Element]) -> Iterator[tuple[LaneEnd, LaneEnd]]:
    """Yield the pairs of lane ends that the connections of junctions join."""
    for junction in root.iterfind("junction"):
        for row in junction.iterfind("connection"):
            before = roads.get(row.get("incomingRoad", ""))
            inner = roads.get(row.get("connectingRoad", row.get("linkedRoad", "")))
            contact = CONTACTS.get(row.get("contactPoint", ""))
            if before is None or inner is None or contact is None:
                continue
            end = _end_at(before, junction.get("id", ""), inner, contact)
            for link in row.iterfind("laneLink"):
                origin, target = _number(link, "from"), _number(link, "to")
                if end is not None and origin is not None and target is not None:
                    yield _lane_end(before, end, origin), _lane_end(inner, contact, target)


def _end_at(road: Element, junction: str, inner: Element, contact: End) -> End | None:
    """Return the end of *road* at *junction*; if both ends are there, the one to which road *inner* is linked.

    Args:
        road: road that leads into the junction.
        junction: id of the junction.
        inner: connecting road.
        contact: end of *inner* at *road*.
    """
    rows = {end: road.find(f"link/{key}") for key, end in ENDS.items()}
    ends = [
        end
        for end, row in rows.items()
        if row is not None and row.get("elementType") == "junction" and row.get("elementId") == junction
    ]
    if len(ends) < 2:
        return ends[0] if ends else None
    stated = inner.find("link/predecessor" if contact == 0 else "link/successor")
    named = None if stated is None else CONTACTS.get(stated.get("contactPoint", ""))
    return ends[0] if named is None else named


def sections_of(road: Element, side: str) -> list[Element]:
    """Return the lane sections of *road* that are valid for its *side* ("left" or "right"), in order.

    A section with ``singleSide`` is valid only for the side that it describes. On the other side the section before
    it continues.
    """
    rows = sorted(road.findall("lanes/laneSection"), key=_section_start)
    return [row for row in rows if row.get("singleSide") != "true" or row.find(side) is not None]


def _section_start(row: Element) -> float:
    try:
        return float(row.get("s", ""))
    except ValueError:
        return math.inf


def _lane_end(road: Element, end: End, lane: int) -> LaneEnd:
    """Return the end of *lane* at the given *end* of *road*."""
    section = 0 if end == 0 else len(sections_of(road, SIDES[lane < 0])) - 1
    return road, section, lane, end


def _is_exit(lane_end: LaneEnd) -> bool:
    """Return whether traffic leaves the lane at that end."""
    road, _, lane, end = lane_end
    along = (lane < 0) != (road.get("rule") == "LHT")
    return along == (end == -1)


def _token(lane_end: LaneEnd) -> str:
    """Return the name of the lane, ROAD_SECTION_LANE."""
    road, section, lane, _ = lane_end
    return f"{'_'.join((road.get('id') or '').split())}_{section}_{lane}"


def _number(row: Element | None, name: str) -> int | None:
    try:
        return None if row is None else int(row.get(name, ""))
    except ValueError:
        return None
