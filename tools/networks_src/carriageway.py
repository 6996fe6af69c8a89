"""Lay motorway carriageways with auxiliary lanes on either side, and their ramps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from networks_src.curve import Curve, hermite
from networks_src.plain import Edge, Link, Node, Plan

LANES = 3


@dataclass(frozen=True)
class Section:
    """A section of a carriageway from arc length `start_m` on, with `left` and `right` auxiliary lanes."""

    start_m: float
    left: int = 0
    right: int = 0
    speed_mps: float = 33.33


@dataclass(frozen=True)
class Carriageway:
    """One direction of a motorway; `curve` is the left border of its main lanes, `sections` are in order."""

    name: str
    curve: Curve
    sections: tuple[Section, ...]
    width_m: float = 3.5

    def node(self, index: int) -> str:
        """Return the name of the node at which section `index` begins."""
        return f"{self.name}{index}"

    def edge(self, index: int) -> str:
        """Return the name of the edge of section `index`."""
        return f"{self.name}{index}-{self.name}{index + 1}"

    def lane_middle(self, index: int, left: bool) -> tuple[tuple[float, float], float]:
        """Return the centre (m) and heading (rad) of the auxiliary lane beside the node of section `index`."""
        station = self.sections[index].start_m
        offset = self.width_m / 2 if left else -(LANES + 0.5) * self.width_m
        x, y = self.curve.at(station, offset)[0]
        return (float(x), float(y)), self.curve.heading_rad(station)


def lay_carriageway(plan: Plan, road: Carriageway) -> None:
    """Add nodes, edges and through links; a lane without a counterpart in the next section ends."""
    bounds = [*(s.start_m for s in road.sections), road.curve.length_m]
    for i, station in enumerate(bounds):
        x, y = road.curve.at(station, -LANES / 2 * road.width_m)[0]
        plan.add_node(Node(road.node(i), (float(x), float(y)), radius_m=1.5))
    for i, section in enumerate(road.sections):
        shape = road.curve.piece(bounds[i], bounds[i + 1], section.left * road.width_m)
        lanes = LANES + section.left + section.right
        plan.add_edge(
            Edge(
                road.edge(i), road.node(i), road.node(i + 1), f"Motorway {road.name}", lanes,
                section.speed_mps, 20, shape, "right", road.width_m,
            )
        )  # fmt: skip
    for i, (section, following) in enumerate(zip(road.sections, road.sections[1:], strict=False)):
        for lane in range(LANES + min(section.left, following.left) + min(section.right, following.right)):
            right = min(section.right, following.right)
            lanes = (lane + section.right - right, lane + following.right - right)
            plan.links.append(Link(road.edge(i), road.edge(i + 1), *lanes))


@dataclass(frozen=True)
class Ramp:
    """A one-lane ramp between the node of a section and a surface node.

    It has the heading `heading_rad` at the surface node, `aside_m` to its right, so that it meets a lane of a two-way
    road.
    """

    name: str
    road: Carriageway
    section: int
    node: str
    heading_rad: float
    leaves: bool  # True for an off-ramp
    left: bool = False
    aside_m: float = 0.0
    speed_mps: float = 22.22


def lay_ramps(plan: Plan, ramps: Sequence[Ramp]) -> None:
    """Add ramps and their links; the section before an exit and after an entry must have an auxiliary lane."""
    for ramp in ramps:
        pose, heading = ramp.road.lane_middle(ramp.section, ramp.left)
        surface = _right_of(plan.nodes[ramp.node].xy_m, ramp)
        main = ramp.road.node(ramp.section)
        ends = (main, ramp.node) if ramp.leaves else (ramp.node, main)
        forward = (pose, heading, surface, ramp.heading_rad)
        shape = hermite(*forward) if ramp.leaves else hermite(surface, ramp.heading_rad, pose, heading)
        name = f"{ends[0]}-{ends[1]}"
        plan.add_edge(
            Edge(name, *ends, ramp.name, 1, ramp.speed_mps, 8, np.asarray(shape), "center", ramp.road.width_m)
        )
        index = ramp.section - 1 if ramp.leaves else ramp.section
        edge = plan.edges[ramp.road.edge(index)]
        lane = edge.lanes - 1 if ramp.left else 0
        plan.links.append(Link(edge.name, name, lane, 0) if ramp.leaves else Link(name, edge.name, 0, lane))


def _right_of(xy_m: tuple[float, float], ramp: Ramp) -> tuple[float, float]:
    """Return the point `ramp.aside_m` to the right of a point."""
    right = ramp.heading_rad - np.pi / 2
    return float(xy_m[0] + ramp.aside_m * np.cos(right)), float(xy_m[1] + ramp.aside_m * np.sin(right))
