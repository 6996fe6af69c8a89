"""A street plan: nodes and edges before netconvert builds them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement

import numpy as np

from advdiff_sumo.core.arrays import FloatArray

_SPACING_M = 12.0
_STEEPEST = 0.15


@dataclass
class PlanEdge:
    """One direction of a street; *shape_m* (P, 2) where it is not straight."""

    id: str
    start: str
    end: str
    lanes: int = 1
    speed_mps: float = 13.89
    priority: int = 1
    shape_m: FloatArray | None = None


@dataclass
class StreetPlan:
    """Nodes and edges by SUMO's plain names.

    Attributes:
        nodes: id → (2,) position.
        edges: in the order of the file.
        types: node → kind of junction; others are left to netconvert.
        connections: (from edge, to edge, from lane, to lane); edges without any get netconvert's guess.
    """

    nodes: dict[str, FloatArray]
    edges: list[PlanEdge]
    types: dict[str, str] = field(default_factory=dict)
    connections: list[tuple[str, str, int, int]] = field(default_factory=list)

    def write(self, folder: Path, width_m: float) -> dict[str, Path]:
        """Write plain XML; returns the files by netconvert's option."""
        nodes, edges, links = Element("nodes"), Element("edges"), Element("connections")
        for name, xy in self.nodes.items():
            kind = {"type": self.types[name]} if name in self.types else {}
            SubElement(nodes, "node", {"id": name, "x": f"{xy[0]:.3f}", "y": f"{xy[1]:.3f}", **kind})
        for edge in self.edges:
            shape = {} if edge.shape_m is None else {"shape": _text(edge.shape_m)}
            values = {"from": edge.start, "to": edge.end, "numLanes": str(edge.lanes)} | shape
            values |= {"speed": f"{edge.speed_mps:.2f}", "priority": str(edge.priority)}
            SubElement(edges, "edge", {"id": edge.id, "width": f"{width_m:.2f}", **values})
        for start, end, from_lane, to_lane in self.connections:
            ends = {"from": start, "to": end, "fromLane": str(from_lane), "toLane": str(to_lane)}
            SubElement(links, "connection", ends)
        files = {}
        for option, root in (("node-files", nodes), ("edge-files", edges), ("connection-files", links)):
            files[option] = folder / f"plan.{option[:3]}.xml"
            ElementTree(root).write(files[option], encoding="utf-8", xml_declaration=True)
        return files


def bend(plan: StreetPlan, rng: np.random.Generator, waves_m: tuple[float, float]) -> None:
    """Move all points by a smooth random displacement, so that straight streets become curves.

    Args:
        plan: changed in place.
        rng: draws three waves.
        waves_m: shortest and longest wave; the shorter, the tighter the curves.
    """
    waves = rng.normal(size=(3, 2))
    waves *= 2.0 * np.pi / (rng.uniform(*waves_m, size=3) * np.linalg.norm(waves, axis=1))[:, None]
    phase = rng.uniform(0.0, 2.0 * np.pi, size=3)
    shift = rng.normal(size=(3, 2))
    shift /= np.linalg.norm(shift, axis=1)[:, None] * np.linalg.norm(waves, axis=1)[:, None]
    shift *= _STEEPEST * rng.uniform(0.0, 1.0)

    def moved(xy_m: FloatArray) -> FloatArray:
        return np.asarray(xy_m + np.sin(xy_m @ waves.T + phase) @ shift)

    for edge in plan.edges:
        ends = np.stack((plan.nodes[edge.start], plan.nodes[edge.end]))
        parts = max(2, round(float(np.linalg.norm(ends[1] - ends[0])) / _SPACING_M))
        straight = ends[0] + np.linspace(0.0, 1.0, parts + 1)[:, None] * (ends[1] - ends[0])
        edge.shape_m = moved(straight if edge.shape_m is None else edge.shape_m)
    for name in plan.nodes:
        plan.nodes[name] = moved(plan.nodes[name])


def _text(xy_m: FloatArray) -> str:
    return " ".join(f"{x:.3f},{y:.3f}" for x, y in xy_m)
