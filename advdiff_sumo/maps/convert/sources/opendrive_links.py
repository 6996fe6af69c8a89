"""Which lane of an OpenDRIVE map leads on to which: links of sections, roads and junctions (chapters 9 to 12)."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from typing import TypeAlias
from xml.etree.ElementTree import Element

End: TypeAlias = int  # of a road: 0 where its reference line begins, -1 where it ends
Mouth: TypeAlias = tuple[
    Element, int, int, End
]  # road, section, lane, and the end of it that touches another lane
SIDES = ("left", "right")
ENDS: dict[str, End] = {"predecessor": 0, "successor": -1}
CONTACTS: dict[str, End] = {"start": 0, "end": -1}


def lane_successors(root: Element) -> dict[str, tuple[str, ...]]:
    """Return the lanes that follow each lane, named ROAD_SECTION_LANE, in driving direction."""
    roads = {road.get("id", ""): road for road in root.iterfind("road")}
    after: dict[str, dict[str, None]] = defaultdict(dict)
    for one, other in (*_between_roads(roads), *_through_junctions(root, roads)):
        origin, target = (one, other) if _leaves(one) else (other, one)
        if _leaves(origin) and not _leaves(target):
            after[_token(origin)][_token(target)] = None
    return {token: tuple(following) for token, following in after.items()}


def _between_roads(roads: dict[str, Element]) -> Iterator[tuple[Mouth, Mouth]]:
    """Yield the pairs of lane ends that lanes' own links join, within a road and to the next one."""
    for road in roads.values():
        for side in SIDES:
            sections = sections_of(road, side)
            for section, row in (
                (n, lane) for n, own in enumerate(sections) for lane in own.findall(f"{side}/lane")
            ):
                for key, end in ENDS.items():
                    target = _number(row.find(f"link/{key}"), "id")
                    other = section + (1 if end else -1)
                    if target is None:
                        continue
                    here = (road, section, _number(row, "id") or 0, end)
                    if 0 <= other < len(sections):
                        yield here, (road, other, target, -1 - end)
                    elif (beyond := _linked(road, key, roads)) is not None:
                        yield here, _outermost(*beyond, target)


def _linked(road: Element, key: str, roads: dict[str, Element]) -> tuple[Element, End] | None:
    """Return the road that *road* leads to at an end, and at which end of that it arrives; None for junctions."""
    row = road.find(f"link/{key}")
    if row is None or row.get("elementType") != "road" or row.get("elementId") not in roads:
        return None
    contact = CONTACTS.get(row.get("contactPoint", ""))
    return None if contact is None else (roads[row.get("elementId", "")], contact)


def _through_junctions(root: Element, roads: dict[str, Element]) -> Iterator[tuple[Mouth, Mouth]]:
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
                    yield _outermost(before, end, origin), _outermost(inner, contact, target)


def _end_at(road: Element, junction: str, inner: Element, contact: End) -> End | None:
    """Return at which end *road* touches *junction*; where both do, the one by which road *inner* begins."""
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
    """Return the lane sections of *road* that hold for its *side*, "left" or "right", in their order.

    One with ``singleSide`` holds for the sides that it has; on the other one the section before it goes on.
    """
    rows = sorted(road.findall("lanes/laneSection"), key=_place)
    return [row for row in rows if row.get("singleSide") != "true" or row.find(side) is not None]


def _place(row: Element) -> float:
    try:
        return float(row.get("s", ""))
    except ValueError:
        return math.inf


def _outermost(road: Element, end: End, lane: int) -> Mouth:
    """Return the end of *lane* at an end of *road*."""
    section = 0 if end == 0 else len(sections_of(road, SIDES[lane < 0])) - 1
    return road, section, lane, end


def _leaves(mouth: Mouth) -> bool:
    """Return whether traffic of the lane drives out at that end."""
    road, _, lane, end = mouth
    along = (lane < 0) != (road.get("rule") == "LHT")
    return along == (end == -1)


def _token(mouth: Mouth) -> str:
    road, section, lane, _ = mouth
    return f"{'_'.join((road.get('id') or '').split())}_{section}_{lane}"


def _number(row: Element | None, name: str) -> int | None:
    try:
        return None if row is None else int(row.get(name, ""))
    except ValueError:
        return None
