"""What netconvert leaves out of a net: where each connection comes from and how long each way really is."""

from __future__ import annotations

import re
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.netplan import NetPlan

CONNECTION = re.compile(
    r'(?P<indent>[ ]*)<connection from="(?P<origin>[^":]+)" to="(?P<target>[^"]+)"'
    r' fromLane="(?P<leaves>\d+)" toLane="(?P<enters>\d+)"(?P<rest>[^>]*?)(?P<close>/>|>.*?</connection>)',
    re.DOTALL,
)
INTERNAL = re.compile(
    r'(<lane id=":[^"]+_\d+_\d+" [^>]*?length=")(?P<length>[^"]*)("[^>]*? shape="(?P<shape>[^"]*)")'
)
SHORTEST_M = 0.1  # as netconvert has it


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
    return f"{match[1]}{max(polyline.length(points), SHORTEST_M):.4f}{match[3]}"
