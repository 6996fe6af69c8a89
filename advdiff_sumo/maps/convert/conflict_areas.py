"""Where on their ways through a junction two drivers are in each other's way, for those that SUMO does not see.

SUMO takes a conflict for the spot where two centre lines cross, widened by the angle between them, and disregards who
is inside on a way that does not cross one's own. Opposite turns pass each other within less than a width over many
metres. ``<conflict>`` elements tell SUMO from where to where a way is shared.
"""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path

import shapely
from shapely.geometry import LineString, Point

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.annotate import CONNECTION
from advdiff_sumo.maps.convert.layout.clear_stretches import BODIES_M
from advdiff_sumo.maps.convert.narrow import Key, unseen_pairs
from advdiff_sumo.maps.convert.netplan import NetPlan

Span = tuple[float, float]


def write_conflicts(net: Path, plan: NetPlan) -> int:
    """Write into the connections of *net* which parts of their ways others share; return for how many pairs."""
    shared: dict[Key, dict[Key, Span]] = defaultdict(dict)
    pairs = unseen_pairs(plan)
    for one, other in pairs:
        for way, foe in ((one, other), (other, one)):
            shared[way.key][foe.key] = shared_span(way.shape_m, foe.shape_m)
    if not shared:
        return 0

    def with_conflicts(match: re.Match[str]) -> str:
        key = (match["origin"], int(match["leaves"]), match["target"], int(match["enters"]))
        own = shared.get(key)
        if not own or ' via="' not in match[0]:
            return match[0]
        rows = "".join(_row(foe, span, match["indent"]) for foe, span in own.items())
        if match["close"] == "/>":
            return f"{match[0][:-2]}>\n{rows}{match['indent']}</connection>"
        return match[0].removesuffix("</connection>").rstrip() + f"\n{rows}{match['indent']}</connection>"

    net.write_text(CONNECTION.sub(with_conflicts, net.read_text(encoding="utf-8")), encoding="utf-8")
    return len(pairs)


def _row(foe: Key, span: Span, indent: str) -> str:
    origin, leaves, target, enters = foe
    return (
        f'{indent}    <conflict from="{origin}" to="{target}" fromLane="{leaves}" toLane="{enters}" '
        f'startPos="{span[0]:.2f}" endPos="{span[1]:.2f}"/>\n'
    )


def shared_span(line_m: FloatArray, foe_m: FloatArray) -> Span:
    """Return from where to where *line_m* lies so near to *foe_m* that bodies of cars touch."""
    line, foe = LineString(line_m), LineString(foe_m)
    near = shapely.get_coordinates(line.intersection(foe.buffer(BODIES_M)))
    if not len(near):  # a buffer is a polygon within the round shape, some millimetres short of it
        near = shapely.get_coordinates(shapely.shortest_line(line, foe))[:1]
    places = [line.project(Point(place)) for place in near]
    return min(places), max(places)
