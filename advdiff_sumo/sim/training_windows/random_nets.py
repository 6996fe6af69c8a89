"""Make random nets for simulations: motorways, and netgenerate's streets with curves and mixed junctions."""

from __future__ import annotations

import subprocess
import tempfile
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import sumolib
from defusedxml.ElementTree import parse as parse_xml

from advdiff_sumo.core.errors import NetError
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps.sumo_files import drop_header
from advdiff_sumo.sim.training_windows.motorway import motorway_plan
from advdiff_sumo.sim.training_windows.street_plan import PlanEdge, StreetPlan, bend

KINDS = ("grid", "rand", "spider", "grid", "motorway", "rand", "grid", "spider")
"""Kinds of consecutive random nets."""
_TIMEOUT_S = 120
_JUNCTIONS = ("priority", "traffic_light", "right_before_left", "allway_stop", "priority_stop")
_SPEEDS_MPS = (8.33, 11.11, 13.89, 16.67, 19.44)
_ROUNDABOUT_SHARE = 0.12
_MAX_NODE_SPREAD_M = 10.0  # standard deviation by which nodes are moved
_WAVELENGTHS_M = ((140.0, 500.0), (700.0, 2000.0))  # of curves: of streets, of motorways


def write_random_net(kind: str, seed: SeedTree, path: Path) -> Path:
    """Write a net of one of :data:`KINDS` to *path*; it depends on *seed* alone. A third have left-hand traffic.

    Raises:
        NetError: netgenerate or netconvert refused.
    """
    rng = seed.generator()
    lefthand = bool(rng.random() < 1 / 3)
    with tempfile.TemporaryDirectory(prefix="advdiff-") as name:
        folder = Path(name)
        if kind == "motorway":
            plan = motorway_plan(rng, lefthand)
        else:
            plan = _draw_streets(_generate(kind, seed, rng, folder), rng, lefthand)
        bend(plan, rng, _WAVELENGTHS_M[kind == "motorway"])
        _convert(plan, folder, path, lefthand, rng)
    return path


def _generate(kind: str, seed: SeedTree, rng: np.random.Generator, folder: Path) -> StreetPlan:
    """Return nodes and streets of netgenerate, with the nodes moved at random."""
    prefix = folder / "laid"
    options = {"grid": _grid_options, "spider": _spider_options, "rand": _rand_options}[kind](rng)
    options |= {"seed": str(seed.child("netgenerate").integer()), "plain-output-prefix": str(prefix)}
    _run_tool("netgenerate", [f"--{kind}", *(f"--{k}={v}" for k, v in options.items())], prefix)
    spread = rng.uniform(0.0, _MAX_NODE_SPREAD_M)
    nodes = {
        e.attrib["id"]: np.array([float(e.attrib["x"]), float(e.attrib["y"])]) + rng.normal(0.0, spread, 2)
        for e in _elements(folder / "laid.nod.xml", "node")
    }
    edges = [
        PlanEdge(e.attrib["id"], e.attrib["from"], e.attrib["to"])
        for e in _elements(folder / "laid.edg.xml", "edge")
    ]
    return StreetPlan(nodes, edges)


def _grid_options(rng: np.random.Generator) -> dict[str, str]:
    return {
        "grid.x-number": str(rng.integers(3, 6)),
        "grid.y-number": str(rng.integers(3, 5)),
        "grid.x-length": f"{rng.uniform(70, 190):.0f}",
        "grid.y-length": f"{rng.uniform(70, 170):.0f}",
        "grid.attach-length": f"{rng.uniform(80, 160):.0f}",
    }


def _spider_options(rng: np.random.Generator) -> dict[str, str]:
    return {
        "spider.arm-number": str(rng.integers(4, 8)),
        "spider.circle-number": str(rng.integers(2, 4)),
        "spider.space-radius": f"{rng.uniform(80, 150):.0f}",
        "spider.attach-length": f"{rng.uniform(80, 150):.0f}",
    }


def _rand_options(rng: np.random.Generator) -> dict[str, str]:
    return {
        "rand.iterations": str(rng.integers(25, 60)),
        "rand.min-distance": f"{rng.uniform(60, 100):.0f}",
        "rand.max-distance": f"{rng.uniform(130, 260):.0f}",
        "rand.min-angle": "45",
        "rand.connectivity": "0.95",
    }


def _draw_streets(plan: StreetPlan, rng: np.random.Generator, lefthand: bool) -> StreetPlan:
    """Draw lanes and speed limits of streets and the types of junctions; make some junctions roundabouts."""
    usual_lanes = int(rng.choice((1, 2, 3), p=(0.45, 0.4, 0.15)))
    usual_limit_mps = float(rng.choice(_SPEEDS_MPS[1:4]))
    lanes_and_limit: dict[frozenset[str], tuple[int, float]] = {}
    for edge in plan.edges:
        street = frozenset((edge.start, edge.end))
        if street not in lanes_and_limit:
            is_unusual = rng.random() < 0.35
            lanes = int(rng.choice((1, 2, 3), p=(0.5, 0.35, 0.15))) if is_unusual else usual_lanes
            lanes_and_limit[street] = lanes, float(rng.choice(_SPEEDS_MPS)) if is_unusual else usual_limit_mps
        edge.lanes, edge.speed_mps = lanes_and_limit[street]
        edge.priority = 2 * edge.lanes + int(edge.speed_mps > 12.0)
    shares = rng.dirichlet((1.2, 1.2, 0.5, 0.3, 0.3))
    neighbours = defaultdict(set)
    for edge in plan.edges:
        neighbours[edge.start].add(edge.end)
        neighbours[edge.end].add(edge.start)
    for node in sorted(neighbours):
        if len(neighbours[node]) > 2:
            plan.types[node] = str(rng.choice(_JUNCTIONS, p=shares))
            if len(neighbours[node]) <= 4 and rng.random() < _ROUNDABOUT_SHARE:
                _make_roundabout(plan, node, rng, lefthand)
    return plan


def _make_roundabout(plan: StreetPlan, node: str, rng: np.random.Generator, lefthand: bool) -> None:
    """Replace *node* by a ring with one node for each arm, if its arms are long enough and far enough apart."""
    centre, radius = plan.nodes[node], rng.uniform(13.0, 20.0)
    incident_edges = [e for e in plan.edges if node in (e.start, e.end)]
    offsets = {e.id: plan.nodes[e.end if e.start == node else e.start] - centre for e in incident_edges}
    if min(float(np.hypot(*offset)) for offset in offsets.values()) < 3.0 * radius:
        return
    angles = {
        (e.end if e.start == node else e.start): float(np.arctan2(offsets[e.id][1], offsets[e.id][0]))
        for e in incident_edges
    }
    order = sorted(angles, key=lambda arm: -angles[arm] if lefthand else angles[arm])
    gaps = np.diff(sorted(angles.values()))
    if len(gaps) and gaps.min() < 0.9:
        return
    ring = {arm: f"{node}r{k}" for k, arm in enumerate(order)}
    for arm in order:
        plan.nodes[ring[arm]] = centre + radius * np.array([np.cos(angles[arm]), np.sin(angles[arm])])
    for edge in incident_edges:
        if edge.start == node:
            edge.start = ring[edge.end]
        else:
            edge.end = ring[edge.start]
    lanes = 2 if max(e.lanes for e in incident_edges) > 1 and rng.random() < 0.4 else 1
    turn_sign = -1.0 if lefthand else 1.0
    for arm, next_arm in zip(order, order[1:] + order[:1], strict=True):
        sweep = (turn_sign * (angles[next_arm] - angles[arm])) % (2.0 * np.pi)
        ring_angles = angles[arm] + turn_sign * np.linspace(0.0, sweep, max(3, round(sweep / 0.3)))
        shape = centre + radius * np.column_stack((np.cos(ring_angles), np.sin(ring_angles)))
        plan.edges.append(
            PlanEdge(f"{ring[arm]}-{ring[next_arm]}", ring[arm], ring[next_arm], lanes, 8.33, 20, shape)
        )
    del plan.nodes[node]
    plan.types.pop(node, None)


def _convert(plan: StreetPlan, folder: Path, path: Path, lefthand: bool, rng: np.random.Generator) -> None:
    """Build the net of *plan* with netconvert and random options."""
    files = plan.write(folder, width_m=float(rng.uniform(3.0, 3.7)))
    options = {
        **{name: str(file) for name, file in files.items()},
        "output-file": str(path),
        "lefthand": str(lefthand).lower(),
        "no-turnarounds": "true",
        "roundabouts.guess": "true",
        "offset.disable-normalization": "true",
        "default.junctions.radius": f"{rng.uniform(3.0, 9.0):.1f}",
        "junctions.internal-link-detail": "8",
        "junctions.limit-turn-speed": "4",  # m/s²
        "junctions.corner-detail": "6",
        "tls.left-green.time": str(rng.choice((0, 6))),
        "tls.green.time": str(rng.integers(12, 26)),
        "tls.default-type": str(rng.choice(("static", "actuated"))),
        "xml-validation": "never",
        "precision": "3",
    }
    _run_tool("netconvert", [f"--{k}={v}" for k, v in sorted(options.items())], path)
    drop_header(path)


def _run_tool(program: str, options: Sequence[str], net: Path) -> None:
    """Run one of SUMO's programs.

    Raises:
        NetError: it failed; *net* is named in the message.
    """
    command = [sumolib.checkBinary(program), *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
    if done.returncode != 0:
        lines = [line for line in done.stderr.splitlines() if line.startswith("Error")]
        raise NetError(net, f"{program} refused a random net: {' '.join(lines[:2])}", "take another --seed")


def _elements(path: Path, tag: str) -> list[ET.Element]:
    """Return the elements called *tag* in an XML file."""
    root = parse_xml(path).getroot()
    return [] if root is None else list(root.iterfind(tag))
