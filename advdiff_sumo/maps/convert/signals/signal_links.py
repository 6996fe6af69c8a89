"""The ways that a signal of a written net controls, with what their plan says of them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.narrow import Ends
from advdiff_sumo.maps.convert.netplan import EdgePlan, NetPlan
from advdiff_sumo.maps.convert.sources.source_map import Direction
from advdiff_sumo.maps.read_net import marked_requests

ABOUT = {"l": Direction.LEFT, "L": Direction.LEFT, "r": Direction.RIGHT, "R": Direction.RIGHT}


@dataclass(frozen=True, eq=False)
class SignalLink:
    """One link of a signal.

    Attributes:
        index: its place in the states of the program.
        origin: edge and lane that it leaves.
        target: edge that it enters.
        direction: where it turns.
        line_m: (N, 2) centre line through the junction.
        approach_m: (N, 2) centre line of the lane that it leaves.
        approach_mps: speed limit of that lane.
        way_mps: speed through the junction.
        stop_offset_m: from the stop line to the junction.
        foes: links in conflict with it.
        yields_to: those of them that go first.
    """

    index: int
    origin: tuple[str, int]
    target: str
    direction: Direction
    line_m: FloatArray
    approach_m: FloatArray
    approach_mps: float
    way_mps: float
    stop_offset_m: float
    foes: frozenset[int]
    yields_to: frozenset[int]

    @property
    def ends(self) -> Ends:
        """Edges that it leaves and enters."""
        return self.origin[0], self.target


def signal_links(root: ET.Element, plan: NetPlan) -> dict[str, list[SignalLink]]:
    """Return the links of each signal, by its name, in the order of their indices.

    Args:
        root: a net that was written from *plan*, without crossings on foot.
        plan: the plan.
    """
    rows: dict[str, list[ET.Element]] = defaultdict(list)
    edges = {edge.id: edge for edge in plan.edges}
    for row in root.iterfind("connection"):
        if (
            row.get("tl") and row.get("via") and row.get("from") in edges
        ):  # not those of streets beyond the rim
            rows[row.attrib["tl"]].append(row)
    conflicts = _Conflicts(root)
    return {
        signal: sorted((_link(row, own, conflicts, plan, edges) for row in own), key=lambda link: link.index)
        for signal, own in rows.items()
    }


class _Conflicts:
    """Which internal lanes are foes of each other, and who of them yields."""

    def __init__(self, root: ET.Element) -> None:
        self.foes: dict[str, set[str]] = defaultdict(set)
        self.yields_to: dict[str, set[str]] = defaultdict(set)
        for junction in root.iterfind("junction"):
            lanes = junction.get("intLanes", "").split()
            for row in junction.iterfind("request"):
                own = lanes[int(row.attrib["index"])]
                foes, response = (
                    {lanes[number] for number in marked_requests(row.get(key, "")) if number < len(lanes)}
                    for key in ("foes", "response")
                )
                for lane in foes:
                    self.foes[own].add(lane)
                    self.foes[lane].add(own)
                self.yields_to[own] |= response


def _link(
    row: ET.Element,
    links: list[ET.Element],
    conflicts: _Conflicts,
    plan: NetPlan,
    edges: Mapping[str, EdgePlan],
) -> SignalLink:
    index = {link.attrib["via"]: int(link.attrib["linkIndex"]) for link in links}
    origin, target = (row.attrib["from"], int(row.attrib["fromLane"])), row.attrib["to"]
    way = plan.way_of[*origin, target, int(row.attrib["toLane"])]
    lane = edges[origin[0]].lanes[origin[1]]
    letter, via = row.get("dir", "s"), row.attrib["via"]
    turnaround = Direction.RIGHT if plan.lefthand else Direction.LEFT
    return SignalLink(
        index=int(row.attrib["linkIndex"]),
        origin=origin,
        target=target,
        direction=turnaround if letter in "tT" else ABOUT.get(letter, Direction.STRAIGHT),
        line_m=way.shape_m,
        approach_m=lane.shape_m,
        approach_mps=lane.speed_mps,
        way_mps=min(way.speed_mps, lane.speed_mps),
        stop_offset_m=lane.stop_offset_m,
        foes=frozenset(index[foe] for foe in conflicts.foes[via] if foe in index),
        yields_to=frozenset(index[foe] for foe in conflicts.yields_to[via] if foe in index),
    )
