"""What netconvert leaves out of a net or changes against the plan.

Where each connection comes from, how long each way really is, and the shapes of lanes.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert.netplan import NetPlan
from advdiff_sumo.maps.convert.polyline import shape_text

CONNECTION = re.compile(
    r'(?P<indent>[ ]*)<connection from="(?P<origin>[^":]+)" to="(?P<target>[^"]+)"'
    r' fromLane="(?P<leaves>\d+)" toLane="(?P<enters>\d+)"(?P<rest>[^>]*?)(?P<close>/>|>.*?</connection>)',
    re.DOTALL,
)
INTERNAL = re.compile(
    r'(<lane id=":[^"]+_\d+_\d+" [^>]*?length=")(?P<length>[^"]*)("[^>]*? shape="(?P<shape>[^"]*)")'
)
SHORTEST_M = 0.1  # as netconvert has it
SAME_M = 0.01
LANE = re.compile(r'(<lane id="(?P<id>[^"]+)"[^>]* shape=")(?P<shape>[^"]*)(")')
WHOLE_WAY = re.compile(
    r'<connection from="([^":]+)" to="([^"]+)" fromLane="(\d+)" toLane="(\d+)"[^>]* via="(?P<via>[^"]+)"'
)
DIVIDED = re.compile(r'<connection from="(:[^"]+)"[^>]* via="')


def annotate_net(net: Path, plan: NetPlan) -> None:
    """Write ``source`` into each connection of *net*, and the length of its own shape into each internal lane.

    netconvert keeps no parameters of connections and gives all lanes of one internal edge their mean length.
    """
    text = net.read_text(encoding="utf-8")

    def with_source(match: re.Match[str]) -> str:
        key = (match["origin"], int(match["leaves"]), match["target"], int(match["enters"]))
        way = plan.way_of.get(key)
        if way is None or not way.source:
            return match[0]
        start = match[0][: match.start("close") - match.start()]
        indent = match["indent"]
        param = f'{indent}    <param key="source" value={quoteattr(way.source)}/>\n'
        return f"{start}>\n{param}{indent}</connection>"

    text = CONNECTION.sub(with_source, text)
    net.write_text(INTERNAL.sub(_with_true_length, text), encoding="utf-8")


def _with_true_length(match: re.Match[str]) -> str:
    points = np.array(
        [[float(v) for v in point.split(",")[:2]] for point in match["shape"].split()], dtype=np.float64
    )
    return f"{match[1]}{max(line_length_m(points), SHORTEST_M):.4f}{match[3]}"


def restore_shapes(net: Path, plan: NetPlan) -> int:
    """Give each lane of *net* the shape that *plan* gives it; return how many had been moved at an end.

    netconvert leaves out points some centimetres from the one before.

    A lane that begins inside its own junction and leaves it across another lane has no place where netconvert
    would leave it alone, whatever the junction's shape; the ways from and to it move along with it. Ways that a
    waiting place divides have two internal lanes and are left as they are.
    """
    text = net.read_text(encoding="utf-8")
    planned = {
        f"{edge.id}_{index}": lane.shape_m for edge in plan.edges for index, lane in enumerate(edge.lanes)
    }
    planned |= _internal_shapes(text, plan)
    moved = 0

    def put_back(match: re.Match[str]) -> str:
        nonlocal moved
        shape = planned.get(match["id"])
        if shape is None:
            return match[0]
        moved += not _same_ends(match["shape"], shape)
        return match[1] + shape_text(shape) + match[4]

    text = LANE.sub(put_back, text)
    net.write_text(text, encoding="utf-8")
    return moved


def _internal_shapes(text: str, plan: NetPlan) -> dict[str, FloatArray]:
    """Return the planned shape of each internal lane that holds a whole way."""
    divided = set(DIVIDED.findall(text))
    shapes: dict[str, FloatArray] = {}
    for match in WHOLE_WAY.finditer(text):
        origin, target, leaves, enters, via = match.groups()
        way = plan.way_of.get((origin, int(leaves), target, int(enters)))
        if way is not None and via.rpartition("_")[0] not in divided:
            shapes[via] = way.shape_m
    return shapes


def _same_ends(text: str, shape: FloatArray) -> bool:
    points = text.split()
    ends = np.array([[float(v) for v in point.split(",")[:2]] for point in (points[0], points[-1])])
    return bool(np.abs(ends - shape[[0, -1]]).max() <= SAME_M)
