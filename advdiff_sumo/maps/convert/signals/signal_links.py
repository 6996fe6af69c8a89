"""Collect the links that each signal of a written net controls, with geometry and speeds from the plan."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import defaultdict
from dataclasses import dataclass

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.netplan import Ends, NetPlan
from advdiff_sumo.maps.convert.sources.source_map import Direction
from advdiff_sumo.maps.read_net import marked_requests

# Directions by SUMO's letters; other letters are straight or a turnaround.
DIRECTION_OF = {"l": Direction.LEFT, "L": Direction.LEFT, "r": Direction.RIGHT, "R": Direction.RIGHT}


@dataclass(frozen=True, eq=False)
class SignalLink:
    """A connection that a signal controls.

    Attributes:
        index: its position in the states of the program.
        origin: edge and lane from which it leads.
        target: edge to which it leads.
        direction: direction of its turn.
        line_m: (N, 2) centre line through the junction.
        approach_m: (N, 2) centre line of the lane before the junction.
        approach_mps: speed limit of that lane.
        junction_mps: speed limit in the junction.
        stop_offset_m: distance from the stop line to the junction.
        foes: indices of links in conflict with it.
        yields_to: indices of links to which it yields.
    """

    index: int
    origin: tuple[str, int]
    target: str
    direction: Direction
    line_m: FloatArray
    approach_m: FloatArray
    approach_mps: float
    junction_mps: float
    stop_offset_m: float
    foes: frozenset[int]
    yields_to: frozenset[int]

    @property
    def ends(self) -> Ends:
        """From edge and to edge."""
        return self.origin[0], self.target


def signal_links(root: ET.Element, plan: NetPlan) -> dict[str, list[SignalLink]]:
    """Return the links of each signal, by its name, in the order of their indices.

    Args:
        root: a net that was written from *plan*, without pedestrian crossings.
        plan: the plan.
    """
    rows: dict[str, list[ET.Element]] = defaultdict(list)
    for row in root.iterfind("connection"):
        if row.get("tl") and row.get("via") and row.get("from") in plan.edge_of:  # no streets beyond the rim
            rows[row.attrib["tl"]].append(row)
    conflicts = _Conflicts(root)
    return {
        signal: sorted(
            (_link(row, signal_rows, conflicts, plan) for row in signal_rows), key=lambda link: link.index
        )
        for signal, signal_rows in rows.items()
    }


class _Conflicts:
    """Conflicts between internal lanes: for each lane its foes, and the lanes to which it yields."""

    def __init__(self, root: ET.Element) -> None:
        self.foes: dict[str, set[str]] = defaultdict(set)
        self.yields_to: dict[str, set[str]] = defaultdict(set)
        for junction in root.iterfind("junction"):
            lanes = junction.get("intLanes", "").split()
            for row in junction.iterfind("request"):
                internal_lane = lanes[int(row.attrib["index"])]
                foes, response = (
                    {lanes[number] for number in marked_requests(row.get(key, "")) if number < len(lanes)}
                    for key in ("foes", "response")
                )
                for lane in foes:
                    self.foes[internal_lane].add(lane)
                    self.foes[lane].add(internal_lane)
                self.yields_to[internal_lane] |= response


def _link(row: ET.Element, signal_rows: list[ET.Element], conflicts: _Conflicts, plan: NetPlan) -> SignalLink:
    """Return the link of connection *row*; *signal_rows* are all connections of its signal."""
    index = {link_row.attrib["via"]: int(link_row.attrib["linkIndex"]) for link_row in signal_rows}
    origin, target = (row.attrib["from"], int(row.attrib["fromLane"])), row.attrib["to"]
    connection = plan.connection_of[*origin, target, int(row.attrib["toLane"])]
    lane = plan.edge_of[origin[0]].lanes[origin[1]]
    letter, via = row.get("dir", "s"), row.attrib["via"]
    turnaround = Direction.RIGHT if plan.lefthand else Direction.LEFT
    return SignalLink(
        index=int(row.attrib["linkIndex"]),
        origin=origin,
        target=target,
        direction=turnaround if letter in "tT" else DIRECTION_OF.get(letter, Direction.STRAIGHT),
        line_m=connection.shape_m,
        approach_m=lane.shape_m,
        approach_mps=lane.speed_mps,
        junction_mps=min(connection.speed_mps, lane.speed_mps),
        stop_offset_m=lane.stop_offset_m,
        foes=frozenset(index[foe] for foe in conflicts.foes[via] if foe in index),
        yields_to=frozenset(index[foe] for foe in conflicts.yields_to[via] if foe in index),
    )
