"""The parts of a road plan, and their plain XML for netconvert."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]


@dataclass(frozen=True)
class Node:
    """A junction, a change of cross-section or a fringe point; `kind` is netconvert's type."""

    name: str
    xy_m: tuple[float, float]
    kind: str = "priority"
    radius_m: float | None = None


@dataclass(frozen=True)
class Edge:
    """One carriageway; `shape_m` (N, 2) is its inner border if `spread` is "right", else its centre line."""

    name: str
    start: str
    end: str
    street: str
    lanes: int
    speed_mps: float
    priority: int
    shape_m: Points
    spread: str = "right"
    width_m: float = 3.25
    pocket: bool = False

    @property
    def heading_in_rad(self) -> float:
        """Heading at the beginning of the edge."""
        step = self.shape_m[1] - self.shape_m[0]
        return float(np.arctan2(step[1], step[0]))

    @property
    def heading_out_rad(self) -> float:
        """Heading at the end of the edge."""
        step = self.shape_m[-1] - self.shape_m[-2]
        return float(np.arctan2(step[1], step[0]))


@dataclass(frozen=True)
class Link:
    """A lane-to-lane connection across a node; None: netconvert chooses its path (N, 2) or speed."""

    source: str
    target: str
    from_lane: int
    to_lane: int
    shape_m: Points | None = None
    speed_mps: float | None = None


@dataclass
class Plan:
    """A road plan under construction: filled by a layout, then written once."""

    name: str
    lefthand: bool = False
    nodes: dict[str, Node] = field(default_factory=dict)
    edges: dict[str, Edge] = field(default_factory=dict)
    links: list[Link] = field(default_factory=list)

    def add_node(self, node: Node) -> None:
        """Add a node; if the name exists already, the nodes must be equal."""
        if self.nodes.setdefault(node.name, node) != node:
            raise ValueError(f"node {node.name} is defined twice and differently")

    def add_edge(self, edge: Edge) -> None:
        """Add an edge; its name must be new."""
        if edge.name in self.edges:
            raise ValueError(f"edge {edge.name} is defined twice")
        self.edges[edge.name] = edge

    def write(self, folder: Path) -> dict[str, Path]:
        """Write nodes, edges and connections; return netconvert option → file."""
        tables = {
            "node": ("nodes", [_node_row(n) for n in self.nodes.values()]),
            "edge": ("edges", [_edge_row(e) for e in self.edges.values()]),
            "connection": ("connections", [_link_row(k) for k in self.links]),
        }
        files = {}
        for tag, (root_tag, rows) in tables.items():
            root = ET.Element(root_tag)
            for row in rows:
                ET.SubElement(root, tag, row)
            files[f"--{tag}-files"] = folder / f"plan.{tag}.xml"
            ET.ElementTree(root).write(files[f"--{tag}-files"])
        return files


def _node_row(node: Node) -> dict[str, str]:
    row = {"id": node.name, "x": f"{node.xy_m[0]:.3f}", "y": f"{node.xy_m[1]:.3f}", "type": node.kind}
    if node.radius_m is not None:
        row["radius"] = f"{node.radius_m:.2f}"
    return row


def _edge_row(edge: Edge) -> dict[str, str]:
    return {
        "id": edge.name,
        "from": edge.start,
        "to": edge.end,
        "name": edge.street,
        "numLanes": str(edge.lanes),
        "speed": f"{edge.speed_mps:.2f}",
        "priority": str(edge.priority),
        "width": f"{edge.width_m:.2f}",
        "spreadType": edge.spread,
        "shape": _points(edge.shape_m),
    }


def _link_row(link: Link) -> dict[str, str]:
    row = {
        "from": link.source,
        "to": link.target,
        "fromLane": str(link.from_lane),
        "toLane": str(link.to_lane),
    }
    if link.shape_m is not None:
        row["shape"] = _points(link.shape_m)
    if link.speed_mps is not None:
        row["speed"] = f"{link.speed_mps:.2f}"
    return row


def _points(shape_m: Points) -> str:
    return " ".join(f"{x:.3f},{y:.3f}" for x, y in shape_m)
