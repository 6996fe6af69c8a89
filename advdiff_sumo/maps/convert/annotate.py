"""Add to a written net what netconvert left out, and restore what it changed against the plan.

These are the source of each connection, the true length of each internal lane, and the shapes of lanes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert.netplan import ConnectionKey, NetPlan
from advdiff_sumo.maps.convert.polyline import shape_text
from advdiff_sumo.maps.lanes import edge_of_lane
from advdiff_sumo.maps.read_net import points_of

CONNECTION = re.compile(
    r'(?P<indent>[ ]*)<connection from="(?P<origin>[^":]+)" to="(?P<target>[^"]+)"'
    r' fromLane="(?P<from_lane>\d+)" toLane="(?P<to_lane>\d+)"(?P<rest>[^>]*?)(?P<close>/>|>.*?</connection>)',
    re.DOTALL,
)
INTERNAL = re.compile(
    r'(<lane id=":[^"]+_\d+_\d+" [^>]*?length=")(?P<length>[^"]*)("[^>]*? shape="(?P<shape>[^"]*)")'
)
SHORTEST_M = 0.1  # netconvert's smallest length of an internal lane
SAME_M = 0.01  # ends that differ by no more are equal
LANE = re.compile(r'(<lane id="(?P<id>[^"]+)"[^>]* shape=")(?P<shape>[^"]*)(")')
CONNECTION_VIA = re.compile(
    r'<connection from="(?P<origin>[^":]+)" to="(?P<target>[^"]+)"'
    r' fromLane="(?P<from_lane>\d+)" toLane="(?P<to_lane>\d+)"[^>]* via="(?P<via>[^"]+)"'
)
# An internal lane that leads into another internal lane.
DIVIDED = re.compile(r'<connection from="(:[^"]+)"[^>]* via="')


def annotate_net(net: Path, plan: NetPlan) -> None:
    """Write the parameter ``source`` into each connection of *net*, and the true length into each internal lane.

    netconvert drops the parameters of connections and gives all lanes of one internal edge their mean length.
    """
    text = net.read_text(encoding="utf-8")

    def with_source(match: re.Match[str]) -> str:
        connection = plan.connection_of.get(connection_key(match))
        if connection is None or not connection.source:
            return match[0]
        start = match[0][: match.start("close") - match.start()]
        indent = match["indent"]
        param = f'{indent}    <param key="source" value={quoteattr(connection.source)}/>\n'
        return f"{start}>\n{param}{indent}</connection>"

    text = CONNECTION.sub(with_source, text)
    net.write_text(INTERNAL.sub(_with_true_length, text), encoding="utf-8")


def connection_key(match: re.Match[str]) -> ConnectionKey:
    """Return from edge and lane, to edge and lane of a match of ``CONNECTION`` or ``CONNECTION_VIA``."""
    return match["origin"], int(match["from_lane"]), match["target"], int(match["to_lane"])


def _with_true_length(match: re.Match[str]) -> str:
    return f"{match[1]}{max(line_length_m(points_of(match['shape'])), SHORTEST_M):.4f}{match[3]}"


def restore_shapes(net: Path, plan: NetPlan) -> int:
    """Give each lane of *net* the shape that it has in *plan*; return how many lanes netconvert had moved at an end.

    netconvert changes shapes in two ways. It drops points that lie some centimetres from the one before. It moves the
    end of a lane that begins inside its own junction and leaves it across another lane, whatever the junction's
    shape; the connections from and to this lane move with it. Connections that a waiting position divides have two
    internal lanes and are not restored.
    """
    text = net.read_text(encoding="utf-8")
    planned = {
        f"{edge.id}_{index}": lane.shape_m for edge in plan.edges for index, lane in enumerate(edge.lanes)
    }
    return put_shapes(net, text, planned | _internal_shapes(text, plan))


def put_shapes(net: Path, text: str, shapes: Mapping[str, FloatArray]) -> int:
    """Write *net* as *text* with *shapes* (by lane id); return how many of these lanes had another end."""
    moved = 0

    def put_back(match: re.Match[str]) -> str:
        nonlocal moved
        shape = shapes.get(match["id"])
        if shape is None:
            return match[0]
        moved += not _same_ends(match["shape"], shape)
        return match[1] + shape_text(shape) + match[4]

    net.write_text(LANE.sub(put_back, text), encoding="utf-8")
    return moved


def _internal_shapes(text: str, plan: NetPlan) -> dict[str, FloatArray]:
    """Return the planned shape of each internal lane that holds a whole connection."""
    divided = set(DIVIDED.findall(text))
    shapes: dict[str, FloatArray] = {}
    for match in CONNECTION_VIA.finditer(text):
        connection = plan.connection_of.get(connection_key(match))
        if connection is not None and edge_of_lane(match["via"]) not in divided:
            shapes[match["via"]] = connection.shape_m
    return shapes


def _same_ends(text: str, shape: FloatArray) -> bool:
    return bool(np.abs(points_of(text)[[0, -1]] - shape[[0, -1]]).max() <= SAME_M)
