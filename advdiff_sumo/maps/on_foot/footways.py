"""Reads the sidewalks of a net and groups them into parts connected by crossings and walking areas."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.read_net import ids_beyond, read_root, shape_of


@dataclass(frozen=True, eq=False)
class Footways:
    """The S sidewalks of a net that are connected to at least one other sidewalk.

    Attributes:
        edges: (S,) ids of edges with a lane for pedestrians.
        length_m: (S,) their lengths.
        middle_m: (S, 2) midpoints between their ends.
        part: (S,) number of the connected part that each belongs to.
    """

    edges: tuple[str, ...]
    length_m: FloatArray
    middle_m: FloatArray
    part: IntArray


def read_footways(net: Path) -> Footways:
    """Return the footways of the net at *net*; there are none without crossings and walking areas."""
    root = read_root(net, "net", "a SUMO net")
    beyond = ids_beyond(root)
    lines: dict[str, FloatArray] = {}
    foot_lanes: set[tuple[str, str]] = set()
    for edge in root.iterfind("edge"):
        name = edge.get("id", "")
        for lane in edge.iterfind("lane"):
            if name not in beyond and "pedestrian" in lane.get("allow", "").split():
                foot_lanes.add((name, lane.get("index", "0")))
                if not edge.get("function") and len(shape_of(lane)) > 1:
                    lines[name] = shape_of(lane)
    row_of = {name: row for row, name in enumerate(sorted({name for name, _ in foot_lanes}))}
    connected_rows: list[tuple[int, int]] = []
    for connection in root.iterfind("connection"):
        ends = [(connection.get(key, ""), connection.get(f"{key}Lane", "")) for key in ("from", "to")]
        if all(end in foot_lanes for end in ends):
            connected_rows.append((row_of[ends[0][0]], row_of[ends[1][0]]))
    origin, target = np.array(connected_rows, dtype=np.int64).reshape(-1, 2).T
    graph = coo_array((np.ones(len(origin)), (origin, target)), shape=(len(row_of), len(row_of)))
    component = connected_components(graph, directed=False)[1]
    members: dict[int, list[str]] = defaultdict(list)
    for name in sorted(lines):
        members[int(component[row_of[name]])].append(name)
    parts = [part for part in members.values() if len(part) > 1]
    edges = [name for part in parts for name in part]
    return Footways(
        tuple(edges),
        np.array([line_length_m(lines[name]) for name in edges]),
        np.array([lines[name][[0, -1]].mean(axis=0) for name in edges]).reshape(-1, 2),
        np.array([number for number, part in enumerate(parts) for _ in part], dtype=np.int64),
    )
