"""Make nets with rare but valid features from plain XML by netconvert.

:func:`build` combines features by name. All nets have the streets W-C-E and S-C-N through a junction C, with one lane
in each direction and legs of 150 m, and a street E-F, so that a car can always drive on.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import sumolib

LEG_M = 150.0


@dataclass
class PlainNet:
    """The plain XML of a net, as the input of netconvert.

    Attributes:
        nodes: id → attributes.
        edges: id → attributes, including "from" and "to".
        inside: edge id → elements inside the edge.
        connections: elements of the connections file.
        extra: other elements of the edges file, such as roundabouts.
        options: options of netconvert.
        after: changes to the text of the finished net.
    """

    nodes: dict[str, dict[str, str]] = field(default_factory=dict)
    edges: dict[str, dict[str, str]] = field(default_factory=dict)
    inside: dict[str, str] = field(default_factory=dict)
    connections: list[str] = field(default_factory=list)
    extra: list[str] = field(default_factory=list)
    options: dict[str, str] = field(default_factory=dict)
    after: list[Callable[[str], str]] = field(default_factory=list)

    def node(self, name: str, x: float, y: float, kind: str = "priority") -> None:
        """Add a node."""
        self.nodes[name] = {"x": f"{x:g}", "y": f"{y:g}", "type": kind}

    def street(self, a: str, b: str, *, ways: int = 2, **attributes: str) -> None:
        """Add an edge from *a* to *b* and, if *ways* is 2, one from *b* to *a*."""
        for start, end in ((a, b), (b, a))[:ways]:
            self.edges[f"{start}{end}"] = {"from": start, "to": end, "speed": "13.9"} | attributes


def _base() -> PlainNet:
    net = PlainNet()
    for name, x, y in (("C", 0, 0), ("W", -1, 0), ("E", 1, 0), ("N", 0, 1), ("S", 0, -1), ("F", 2, 0)):
        net.node(name, LEG_M * x, LEG_M * y)
    for start in "WSN":
        net.street(start, "C", priority="2" if start == "W" else "1")
    net.street("C", "E", priority="2")
    net.street("E", "F", priority="2")
    return net


def _uncontrolled_link(net: PlainNet) -> None:
    """Add a signal that does not control a right turn."""
    net.nodes["C"]["type"] = "traffic_light"
    for to, is_uncontrolled in (("CE", "true"), ("CN", "false"), ("CW", "false")):
        lanes = f'from="SC" to="{to}" fromLane="0" toLane="0"'
        net.connections.append(f'<connection {lanes} uncontrolled="{is_uncontrolled}"/>')


def _blinking_light(net: PlainNet) -> None:
    """Add a signal whose links are blinking ("o") or off ("O") all the time."""
    net.nodes["C"]["type"] = "traffic_light"
    net.after.append(lambda text: re.sub(r'state="[Gg]', 'state="o', text))


def _spaced_id(net: PlainNet) -> None:
    """Put spaces into the id of a signal; ids of edges, lanes and junctions must not have any."""
    net.nodes["E"] |= {"type": "traffic_light", "tl": "the light of E"}


def _permission_change(net: PlainNet) -> None:
    """Let a lane end for cars within a street: the edge is split, and a bus lane begins there."""
    net.edges["WC"]["numLanes"] = "2"
    net.inside["WC"] = '<split pos="80" lanes="0 1" id="P"/><lane index="0" allow="bus"/>'


def _no_internal_length(net: PlainNet) -> None:
    """Make internal lanes of (almost) no length: the lanes of two edges meet directly."""
    net.nodes["E"]["radius"] = "0"


def _turnarounds(net: PlainNet) -> None:
    """Allow U-turns everywhere."""
    net.options["--no-turnarounds"] = "false"


def _roundabout(net: PlainNet) -> None:
    """Add a roundabout whose entries have priority over the ring, unlike usual ones."""
    ring = {"A": (2.2, 0.0), "B": (2.3, 0.15), "D": (2.4, 0.0), "G": (2.3, -0.15)}
    for name, (x, y) in ring.items():
        net.node(name, LEG_M * x, LEG_M * y)
    names = [*ring, "A"]
    for start, end in zip(reversed(names[1:]), reversed(names[:-1]), strict=True):
        net.street(start, end, ways=1, priority="1")
    net.street("F", "A", priority="9")
    net.node("H", LEG_M * 3.0, 0.0)
    net.street("D", "H", priority="9")
    net.extra.append('<roundabout nodes="A B D G" edges="AG GD DB BA"/>')


def _bicycles(net: PlainNet) -> None:
    """Add a bicycle lane on the right of a street."""
    net.edges["CE"]["numLanes"] = "2"
    net.inside["CE"] = '<lane index="0" allow="bicycle" width="1.5"/>'


def _rail(net: PlainNet) -> None:
    """Add a level crossing of a railway and a street; its signal has no link for the trains (linkIndex −1)."""
    net.node("X", LEG_M * 1.5, 0.0, "rail_crossing")
    net.node("Y", LEG_M * 1.5, LEG_M)
    net.node("Z", LEG_M * 1.5, -LEG_M)
    for name in ("EF", "FE"):
        del net.edges[name]
    net.street("E", "X", priority="2")
    net.street("X", "F", priority="2")
    net.street("Y", "X", ways=1, allow="rail", priority="9")
    net.street("X", "Z", ways=1, allow="rail", priority="9")


def _sidewalks(net: PlainNet) -> None:
    """Add sidewalks, walking areas and a pedestrian crossing."""
    for name in ("WC", "CW", "CE", "EC", "SC", "CS"):
        net.edges[name]["sidewalkWidth"] = "2"
    net.options |= {"--walkingareas": "true"}
    net.connections.append('<crossing node="C" edges="SC CS" priority="true"/>')


def _opposite_lane(net: PlainNet) -> None:
    """Allow overtaking on the lane of the oncoming traffic."""
    net.options["--opposites.guess"] = "true"


def _stop_offset(net: PlainNet) -> None:
    """Let cars stop 5 m before the end of a street."""
    net.inside["SC"] = '<stopOffset value="5" vClasses="passenger"/>'


def _no_keep_clear(net: PlainNet) -> None:
    """Let vehicles block the junction."""
    net.nodes["C"]["keepClear"] = "0"


def _left_hand(net: PlainNet) -> None:
    """Use left-hand traffic."""
    net.options["--lefthand"] = "true"


def _projected(net: PlainNet) -> None:
    """Add a geographic projection."""
    net.after.append(
        lambda text: re.sub(
            r'projParameter="[^"]*"',
            'projParameter="+proj=utm +zone=33 +ellps=WGS84 +datum=WGS84 +units=m +no_defs"',
            text,
        )
    )


def _far_away(net: PlainNet) -> None:
    """Use coordinates of millions of metres, as in national grids."""
    for node in net.nodes.values():
        node["x"], node["y"] = _moved(node["x"], node["y"])
    for edge in net.edges.values():
        if "shape" in edge:
            points = (_moved(*point.split(",")) for point in edge["shape"].split())
            edge["shape"] = " ".join(",".join(point) for point in points)


def _moved(x: str, y: str) -> tuple[str, str]:
    return f"{float(x) + 3.4e6:.2f}", f"{float(y) + 5.8e6:.2f}"


def _non_ascii_ids(net: PlainNet) -> None:
    """Use ids with characters beyond ASCII."""
    net.after.append(lambda text: text.replace('"CE', '"Straße-東').replace(" CE_", " Straße-東_"))


def _bends(net: PlainNet) -> None:
    """Add a street with sharp bends, so that the shapes of the lanes of an edge differ in length."""
    for name in ("NC", "CN"):
        net.edges[name]["numLanes"] = "2"
        middle = [(0.0, 0.3), (0.2, 0.5), (0.0, 0.7)]
        points = [(0.0, 0.0), *middle, (0.0, 1.0)]
        ordered = points if name == "CN" else points[::-1]
        net.edges[name]["shape"] = " ".join(f"{LEG_M * x:g},{LEG_M * y:g}" for x, y in ordered)


FEATURES: dict[str, Callable[[PlainNet], None]] = {
    "uncontrolled link": _uncontrolled_link,
    "blinking light": _blinking_light,
    "spaces in an id": _spaced_id,
    "permission change": _permission_change,
    "internal lanes of no length": _no_internal_length,
    "turnarounds": _turnarounds,
    "reversed roundabout": _roundabout,
    "bicycle lane": _bicycles,
    "rail": _rail,
    "sidewalks": _sidewalks,
    "opposite lane": _opposite_lane,
    "stop offset": _stop_offset,
    "no keep clear": _no_keep_clear,
    "left hand": _left_hand,
    "projection": _projected,
    "non-ASCII ids": _non_ascii_ids,
    "bends": _bends,
    "far away": _far_away,  # last, since it shifts all coordinates
}
"""Functions that add a feature to a net, by name."""


def build(folder: Path, names: Iterable[str]) -> Path:
    """Write a net with the features *names* into *folder* and return it."""
    plain = _base()
    for name in FEATURES:  # in a fixed order
        if name in names:
            FEATURES[name](plain)
    files = {"nod": _nodes(plain), "edg": _edges(plain), "con": plain.connections}
    tags = {"nod": "nodes", "edg": "edges", "con": "connections"}
    options = {"--output-file": str(folder / "rare.net.xml"), "--no-turnarounds": "true"}
    options |= {
        "--offset.disable-normalization": "true",
        "--no-warnings": "true",
        "--xml-validation": "never",
    }
    for ending, option in (("nod", "--node-files"), ("edg", "--edge-files"), ("con", "--connection-files")):
        path = folder / f"rare.{ending}.xml"
        path.write_text(f"<{tags[ending]}>" + "".join(files[ending]) + f"</{tags[ending]}>", encoding="utf-8")
        options[option] = str(path)
    words = [text for pair in (options | plain.options).items() for text in pair]
    subprocess.run([sumolib.checkBinary("netconvert"), *words], check=True, capture_output=True)
    net = folder / "rare.net.xml"
    text = net.read_text(encoding="utf-8")
    for change in plain.after:
        text = change(text)
    net.write_text(text, encoding="utf-8")
    return net


def _nodes(plain: PlainNet) -> list[str]:
    return [_element("node", {"id": name} | attributes, "") for name, attributes in plain.nodes.items()]


def _edges(plain: PlainNet) -> list[str]:
    edges = (
        _element("edge", {"id": name} | attributes, plain.inside.get(name, ""))
        for name, attributes in plain.edges.items()
    )
    return [*edges, *plain.extra]


def _element(tag: str, attributes: dict[str, str], inside: str) -> str:
    words = " ".join(f'{name}="{value}"' for name, value in attributes.items())
    return f"<{tag} {words}>{inside}</{tag}>\n"
