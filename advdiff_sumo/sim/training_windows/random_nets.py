"""Random nets to simulate traffic on: streets of netgenerate, bent and given mixed junctions, and motorways."""

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
"""Kinds of the nets that are made up one after the other."""
_TIMEOUT_S = 120
_JUNCTIONS = ("priority", "traffic_light", "right_before_left", "allway_stop", "priority_stop")
_SPEEDS_MPS = (8.33, 11.11, 13.89, 16.67, 19.44)
_ROUNDABOUT_SHARE = 0.12
_SPREAD_M = 10.0
_WAVES_M = ((140.0, 500.0), (700.0, 2000.0))  # streets, motorways


def write_random_net(kind: str, seed: SeedTree, path: Path) -> Path:
    """Write a net of one of :data:`KINDS` that depends on *seed* alone to *path*; a third drive on the left.

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
            plan = _streets(_generated(kind, seed, rng, folder), rng, lefthand)
        bend(plan, rng, _WAVES_M[kind == "motorway"])
        _convert(plan, folder, path, lefthand, rng)
    return path


def _generated(kind: str, seed: SeedTree, rng: np.random.Generator, folder: Path) -> StreetPlan:
    """Return nodes and streets as netgenerate laid them out."""
    prefix = folder / "laid"
    options = {
        "grid": _grid_options,
        "spider": _spider_options,
        "rand": _rand_options,
    }[kind](rng)
    options |= {"seed": str(seed.child("netgenerate").integer()), "plain-output-prefix": str(prefix)}
    _call("netgenerate", [f"--{kind}", *(f"--{k}={v}" for k, v in options.items())], prefix)
    spread = rng.uniform(0.0, _SPREAD_M)
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


def _streets(plan: StreetPlan, rng: np.random.Generator, lefthand: bool) -> StreetPlan:
    """Give streets lanes and limits, junctions their kind, and build some as roundabouts."""
    usual = int(rng.choice((1, 2, 3), p=(0.45, 0.4, 0.15)))
    limit = float(rng.choice(_SPEEDS_MPS[1:4]))
    drawn: dict[frozenset[str], tuple[int, float]] = {}
    for edge in plan.edges:
        street = frozenset((edge.start, edge.end))
        if street not in drawn:
            other = rng.random() < 0.35
            lanes = int(rng.choice((1, 2, 3), p=(0.5, 0.35, 0.15))) if other else usual
            drawn[street] = lanes, float(rng.choice(_SPEEDS_MPS)) if other else limit
        edge.lanes, edge.speed_mps = drawn[street]
        edge.priority = 2 * edge.lanes + int(edge.speed_mps > 12.0)
    shares = rng.dirichlet((1.2, 1.2, 0.5, 0.3, 0.3))
    arms = defaultdict(set)
    for edge in plan.edges:
        arms[edge.start].add(edge.end)
        arms[edge.end].add(edge.start)
    for node in sorted(arms):
        if len(arms[node]) > 2:
            plan.types[node] = str(rng.choice(_JUNCTIONS, p=shares))
            if len(arms[node]) <= 4 and rng.random() < _ROUNDABOUT_SHARE:
                _roundabout(plan, node, rng, lefthand)
    return plan


def _roundabout(plan: StreetPlan, node: str, rng: np.random.Generator, lefthand: bool) -> None:
    """Replace *node* by a ring with one node an arm."""
    centre, radius = plan.nodes[node], rng.uniform(13.0, 20.0)
    touching = [e for e in plan.edges if node in (e.start, e.end)]
    far = {e.id: plan.nodes[e.end if e.start == node else e.start] - centre for e in touching}
    if min(float(np.hypot(*d)) for d in far.values()) < 3.0 * radius:
        return
    angles = {
        (e.end if e.start == node else e.start): float(np.arctan2(far[e.id][1], far[e.id][0]))
        for e in touching
    }
    order = sorted(angles, key=lambda arm: -angles[arm] if lefthand else angles[arm])
    gaps = np.diff(sorted(angles.values()))
    if len(gaps) and gaps.min() < 0.9:
        return
    ring = {arm: f"{node}r{k}" for k, arm in enumerate(order)}
    for arm in order:
        plan.nodes[ring[arm]] = centre + radius * np.array([np.cos(angles[arm]), np.sin(angles[arm])])
    for edge in touching:
        if edge.start == node:
            edge.start = ring[edge.end]
        else:
            edge.end = ring[edge.start]
    lanes = 2 if max(e.lanes for e in touching) > 1 and rng.random() < 0.4 else 1
    turn = -1.0 if lefthand else 1.0
    for here, there in zip(order, order[1:] + order[:1], strict=True):
        sweep = (turn * (angles[there] - angles[here])) % (2.0 * np.pi)
        along = angles[here] + turn * np.linspace(0.0, sweep, max(3, round(sweep / 0.3)))
        shape = centre + radius * np.column_stack((np.cos(along), np.sin(along)))
        plan.edges.append(
            PlanEdge(f"{ring[here]}-{ring[there]}", ring[here], ring[there], lanes, 8.33, 20, shape)
        )
    del plan.nodes[node]
    plan.types.pop(node, None)


def _convert(plan: StreetPlan, folder: Path, path: Path, lefthand: bool, rng: np.random.Generator) -> None:
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
    _call("netconvert", [f"--{k}={v}" for k, v in sorted(options.items())], path)
    drop_header(path)


def _call(program: str, options: Sequence[str], net: Path) -> None:
    command = [sumolib.checkBinary(program), *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
    if done.returncode != 0:
        lines = [line for line in done.stderr.splitlines() if line.startswith("Error")]
        raise NetError(net, f"{program} refused a random net: {' '.join(lines[:2])}", "take another --seed")


def _elements(path: Path, tag: str) -> list[ET.Element]:
    root = parse_xml(path).getroot()
    return [] if root is None else list(root.iterfind(tag))
