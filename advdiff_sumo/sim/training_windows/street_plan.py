"""Describe a street plan: nodes and edges before netconvert builds them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement

import numpy as np

from advdiff_sumo.core.arrays import FloatArray

_SPACING_M = 12.0  # between the points of a curved edge
_MAX_SLOPE = 0.15  # metres of displacement per metre


@dataclass
class PlanEdge:
    """One direction of a street; *shape_m* (P, 2) if it is not straight."""

    id: str
    start: str
    end: str
    lanes: int = 1
    speed_mps: float = 13.89
    priority: int = 1
    shape_m: FloatArray | None = None


@dataclass
class StreetPlan:
    """Nodes and edges, with the attributes of SUMO's plain XML.

    Attributes:
        nodes: id → (2,) position.
        edges: in the order of the file.
        types: node → type of junction; netconvert chooses all others.
        connections: (from edge, to edge, from lane, to lane); for edges without any, netconvert guesses them.
    """

    nodes: dict[str, FloatArray]
    edges: list[PlanEdge]
    types: dict[str, str] = field(default_factory=dict)
    connections: list[tuple[str, str, int, int]] = field(default_factory=list)

    def write(self, folder: Path, width_m: float) -> dict[str, Path]:
        """Write plain XML, and return netconvert's option → file."""
        nodes, edges, links = Element("nodes"), Element("edges"), Element("connections")
        for name, xy in self.nodes.items():
            type_attribute = {"type": self.types[name]} if name in self.types else {}
            SubElement(
                nodes, "node", {"id": name, "x": f"{xy[0]:.3f}", "y": f"{xy[1]:.3f}", **type_attribute}
            )
        for edge in self.edges:
            shape = {} if edge.shape_m is None else {"shape": _shape_text(edge.shape_m)}
            attributes = {"from": edge.start, "to": edge.end, "numLanes": str(edge.lanes)} | shape
            attributes |= {"speed": f"{edge.speed_mps:.2f}", "priority": str(edge.priority)}
            SubElement(edges, "edge", {"id": edge.id, "width": f"{width_m:.2f}", **attributes})
        for from_edge, to_edge, from_lane, to_lane in self.connections:
            ends = {"from": from_edge, "to": to_edge, "fromLane": str(from_lane), "toLane": str(to_lane)}
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
        waves_m: shortest and longest wavelength; the shorter, the tighter the curves.
    """
    wave_vectors = rng.normal(size=(3, 2))
    wave_vectors *= (
        2.0 * np.pi / (rng.uniform(*waves_m, size=3) * np.linalg.norm(wave_vectors, axis=1))[:, None]
    )
    phase = rng.uniform(0.0, 2.0 * np.pi, size=3)
    amplitudes = rng.normal(size=(3, 2))
    amplitudes /= np.linalg.norm(amplitudes, axis=1)[:, None] * np.linalg.norm(wave_vectors, axis=1)[:, None]
    amplitudes *= _MAX_SLOPE * rng.uniform(0.0, 1.0)

    def displaced(xy_m: FloatArray) -> FloatArray:
        return np.asarray(xy_m + np.sin(xy_m @ wave_vectors.T + phase) @ amplitudes)

    for edge in plan.edges:
        ends = np.stack((plan.nodes[edge.start], plan.nodes[edge.end]))
        segments = max(2, round(float(np.linalg.norm(ends[1] - ends[0])) / _SPACING_M))
        straight = ends[0] + np.linspace(0.0, 1.0, segments + 1)[:, None] * (ends[1] - ends[0])
        edge.shape_m = displaced(straight if edge.shape_m is None else edge.shape_m)
    for name in plan.nodes:
        plan.nodes[name] = displaced(plan.nodes[name])


def _shape_text(xy_m: FloatArray) -> str:
    return " ".join(f"{x:.3f},{y:.3f}" for x, y in xy_m)
